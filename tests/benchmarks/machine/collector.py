"""How long the collector stops an agent, by what lives on its heap: many small objects, or one big array.

The agent sees it: the longest of some allocations is one that had to wait for the collector, which works in
proportion to live data only; 1 MiB is what fits into an agent by default, full. For scale, a
plain copy of as many bytes: what no copying collector can beat.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from harness.checkout import Checkout, paced_mission
from harness.figure import Figure, Opener
from harness.processes import Processes
from harness.samples import Contender, timed

SIZES = (16 << 10, 64 << 10, 256 << 10, 1 << 20)
#: What is alive twice: once it stays.
_LIMITS = "agents: {holder: {heap: 4 MiB}}\n"


def holding(checkout: Checkout, processes: Processes, what: str, engine: str) -> Contender:
    """collector.L with live data of one kind."""
    agents = [f"//Holder:holder@here?{what}&{'&'.join(map(str, SIZES))}"]
    program = Path(__file__).with_suffix(".L")
    options = checkout.engines[engine]
    return paced_mission(checkout, processes, program, agents, _LIMITS, options=options)


def _holders() -> dict[str, Opener]:
    return {
        f"{told}, {engine}": partial(holding, what=what, engine=engine)
        for engine in sorted(Checkout.own().engines)
        for what, told in (("objects", "small objects"), ("array", "one array"))
    }


def copy(checkout: Checkout, processes: Processes) -> Contender:
    """A copy in Python."""
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
