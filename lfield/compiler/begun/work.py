"""What does more than compute: pauses, output, calls of portals and devices, and methods that lead to any.

The calls that a `together` has collected are begun before it, so that they are under way meanwhile. What only
computes is over at once, and nobody can see when.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cached_property

from lfield.lang.chains import inside, statements, values
from lfield.lang.tree import (
    Call,
    DeviceCall,
    Expr,
    Library,
    Method,
    New,
    PortalCall,
    Reserve,
    Together,
    Within,
)

_WORK = frozenset({"sleep", "yield"})
_OUTPUT = ("print_", "write_")


class Work:
    """The methods of a program, and which of them do more than compute."""

    def __init__(self, methods: Iterable[Method]) -> None:
        self._methods = list(methods)

    def inside(self, expr: Expr) -> bool:
        """Whether an expression does more than compute."""
        return any(_is_work(one) for one in inside(expr)) or not self._working.isdisjoint(_called(expr))

    @cached_property
    def _working(self) -> frozenset[Method]:
        expressions = {method: list(_expressions(method)) for method in self._methods}
        calls = {method: {c for e in found for c in _called(e)} for method, found in expressions.items()}
        working = {
            method
            for method, found in expressions.items()
            if any(isinstance(one, Together | Within | Reserve) for one in statements(method.body))
            or any(_is_work(one) for expr in found for one in inside(expr))
        }
        before = -1
        while before != len(working):
            before = len(working)
            working |= {method for method, callees in calls.items() if not working.isdisjoint(callees)}
        return frozenset(working)


def _expressions(method: Method) -> Iterator[Expr]:
    for one in statements(method.body):
        yield from values(one)


def _called(expr: Expr) -> Iterator[Method]:
    """The methods and constructors that an expression calls itself."""
    for one in inside(expr):
        if isinstance(one, Call):
            yield one.method
        elif isinstance(one, New) and one.constructor is not None:
            yield one.constructor


def _is_work(one: Expr) -> bool:
    match one:
        case PortalCall() | DeviceCall():
            return True
        case Library():
            return one.operation in _WORK or one.operation.startswith(_OUTPUT)
    return False
