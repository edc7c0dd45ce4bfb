"""How long a host without devices takes to start, beside the bare Python that is part of it.

Python keeps compiled modules, as it does after the first start of an installed program.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from harness.checkout import Checkout
from harness.figure import Figure
from harness.paced import Round
from harness.processes import Processes
from harness.samples import Contender
from machine.small import small_host, started


def start(checkout: Checkout, words: Sequence[str]) -> Round:
    """Seconds of one start."""
    with Processes() as processes:
        return started(checkout, processes, words)[1]


def bare_python(checkout: Checkout, processes: Processes) -> Contender:
    """Python that prints a line."""

    def start() -> Round:
        with Processes() as processes:
            child = checkout.run(processes, "-c", "print('up')")
            child.line()
            return {"until it is up": [time.perf_counter() - child.started]}

    return start


FIGURE = Figure(
    "The start of a host without devices",
    {
        "from L text": small_host(start),
        "from a program file": small_host(start, compiled=True),
        "bare Python that prints": bare_python,
    },
    rounds=9,
    targets={"to the first portal call": "0.7 s"},
    between=("from L text", "from a program file"),
)
