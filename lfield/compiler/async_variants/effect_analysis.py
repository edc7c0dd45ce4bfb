"""Side-effect analysis: pauses, output, calls of portals and devices, and methods that lead to any.

The calls that a `together` has collected start before a side effect, so that they run meanwhile. Pure
computation takes no observable time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cached_property

from lfield.lang.tree import (
    Call,
    DeviceCall,
    Expr,
    LibraryCall,
    Method,
    New,
    PortalCall,
    Reserve,
    Together,
    Within,
)
from lfield.lang.tree_traversal import all_statements, descendants, statement_expressions

_BLOCKING = frozenset({"sleep", "yield", "read_line"})
_OUTSIDE = frozenset({"now", "lived", "random", "random_int"})
_OUTPUT = ("print_", "write_")


class EffectAnalysis:
    """The methods of a program, and which of them have side effects."""

    def __init__(self, methods: Iterable[Method]) -> None:
        self._methods = list(methods)

    def has_effects(self, expr: Expr) -> bool:
        """Whether an expression has side effects."""
        return any(_has_effect(part) for part in descendants(expr)) or not self._effectful.isdisjoint(
            _called(expr)
        )

    def reads_outside(self, expr: Expr) -> bool:
        """Whether an expression, or a method that it calls, may read a clock, a device or random numbers."""
        visited: set[Method] = set()
        waiting = [expr]
        while waiting:
            part = waiting.pop()
            if any(_reads_outside(inner) for inner in descendants(part)):
                return True
            for method in set(_called(part)) - visited:
                visited.add(method)
                waiting += _expressions(method)
        return False

    @cached_property
    def _effectful(self) -> frozenset[Method]:
        expressions = {method: list(_expressions(method)) for method in self._methods}
        calls = {method: {c for e in found for c in _called(e)} for method, found in expressions.items()}
        working = {
            method
            for method, found in expressions.items()
            if any(isinstance(stmt, Together | Within | Reserve) for stmt in all_statements(method.body))
            or any(_has_effect(part) for expr in found for part in descendants(expr))
        }
        before = -1
        while before != len(working):
            before = len(working)
            working |= {method for method, callees in calls.items() if not working.isdisjoint(callees)}
        return frozenset(working)


def _expressions(method: Method) -> Iterator[Expr]:
    for stmt in all_statements(method.body):
        yield from statement_expressions(stmt)


def _called(expr: Expr) -> Iterator[Method]:
    """The methods and constructors that an expression itself calls."""
    for part in descendants(expr):
        if isinstance(part, Call):
            yield part.method
        elif isinstance(part, New) and part.constructor is not None:
            yield part.constructor


def _reads_outside(expr: Expr) -> bool:
    return isinstance(expr, DeviceCall) or (isinstance(expr, LibraryCall) and expr.operation in _OUTSIDE)


def _has_effect(expr: Expr) -> bool:
    match expr:
        case PortalCall() | DeviceCall():
            return True
        case LibraryCall():
            return expr.operation in _BLOCKING or expr.operation.startswith(_OUTPUT)
    return False
