"""Expressions of L over the variables and device readings of a moment: `battery < 0.3 && leg == 2`.

Names are variables of the frame, of the frames below, fields of the agent, and readings of devices
(`battery`, `fc.battery`, `lead.fc.battery`). Calls are not evaluated: they could have side effects.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from lfield.errors import UsageError
from lfield.lang import syntax
from lfield.lang.parser.expressions import expression
from lfield.lang.parser.token_stream import ParsingAborted, SyntaxRecovery, TokenStream
from lfield.lang.scanner import scan
from lfield.replay.debugger.device_readings import reading_named
from lfield.replay.debugger.frames import StackFrame, reader_of
from lfield.replay.debugger.moment import Moment
from lfield.replay.debugger.value_tree import Variable
from lfield.text.source_text import Diagnostics, Source

_OPERATORS: Mapping[str, Callable[[Any, Any], object]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "%": operator.mod,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}


class ValueUnknown(Exception):
    """An expression has no value at this moment; the message says why."""


class WatchScope:
    """The names at a moment: of some frames, innermost first, and of the devices of the host."""

    def __init__(self, moment: Moment, frames: Sequence[StackFrame]) -> None:
        self._moment, self._frames = moment, frames

    def variable(self, name: str) -> tuple[Variable, str] | None:
        """The variable or field of that name, and the agent that has it."""
        for frame in self._frames:
            reader = reader_of(self._moment, frame.key.agent)
            known = reader.locals(frame.frame)
            fields = [part for each in known if each.name == "this" for part in reader.parts(each)]
            for each in (*known, *fields):
                if each.name == name and each.type != "device":
                    return each, frame.key.agent
        return None

    def reading(self, path: tuple[str, ...]) -> object:
        """The value of a device reading. Raises ValueUnknown."""
        agent = self._frames[0].key.agent if self._frames else ""
        found = reading_named(self._moment, path, agent)
        if found is None:
            raise ValueUnknown(f"{'.'.join(path)} is not known here")
        return found.value

    def parts(self, variable: Variable, agent: str) -> list[Variable]:
        """The parts of a variable of an agent."""
        return reader_of(self._moment, agent).parts(variable)

    def plain(self, variable: Variable, agent: str) -> object:
        """The value of a variable, for comparisons."""
        return reader_of(self._moment, agent).plain(variable)


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
            why = mistakes[0].message if mistakes else "it is not one expression"
            raise UsageError(f"'{text}' cannot be evaluated: {why}")
        self._tree = tree

    def value(self, scope: WatchScope) -> object:
        """Its value. Raises ValueUnknown."""
        return _plain(self._tree, scope)

    def variable(self, scope: WatchScope) -> tuple[Variable, str] | None:
        """The variable that it names, with its agent; None if it is another expression."""
        return _variable(self._tree, scope)

    def value_or_none(self, scope: WatchScope) -> object:
        """Its value; None where it has none."""
        try:
            return self.value(scope)
        except ValueUnknown:
            return None


def _plain(tree: syntax.Expr, scope: WatchScope) -> object:
    match tree:
        case syntax.Literal_(value=value):
            return value
        case syntax.Unary(operator="!"):
            return not _plain(tree.operand, scope)
        case syntax.Unary(operator="-"):
            return _number(tree.operand, scope) * -1
        case syntax.Binary(operator="&&"):
            return bool(_plain(tree.left, scope)) and bool(_plain(tree.right, scope))
        case syntax.Binary(operator="||"):
            return bool(_plain(tree.left, scope)) or bool(_plain(tree.right, scope))
        case syntax.Binary() if tree.operator in _OPERATORS:
            return _binary(tree, scope)
        case syntax.Member(name="length") if (found := _variable(tree.object, scope)) is not None:
            return len(scope.parts(*found))
        case syntax.Name() | syntax.Member() | syntax.Index() | syntax.This():
            if (found := _variable(tree, scope)) is not None:
                return scope.plain(*found)
            if path := _path(tree):
                return scope.reading(path)
    raise ValueUnknown("it has a part that is not evaluated here")


def _binary(tree: syntax.Binary, scope: WatchScope) -> object:
    left, right = _plain(tree.left, scope), _plain(tree.right, scope)
    try:
        value = _OPERATORS[tree.operator](left, right)
    except ZeroDivisionError:
        raise ValueUnknown("division by zero") from None
    except TypeError:
        raise ValueUnknown(f"the sides of {tree.operator} are of different types") from None
    whole = tree.operator == "/" and type(left) is int and type(right) is int
    return int(value) if whole and isinstance(value, float) else value


def _number(tree: syntax.Expr, scope: WatchScope) -> float:
    value = _plain(tree, scope)
    if not isinstance(value, int | float):
        raise ValueUnknown("it is not a number")
    return value


def _variable(tree: syntax.Expr, scope: WatchScope) -> tuple[Variable, str] | None:
    match tree:
        case syntax.Name(name=name):
            return scope.variable(name)
        case syntax.This():
            return scope.variable("this")
        case syntax.Member(name=name):
            part = name
        case syntax.Index():
            part = f"[{_plain(tree.index, scope)}]"
        case _:
            return None
    owner = _variable(tree.object if isinstance(tree, syntax.Member) else tree.array, scope)
    if owner is None:
        return None
    found = next((each for each in scope.parts(*owner) if each.name == part), None)
    if found is None:
        raise ValueUnknown(f"{owner[0].name} has no {part}")
    return found, owner[1]


def _path(tree: syntax.Expr) -> tuple[str, ...]:
    """The parts of a dotted name; () for anything else."""
    match tree:
        case syntax.Name(name=name):
            return (name,)
        case syntax.Member(name=name):
            before = _path(tree.object)
            return (*before, name) if before else ()
    return ()
