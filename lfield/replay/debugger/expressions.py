"""Expressions of L over the variables and device readings of a moment: `battery < 0.3 && leg == 2`.

Names are variables of the frame, of the frames below, fields of the agent, and readings of devices
(`battery`, `fc.battery`, `lead.fc.battery`). Of calls only `length()` is evaluated: others could have side
effects.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple, cast

from lfield.bytecode.program import DEVICE
from lfield.errors import UsageError
from lfield.lang import syntax
from lfield.lang.parser.expressions import expression
from lfield.lang.parser.token_stream import ParsingAborted, SyntaxRecovery, TokenStream
from lfield.lang.scanner import scan
from lfield.replay.debugger.device_readings import DeviceReading, device_readings, reading_named
from lfield.replay.debugger.frames import reader_of
from lfield.replay.debugger.moment import Moment
from lfield.replay.debugger.value_tree import NamedMember, ValueReader, Variable
from lfield.text.source_text import Diagnostics, Source
from lfield.vm.engine_interface import Trap
from lfield.vm.reference.arithmetic import INT, REAL

_ARITHMETIC: Mapping[str, tuple[Callable[[Any, Any], object], Callable[[Any, Any], object]]] = {
    "+": (operator.add, operator.add),
    "-": (operator.sub, operator.sub),
    "*": (operator.mul, operator.mul),
    "/": (INT["divi"], REAL["divf"]),
    "%": (INT["mod"], REAL["modf"]),
}
_COMPARISONS: Mapping[str, Callable[[Any, Any], object]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
#: The parts of expressions that are evaluated, and the reason why no others are.
_EVALUATED = (
    syntax.Literal_,
    syntax.Unary,
    syntax.Binary,
    syntax.Member,
    syntax.Index,
    syntax.Name,
    syntax.This,
)
_ONLY_READ = "the debugger reads values, and calls nothing but length(), since a call could change them"
#: Operators whose results are true or false.
_CONDITIONS = frozenset({"!", "&&", "||", "<", "<=", ">", ">=", "==", "!="})
#: The results of an expression without a value; null is a value. AWAY: its coordinator is on another host.
NO_VALUE, AWAY = object(), object()


class ValueUnknown(Exception):
    """An expression has no value at this moment; the message has the reason."""


class FoundValue(NamedTuple):
    """A value in the block of an agent: its type by index, and the word."""

    agent: str
    kind: int
    word: int


class WatchScope:
    """The names at a moment: of some frames, innermost first, and of the devices of the host.

    A frame is given by its agent and its place. `others` returns the readings of all hosts. Of two readings
    of one name, that of `agent` is used, by default that of the innermost frame.
    """

    def __init__(
        self,
        moment: Moment,
        frames: Sequence[tuple[str, int]] = (),
        others: Callable[[], Sequence[DeviceReading]] = tuple,
        agent: str = "",
    ) -> None:
        self._moment, self._frames, self._others = moment, frames, others
        self._agent = agent or (frames[0][0] if frames else "")

    def variable(self, name: str) -> FoundValue | None:
        """The variable or field of that name."""
        types = self._moment.table.program.core.types
        for agent, frame in self._frames:
            found = self._reader(agent).local(frame, name)
            if found is not None and types[found[0]].kind != DEVICE:
                return FoundValue(agent, *found)
        return None

    def reading(self, path: tuple[str, ...]) -> object:
        """The value of a device reading. Raises ValueUnknown."""
        found = reading_named(device_readings(self._moment), path, self._agent)
        found = found or reading_named(self._others(), path, self._agent)
        if found is None:
            raise ValueUnknown(f"{'.'.join(path)} is not known here")
        return found.value

    def enum_member(self, path: tuple[str, ...]) -> NamedMember | None:
        """The member of an enum that a path such as `Phase.LIFT` names."""
        program = self._moment.table.program
        index = program.class_index.get(path[0], -1) if len(path) == 2 else -1
        if index not in program.core.enum_classes:
            return None
        names = [field.name for field in program.core.classes[index].fields]
        return NamedMember(names.index(path[1]), path[1]) if path[1] in names else None

    def part(self, owner: FoundValue, name: str) -> FoundValue | None:
        """A field or an element of a value."""
        found = self._reader(owner.agent).part(owner[1:], name)
        return None if found is None else FoundValue(owner.agent, *found)

    def length(self, owner: FoundValue) -> int | None:
        """The number of elements of an array."""
        return self._reader(owner.agent).length(owner[1:])

    def plain(self, value: FoundValue) -> object:
        """A value, for comparisons."""
        return self._reader(value.agent).plain(value[1:])

    def content(self, value: FoundValue) -> object:
        """A value with its parts, for comparisons with one at another time."""
        return self._reader(value.agent).content(value[1:])

    def described(self, name: str, value: FoundValue) -> Variable:
        """A value with its texts."""
        return reader_of(self._moment, value.agent).variable(name, value.kind, value.word)

    def _reader(self, agent: str) -> ValueReader:
        return ValueReader(self._moment.agents[agent].block, self._moment.table.program)


def value_text(value: object) -> str:
    """A value without parts, as in L."""
    if value is None:
        return "null"
    return str(value).lower() if isinstance(value, bool) else str(value)


class WatchExpression:
    """A parsed expression. Raises UsageError for a mistake in it."""

    def __init__(self, text: str) -> None:
        self.text = text
        found = Diagnostics()
        stream = TokenStream(scan(Source("", text), found, end="the end of the expression"), found)
        tree = None
        with suppress(SyntaxRecovery, ParsingAborted):
            tree = expression(stream)
        mistakes = found.in_order()
        if mistakes or tree is None or not stream.at_end():
            reason = mistakes[0].message if mistakes else "it is not one expression"
            raise UsageError(f"'{text}' cannot be evaluated: {reason}")
        if not all(isinstance(node, _EVALUATED) for node in _nodes(tree)):
            raise UsageError(f"'{text}' cannot be evaluated: {_ONLY_READ}")
        self._tree = tree

    @property
    def names(self) -> set[str]:
        """The names that may be those of variables: of `lead.fc.battery` the first part."""
        nodes = list(_nodes(self._tree))
        this = {"this" for node in nodes if isinstance(node, syntax.This)}
        return this | {node.name for node in nodes if isinstance(node, syntax.Name)}

    @property
    def may_be_condition(self) -> bool:
        """Whether the expression can be true or false."""
        match self._tree:
            case syntax.Literal_(value=value):
                return isinstance(value, bool)
            case syntax.Unary(operator=operator) | syntax.Binary(operator=operator):
                return operator in _CONDITIONS
        return True

    def value(self, scope: WatchScope) -> object:
        """The value of the expression. Raises ValueUnknown."""
        return _plain(self._tree, scope)

    def variable(self, scope: WatchScope) -> FoundValue | None:
        """The variable that the expression names; None if it is another one. Raises ValueUnknown."""
        return _variable(self._tree, scope)

    def value_or_none(self, scope: WatchScope) -> object:
        """The value of the expression; None without one."""
        try:
            return self.value(scope)
        except ValueUnknown:
            return None

    def content(self, scope: WatchScope) -> object:
        """The value for comparisons with that at another time; NO_VALUE without one."""
        try:
            found = self.variable(scope)
            return self.value(scope) if found is None else scope.content(found)
        except ValueUnknown:
            return NO_VALUE


def _plain(tree: syntax.Expr, scope: WatchScope) -> object:
    match tree:
        case syntax.Literal_(value=value):
            return value
        case syntax.Unary(operator="!"):
            return not _truth(tree.operand, scope)
        case syntax.Unary(operator="-"):
            return _computed("*", -1, _plain(tree.operand, scope))
        case syntax.Binary(operator="&&"):
            return _truth(tree.left, scope) and _truth(tree.right, scope)
        case syntax.Binary(operator="||"):
            return _truth(tree.left, scope) or _truth(tree.right, scope)
        case syntax.Binary(operator=sign) if sign in _ARITHMETIC:
            return _computed(sign, _plain(tree.left, scope), _plain(tree.right, scope))
        case syntax.Binary(operator=sign) if sign in _COMPARISONS:
            return _compared(sign, _plain(tree.left, scope), _plain(tree.right, scope))
        case syntax.Call(function=syntax.Member() as function):
            return _plain(function, scope)
        case syntax.Member(name="length") if (found := _variable(tree.object, scope)) is not None:
            return _length(found, scope)
        case syntax.Name() | syntax.Member() | syntax.Index() | syntax.This():
            if (found := _variable(tree, scope)) is not None:
                return scope.plain(found)
            if (member := scope.enum_member(_path(tree))) is not None:
                return member
            if path := _path(tree):
                return scope.reading(path)
    raise ValueUnknown("it has a part that is not evaluated here")


def _truth(tree: syntax.Expr, scope: WatchScope) -> bool:
    value = _plain(tree, scope)
    if not isinstance(value, bool):
        raise ValueUnknown("it is not true or false")
    return value


def _computed(sign: str, left: object, right: object) -> object:
    """The result of arithmetic, computed as by the program."""
    if sign == "+" and isinstance(left, str) and isinstance(right, str):
        return left + right
    if not (_is_number(left) and _is_number(right)):
        raise ValueUnknown(f"{sign} is for numbers of the program")
    of_ints, of_reals = _ARITHMETIC[sign]
    is_int = isinstance(left, int) and isinstance(right, int)
    try:
        value = (of_ints if is_int else of_reals)(left, right)
    except (ZeroDivisionError, Trap):
        raise ValueUnknown("division by zero") from None
    if is_int and not -(1 << 63) <= cast(int, value) < 1 << 63:
        raise ValueUnknown("it has more than 64 bits")
    return value


def _compared(sign: str, left: object, right: object) -> object:
    is_same_type = type(left) is type(right) and (sign in ("==", "!=") or isinstance(left, str | NamedMember))
    is_with_null = sign in ("==", "!=") and (left is None or right is None)
    if not (is_same_type or is_with_null or (_is_number(left) and _is_number(right))):
        raise ValueUnknown(f"the sides of {sign} are of different types")
    return _COMPARISONS[sign](left, right)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _length(owner: FoundValue, scope: WatchScope) -> object:
    length = scope.length(owner)
    if length is not None:
        return length
    if (found := scope.part(owner, "length")) is None:
        raise ValueUnknown("it has no length")
    return scope.plain(found)


def _variable(tree: syntax.Expr, scope: WatchScope) -> FoundValue | None:
    match tree:
        case syntax.Name(name=name):
            return scope.variable(name)
        case syntax.This():
            return scope.variable("this")
        case syntax.Member(name=name):
            owner, part = _variable(tree.object, scope), name
        case syntax.Index():
            owner, part = _variable(tree.array, scope), f"[{_plain(tree.index, scope)}]"
        case _:
            return None
    if owner is None:
        return None
    if (found := scope.part(owner, part)) is None:
        raise ValueUnknown(f"it has no {part}")
    return found


def _nodes(tree: syntax.Expr) -> Iterator[syntax.Expr]:
    """The parts of an expression, and itself. Of calls only `length()` is evaluated and has parts."""
    match tree:
        case syntax.Call(function=syntax.Member(name="length") as length, arguments=[]):
            yield from _nodes(length)
            return
        case syntax.Unary():
            yield from _nodes(tree.operand)
        case syntax.Binary():
            yield from _nodes(tree.left)
            yield from _nodes(tree.right)
        case syntax.Member():
            yield from _nodes(tree.object)
        case syntax.Index():
            yield from _nodes(tree.array)
            yield from _nodes(tree.index)
    yield tree


def _path(tree: syntax.Expr) -> tuple[str, ...]:
    """The parts of a dotted name; () for any other expression."""
    match tree:
        case syntax.Name(name=name):
            return (name,)
        case syntax.Member(name=name):
            before = _path(tree.object)
            return (*before, name) if before else ()
    return ()
