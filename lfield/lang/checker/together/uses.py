"""What a `together` must leave alone: targets have no value yet, and arrays are about to get elements.

An array may have several names. Those that one method gives it are seen: whatever assigns one to the other,
anywhere in the method, makes them names of one array. What other methods do with it is not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from lfield.lang import messages
from lfield.lang.chains import inside, statements, values
from lfield.lang.checker.symbols import Symbols
from lfield.lang.library import ARRAY_LENGTH
from lfield.lang.tree import (
    Assign,
    Begin,
    Declare,
    Element,
    Elements,
    Expr,
    Field,
    FieldGet,
    Library,
    Local,
    LocalGet,
    Stmt,
    Together,
)
from lfield.lang.types import ArrayType

#: What has a name.
Named = Local | Field


def root(expr: Expr) -> Named | None:
    """The variable or field that an expression reads, or whose array it looks into."""
    return _named(_base(expr))


def _named(expr: Expr) -> Named | None:
    match expr:
        case LocalGet():
            return expr.local
        case FieldGet():
            return expr.field
    return None


class Aliases:
    """Which names of a method may be names of one array, or of arrays one inside the other."""

    def __init__(self, body: Sequence[Stmt]) -> None:
        self._of: dict[Named, Named] = {}
        for one in statements(body):
            if isinstance(one, Declare) and one.value is not None:
                self._join(one.local, one.value)
            for value in values(one):
                for part in inside(value):
                    if isinstance(part, Assign) and (target := root(part.target)) is not None:
                        self._join(target, part.value)

    def of(self, name: Named) -> Named:
        """The one that stands for all names of an array."""
        while name in self._of:
            name = self._of[name]
        return name

    def _join(self, name: Named, value: Expr) -> None:
        """After `name = value`."""
        if not isinstance(value.type, ArrayType):
            return
        for part in inside(value) if isinstance(value, Elements | Assign) else [value]:
            source = root(part) if isinstance(part.type, ArrayType) else None
            if source is not None and self.of(source) != self.of(name):
                self._of[self.of(source)] = self.of(name)


@dataclass(slots=True)
class _Array:
    """An array that a together assigns elements of: `a[i]` is 1 deep, `a[i][j]` 2."""

    name: Named
    depth: int


def check_uses(symbols: Symbols, block: Together, begun: Sequence[Begin], aliases: Aliases) -> None:
    """Report where a together reads, passes or assigns a target of its own, or the array of one."""
    targets = [one.target for one in begun if one.target is not None]
    variables = {target.local for target in targets if isinstance(target, LocalGet)}
    arrays: dict[Named, _Array] = {}
    for target in targets:
        if isinstance(target, Element) and (name := root(target)) is not None:
            array = arrays.setdefault(aliases.of(name), _Array(name, _depth(target)))
            array.depth = min(array.depth, _depth(target))
    own = {id(target) if isinstance(target, LocalGet) else id(_base(target)) for target in targets}
    assigned = {id(target) for target in targets}
    for read, name, length in _reads(block):
        filled = arrays.get(aliases.of(name))
        if name in variables and id(read) not in assigned:
            symbols.report(messages.TOGETHER_USED, read.span, name=name.name)
        elif filled is None or not name.name or (length is not None and length < filled.depth):
            continue
        elif name is not filled.name:
            symbols.report(messages.TOGETHER_ALIAS, read.span, name=name.name, array=filled.name.name)
        elif id(read) not in own:
            symbols.report(messages.TOGETHER_USED, read.span, name=name.name)


def _base(expr: Expr) -> Expr:
    """The array in `array[i][j]`."""
    while isinstance(expr, Element):
        expr = expr.array
    return expr


def _depth(expr: Expr) -> int:
    """How many indexes stand in `array[i][j]`."""
    depth = 0
    while isinstance(expr, Element):
        expr, depth = expr.array, depth + 1
    return depth


def _reads(block: Together) -> Iterator[tuple[Expr, Named, int | None]]:
    """Every variable and field in a together; where only a length is asked, of something how deep in it.

    The length of an array never changes.
    """
    for one in statements(block.body):
        lengths: dict[int, int] = {}
        for part in (part for value in values(one) for part in inside(value)):
            if isinstance(part, Library) and part.operation == ARRAY_LENGTH:
                array = part.arguments[0]
                lengths[id(_base(array))] = _depth(array)
            if (name := _named(part)) is not None:
                yield part, name, lengths.get(id(part))
