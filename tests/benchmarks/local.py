"""A portal call on the same host, compared with a method call in Python.

A portal call makes a thread in the resource's block, copies arguments and result between the two blocks,
and switches there and back. A plain Python call does none of that; where objects are passed, `deepcopy` of
argument and result is what a Python program would do for the same isolation.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field

from harness import Figure, Row, in_turns, median, microseconds, percentile, play, stage, timed, times

from lfield.testing.golden import compile_text

BATCHES, CALLS, ROUNDS, POINTS = 10, 200, 10, 10

_PROGRAM = """
resource Store {
    init(string[] arg) { }
    portal visit() { }
    portal echo(Path p) emit Path { return p; }
}

class Point {
    public real x;
    public real y;
    public Point(real a, real b) { x = a; y = b; }
}

class Path {
    public Point[] points;
    public Path(int count) {
        points = new Point[count];
        for (int i = 0; i < count; i = i + 1) points[i] = new Point(i, -i);
    }
}

coordinator Caller {
    init(string[] arg) {
        Store store = findStore("store");
        Path path = new Path(%(points)d);
        for (int batch = 0; batch < %(batches)d; batch = batch + 1) {
            real start = now();
            for (int i = 0; i < %(calls)d; i = i + 1) %(call)s;
            print((now() - start) / %(calls)d);
        }
    }
}
"""


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


def figure() -> Figure:
    """Calls without and with objects."""
    visit, echo = _PortalCalls("store.visit()"), _PortalCalls("store.echo(path)")
    names = {
        "visit": visit.batches,
        "python visit": _python_visits,
        "echo": echo.batches,
        "python echo": _python_echoes,
        "python copy": _python_copies,
    }
    samples = in_turns(names, ROUNDS)
    objects = f"{POINTS + 2} objects there and back"
    rows = (
        _row(samples, "no arguments", "lfield: local portal call", "visit", "python visit"),
        _row(samples, "", "CPython: method call", "python visit", "python visit"),
        _row(samples, objects, "lfield: local portal call", "echo", "python copy"),
        _row(samples, "", "CPython: method call, deepcopy", "python copy", "python copy"),
        _row(samples, "", "CPython: method call, no copy", "python echo", "python copy"),
    )
    note = f"{ROUNDS} rounds of {BATCHES} batches; a sample is the mean of the {CALLS} calls of a batch"
    return Figure("Local portal call; ratio to a method call in CPython", rows, (note,))


def _row(samples: dict[str, list[float]], case: str, measured: str, name: str, against: str) -> Row:
    own = samples[name]
    ratio = median(own) / median(samples[against])
    return Row(case, measured, microseconds(median(own)), microseconds(percentile(own, 99)), times(ratio))


class _PortalCalls:
    """A compiled program that makes one kind of call."""

    def __init__(self, call: str) -> None:
        words = {"points": POINTS, "batches": BATCHES, "calls": CALLS, "call": call}
        self._program = compile_text(_PROGRAM % words)

    def batches(self) -> list[float]:
        """Seconds per call, one sample per batch."""
        return [float(line) for line in play(*stage(self._program))]


def _python_visits() -> list[float]:
    store = _Store()

    def calls() -> None:
        for _ in range(CALLS):
            store.visit()

    return _batches(calls)


def _python_echoes() -> list[float]:
    store, path = _Store(), _Path()

    def calls() -> None:
        for _ in range(CALLS):
            store.echo(path)

    return _batches(calls)


def _python_copies() -> list[float]:
    store, path = _Store(), _Path()

    def calls() -> None:
        for _ in range(CALLS):
            deepcopy(store.echo(deepcopy(path)))

    return _batches(calls)


def _batches(calls: Callable[[], None]) -> list[float]:
    """Seconds per call, one sample per batch."""
    return [timed(calls) / CALLS for _ in range(BATCHES)]
