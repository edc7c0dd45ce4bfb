"""Variables that a `together` must not use: targets have no value yet, and arrays are about to get
elements.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from msgspec import Struct

from lfield.lang import messages
from lfield.lang.checker.symbols import Symbols
from lfield.lang.checker.together.aliases import Aliases, Named, base, depth, named
from lfield.lang.language_library import ARRAY_LENGTH
from lfield.lang.tree import Element, Expr, LibraryCall, LocalGet, StartCall, Together
from lfield.lang.tree_traversal import all_statements, descendants, statement_expressions
from lfield.lang.types import ArrayType, Type


class _Filled(Struct):
    """An array to whose elements a together assigns; `place` counts the calls.

    `dimensions` are those of the innermost array that is filled: 2 by `a[i]` of a `real[][]`, 1 by `a[i][j]`.
    """

    name: Named
    dimensions: int
    place: int


class _Read(Struct, frozen=True):
    """A variable or field in a together. Of `a[i].length()` only the array at level `depth` is read: 1."""

    expr: Expr
    name: Named
    depth: int

    def is_affected_by(self, filled: _Filled) -> bool:
        """Whether a together that fills an array changes the read value, if both names are of one array."""
        own = _dimensions(self.name.type)
        return own - self.depth < filled.dimensions <= own


def check_uses(symbols: Symbols, block: Together, started: Sequence[StartCall], aliases: Aliases) -> None:
    """Report where a together reads, passes or assigns a target of its own, or the array of one."""
    targets = [call.target for call in started if call.target is not None]
    variables = {target.local for target in targets if isinstance(target, LocalGet)}
    arrays = _filled([target for target in targets if isinstance(target, Element)], aliases)
    whole = {id(target) for target in targets}
    bases = {id(base(target)) for target in targets}
    for read in _reads(block):
        name, span = read.name, read.expr.span
        if name in variables and id(read.expr) not in whole:
            symbols.report(messages.TOGETHER_USED, span, name=name.name)
            continue
        uses = [
            arrays[related]
            for related in aliases.related(name)
            if related in arrays and read.is_affected_by(arrays[related])
        ]
        first = min(uses, key=lambda use: use.place, default=None)
        if first is None or not name.name:
            continue
        if first.name is not name:
            symbols.report(messages.TOGETHER_ALIAS, span, name=name.name, array=first.name.name)
        elif id(read.expr) not in bases:
            symbols.report(messages.TOGETHER_USED, span, name=name.name)


def _filled(targets: Sequence[Element], aliases: Aliases) -> dict[Named, _Filled]:
    """The arrays whose elements are assigned, by the representative of their aliases."""
    found: dict[Named, _Filled] = {}
    for place, target in enumerate(targets):
        name = named(base(target))
        assert name is not None
        dimensions = _dimensions(target.array.type)
        filled = found.setdefault(aliases.of(name), _Filled(name, dimensions, place))
        filled.dimensions = min(filled.dimensions, dimensions)
    return found


def _dimensions(kind: Type) -> int:
    """The number of `[]` of a type."""
    found = 0
    while isinstance(kind, ArrayType):
        kind, found = kind.element, found + 1
    return found


def _reads(block: Together) -> Iterator[_Read]:
    """Every variable and field in a together. The length of an array is not a read, since it never
    changes.
    """
    for stmt in all_statements(block.body):
        lengths: dict[int, int] = {}
        for part in (part for value in statement_expressions(stmt) for part in descendants(value)):
            if isinstance(part, LibraryCall) and part.operation == ARRAY_LENGTH:
                lengths[id(base(part.arguments[0]))] = depth(part.arguments[0])
            if (name := named(part)) is not None:
                yield _Read(part, name, lengths.get(id(part), _dimensions(name.type)))
