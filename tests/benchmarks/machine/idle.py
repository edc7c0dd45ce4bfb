"""The processor time of a host whose agents idle: what the scheduler charges to it (schedstat)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure
from harness.paced import Round
from harness.processes import Processes
from harness.words import PERCENT

from machine.small import settled, small_host

SECONDS = 3.0


def idle(checkout: Checkout, words: Sequence[str]) -> Round:
    """Percent of a processor."""
    with Processes() as processes:
        folder = settled(checkout, processes, words)
        before, start = processor_seconds(folder), time.perf_counter()
        time.sleep(SECONDS)
        spent = processor_seconds(folder) - before
        return {"processor": [100 * spent / (time.perf_counter() - start)]}


def processor_seconds(folder: Path) -> float:
    """What all threads of a process have run, by its folder in /proc."""
    tasks = (folder / "task").glob("*/schedstat")
    return sum(int(task.read_text(encoding="ascii").split()[0]) for task in tasks) / 1e9


FIGURE = Figure(
    "Processor time of a host whose agents idle",
    {"parked": small_host(idle), "polling": small_host(idle, "polling")},
    rounds=3,
    units={"processor": PERCENT},
    targets={"processor": "1 %"},
    notes=(f"each for {SECONDS:g} s",),
    between=("parked",),
)
