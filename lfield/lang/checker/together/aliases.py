"""Alias analysis of array variables: which may refer to the same array, or to nested arrays.

Flow-insensitive within one method: every assignment counts, in any order. Other methods are not analysed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lfield.lang.tree import (
    Assign,
    Declare,
    Element,
    Elements,
    Expr,
    Field,
    FieldGet,
    LibraryCall,
    Local,
    LocalGet,
    Stmt,
)
from lfield.lang.tree_traversal import all_statements, descendants, statement_expressions
from lfield.lang.types import ArrayType

#: A variable or field.
Named = Local | Field


def named(expr: Expr) -> Named | None:
    """The variable or field of an expression."""
    match expr:
        case LocalGet():
            return expr.local
        case FieldGet():
            return expr.field
    return None


def _container(expr: Expr) -> Expr | None:
    """The array from which an expression reads or removes an element; None for other expressions."""
    match expr:
        case Element():
            return expr.array
        case LibraryCall(operation="remove" | "remove_last", arguments=[array, *_]):
            return array
    return None


def base(expr: Expr) -> Expr:
    """The array in `array[i][j]`; any other expression unchanged."""
    while (array := _container(expr)) is not None:
        expr = array
    return expr


def depth(expr: Expr) -> int:
    """The number of indexes of `array[i][j]`."""
    found = 0
    while (array := _container(expr)) is not None:
        expr, found = array, found + 1
    return found


class Aliases:
    """The names of a method's arrays."""

    def __init__(self, body: Sequence[Stmt]) -> None:
        self._alias_of: dict[Named, Named] = {}
        self._inside: list[tuple[Named, Named]] = []
        for stmt in all_statements(body):
            if isinstance(stmt, Declare) and stmt.value is not None:
                self._join(stmt.local, 0, stmt.value)
            for part in (part for value in statement_expressions(stmt) for part in descendants(value)):
                if isinstance(part, LibraryCall) and part.operation in ("append", "insert"):
                    array = part.arguments[0]
                    if (name := named(base(array))) is not None:
                        self._join(name, depth(array) + 1, part.arguments[-1])
                if isinstance(part, Assign) and (name := named(base(part.target))) is not None:
                    self._join(name, depth(part.target), part.value)
        self._around: dict[Named, set[Named]] = {}
        self._within: dict[Named, set[Named]] = {}
        for inner, outer in self._inside:
            self._around.setdefault(self.of(inner), set()).add(self.of(outer))
            self._within.setdefault(self.of(outer), set()).add(self.of(inner))

    def of(self, name: Named) -> Named:
        """The representative of all aliases of an array."""
        while name in self._alias_of:
            name = self._alias_of[name]
        return name

    def related(self, name: Named) -> set[Named]:
        """The representatives of an array, of the arrays in it and of those that contain it."""
        representative = self.of(name)
        return _reached(representative, self._around) | _reached(representative, self._within)

    def _join(self, name: Named, level: int, value: Expr) -> None:
        """Record `name = value` (level 0), or `name[i] = value` (1) and so on."""
        if not isinstance(value.type, ArrayType):
            return
        if isinstance(value, Assign):
            self._join(name, level, value.value)
        elif isinstance(value, Elements):
            for element in value.elements:
                self._join(name, level + 1, element)
        elif (source := named(base(value))) is not None:
            self._relate(name, level, source, depth(value))

    def _relate(self, name: Named, level: int, source: Named, found: int) -> None:
        """Record that the arrays at level `level` of one name are those at level `found` of the other."""
        if level < found:
            self._inside.append((name, source))
        elif level > found:
            self._inside.append((source, name))
        elif self.of(source) != self.of(name):
            self._alias_of[self.of(source)] = self.of(name)


def _reached(start: Named, neighbours: Mapping[Named, set[Named]]) -> set[Named]:
    """The reachable nodes, including the start."""
    found: set[Named] = set()
    waiting = [start]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += neighbours.get(name, ())
    return found
