"""The processor time of a host whose agents idle: what the scheduler charges to it (schedstat)."""

from __future__ import annotations

import time
from collections.abc import Sequence

from harness.checkout import Checkout
from harness.figure import Figure
from harness.number_text import PERCENT
from harness.paced import Round
from harness.processes import Processes
from machine.small import processor_seconds, settled, small_host

SECONDS = 2.0


def idle(checkout: Checkout, words: Sequence[str]) -> Round:
    """Percent of a processor."""
    with Processes() as processes:
        folder = settled(checkout, processes, words)
        before, start = processor_seconds(folder), time.perf_counter()
        time.sleep(SECONDS)
        spent = processor_seconds(folder) - before
        return {"processor": [100 * spent / (time.perf_counter() - start)]}


FIGURE = Figure(
    "Processor time of a host whose agents idle",
    {"parked": small_host(idle), "polling": small_host(idle, "polling")},
    rounds=3,
    units={"processor": PERCENT},
    one_size="one host with one small program",
    targets={"parked": "0.50 %"},
    notes=(f"each for {SECONDS:g} s",),
    between=("parked",),
)
