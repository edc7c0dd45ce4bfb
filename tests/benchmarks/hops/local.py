"""A portal call on the same host, compared with a method call in Python.

A portal call makes a thread in the resource's block, copies arguments and result between the two blocks,
and switches there and back. A plain Python call does none of that; where objects are passed, `deepcopy` of
argument and result is what a Python program would do for the same isolation.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path

from harness.checkout import Checkout, paced_mission
from harness.figure import Figure
from harness.processes import Processes
from harness.samples import Contender, timed

BATCHES, CALLS, POINTS = 10, 200, 10
#: The least seconds of a sample of CPython.
LONG = 5e-3


@dataclass
class _Point:
    x: float
    y: float


@dataclass
class _Path:
    points: list[_Point] = field(default_factory=lambda: [_Point(i, -i) for i in range(POINTS)])


class _Store:
    def visit(self) -> None:
        pass

    def echo(self, path: _Path) -> _Path:
        return path


def portal_calls(checkout: Checkout, processes: Processes) -> Contender:
    """Run the caller of local.L."""
    agents = "//Store:store@here", f"//Caller:caller@here?{BATCHES}&{CALLS}&{POINTS}"
    return paced_mission(checkout, processes, Path(__file__).with_suffix(".L"), agents)


def method_calls(checkout: Checkout, processes: Processes) -> Contender:
    """Call a method in Python, with copied objects."""
    store, path = _Store(), _Path()

    def visits() -> None:
        for _ in range(CALLS):
            store.visit()

    def echoes() -> None:
        for _ in range(CALLS):
            deepcopy(store.echo(deepcopy(path)))

    works = {"no arguments": visits, "objects there and back": echoes}
    return lambda: {case: [timed(work, LONG) / CALLS for _ in range(BATCHES)] for case, work in works.items()}


FIGURE = Figure(
    "A local portal call; ratio to a method call in CPython",
    {"lfield: local portal call": portal_calls, "CPython: method call, deepcopy": method_calls},
    base=("CPython: method call, deepcopy",),
    one_size="no arguments, or one object of a fixed size",
    targets={"lfield: local portal call": "5 µs, empty"},
    notes=(f"a sample is the mean of {CALLS} calls or more; {POINTS + 2} objects",),
    between=("lfield: local portal call",),
)
