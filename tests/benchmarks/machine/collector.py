"""How long the collector stops an agent, by what lives on its heap: many small objects, or one big array.

The agent sees it: the longest of some allocations is one that had to wait for the collector, which works in
proportion to live data only. For scale, a plain copy of as many bytes: what no copying collector can beat.
"""

from __future__ import annotations

from pathlib import Path

from harness.checkout import Checkout, paced_mission
from harness.figure import Figure, Opener
from harness.processes import Processes
from harness.samples import Contender, timed

SIZES = (16 << 10, 64 << 10, 128 << 10, 256 << 10)


def holding(what: str) -> Opener:
    """collector.L with live data of one kind."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        sizes = "&".join(map(str, SIZES))
        program = Path(__file__).with_suffix(".L")
        return paced_mission(checkout, processes, program, [f"//Holder:holder@here?{what}&{sizes}"])

    return opener


def copy(checkout: Checkout, processes: Processes) -> Contender:
    """A copy in Python."""
    data = {count: bytearray(count) for count in SIZES}
    return lambda: {f"{count >> 10} KiB": [timed(lambda c=count: bytes(data[c]), 1e-3)] for count in SIZES}


FIGURE = Figure(
    "Pause of the collector by live heap; ratio to a plain copy",
    {"small objects": holding("objects"), "one array": holding("array"), "plain copy": copy},
    base=("plain copy",),
    rounds=12,
    between=("small objects", "one array"),
)
