"""The pause of an agent by the collector, with many small objects or one big array on its heap.

The agent measures the pause as the longest of several allocations, the one that had to wait for the
collector. The work of the collector is proportional to the live data; 1 MiB is the default heap limit of an
agent. The reference is a plain copy of the same number of bytes, the lower bound of a copying collector.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from harness.checkout import Checkout, paced_mission
from harness.figure import Figure, Opener
from harness.processes import Processes
from harness.samples import Contender, timed

SIZES = (16 << 10, 64 << 10, 256 << 10, 1 << 20)
#: Twice the live data and some reserve: the collector copies.
_LIMITS = "agents: {holder: {heap: 4 MiB}}\n"


def holding(checkout: Checkout, processes: Processes, what: str, engine: str) -> Contender:
    """Run collector.L with live data of one kind."""
    agents = [f"//Holder:holder@here?{what}&{'&'.join(map(str, SIZES))}"]
    program = Path(__file__).with_suffix(".L")
    options = checkout.engines[engine]
    return paced_mission(checkout, processes, program, agents, _LIMITS, options=options)


def _holders() -> dict[str, Opener]:
    return {
        f"{name}, {engine}": partial(holding, what=what, engine=engine)
        for engine in sorted(Checkout.own().engines)
        for what, name in (("objects", "small objects"), ("array", "one array"))
    }


def copy(checkout: Checkout, processes: Processes) -> Contender:
    """Copy the bytes in Python."""
    data = {count: bytearray(count) for count in SIZES}
    return lambda: {f"{count >> 10} KiB": [timed(lambda c=count: bytes(data[c]), 1e-3)] for count in SIZES}


FIGURE = Figure(
    "Pause of the collector by live heap; ratio to a plain copy",
    {**_holders(), "plain copy": copy},
    base=("plain copy",),
    rounds=9,
    sizes={f"{count >> 10} KiB": count for count in SIZES},
    targets={"small objects, wasm: 1024 KiB": "1.00 ms", "one array, wasm: 1024 KiB": "1.00 ms"},
    between=tuple(_holders()),
)
