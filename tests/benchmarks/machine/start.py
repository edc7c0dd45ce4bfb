"""The start time of a host without devices, by engine, and of Python alone.

Compiled Python modules are cached, as after the first start of an installed program.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.paced import Round
from harness.processes import Processes
from harness.samples import Contender
from machine.small import small_host, started


def start(checkout: Checkout, words: Sequence[str]) -> Round:
    """Seconds of one start."""
    with Processes() as processes:
        return started(checkout, processes, words)[1]


def bare_python(checkout: Checkout, processes: Processes) -> Contender:
    """Seconds until Python prints a line."""

    def start() -> Round:
        with Processes() as processes:
            child = checkout.run(processes, "-c", "print('up')")
            child.line()
            return {"until it is up": [time.perf_counter() - child.started]}

    return start


def _hosts() -> dict[str, Opener]:
    return {
        f"from {source}, {engine}": small_host(start, compiled=compiled, engine=engine)
        for engine in sorted(Checkout.own().engines)
        for compiled, source in ((False, "L text"), (True, "a program file"))
    }


FIGURE = Figure(
    "The start of a host without devices",
    {**_hosts(), "bare Python that prints": bare_python},
    rounds=9,
    one_size="one host with one small program",
    targets={"to the first portal call": "0.7 s"},
    between=tuple(_hosts()),
)
