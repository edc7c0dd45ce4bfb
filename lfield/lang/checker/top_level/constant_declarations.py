"""Constants of the top level: their values are computed here, so that each use is a literal.

A constant may use others wherever they are declared; a value that depends on itself is reported.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lfield.lang import messages, syntax, tree
from lfield.lang.checker.conversions import require_type, with_article
from lfield.lang.checker.expressions import value
from lfield.lang.checker.scope import constant_context, function_unit
from lfield.lang.checker.symbols import Symbols
from lfield.lang.checker.top_level.constant_values import NotComputable, constant_value
from lfield.lang.checker.visibility import visible_type
from lfield.lang.types import BOOLEAN, INT, REAL, STRING, UNKNOWN, EnumType


def declare_constants(symbols: Symbols, constants: Sequence[syntax.Constant]) -> None:
    """Compute the values of all constants of a program; mistakes are reported."""
    _Constants(symbols, constants).declare()


class _Constants:
    """The constants of a program, each computed after those that it names."""

    def __init__(self, symbols: Symbols, constants: Sequence[syntax.Constant]) -> None:
        self._symbols = symbols
        self._raw = {constant.name: constant for constant in constants}
        self._uses = {name: _constant_names(raw.value, self._raw) for name, raw in self._raw.items()}

    def declare(self) -> None:
        done: set[str] = set()
        for name in self._raw:
            self._resolve(name, done)

    def _resolve(self, first: str, done: set[str]) -> None:
        """Compute a constant after those that it needs, without recursion."""
        path: list[str] = []
        waiting: list[tuple[str, Iterator[str]]] = [(first, iter(self._uses[first]))]
        while waiting:
            name, uses = waiting[-1]
            if name not in path:
                path.append(name)
            following = next((use for use in uses if use not in done), None)
            if following is None:
                waiting.pop()
                path.pop()
                if name not in done:
                    done.add(name)
                    self._compute(self._raw[name])
            elif following in path:
                self._report_cycle(path[path.index(following) :], done)
            else:
                waiting.append((following, iter(self._uses[following])))

    def _report_cycle(self, cycle: Sequence[str], done: set[str]) -> None:
        """Report the constants of a cycle, which have no value, once."""
        path = " - ".join([*cycle, cycle[0]])
        span = self._raw[cycle[0]].span
        self._symbols.report(messages.CONSTANT_CYCLE, span, name=cycle[0], path=path)
        done.update(cycle)

    def _compute(self, raw: syntax.Constant) -> None:
        symbols = self._symbols
        kind = visible_type(symbols, function_unit(raw.name, raw.span), raw.type)
        if kind not in (BOOLEAN, INT, REAL, STRING, UNKNOWN) and not isinstance(kind, EnumType):
            symbols.report(messages.CONSTANT_TYPE, raw.type.span, given=with_article(kind))
            return
        found = len(symbols.found.found)
        body = constant_context(symbols, raw.name, raw.span)
        checked = require_type(symbols, value(body, raw.value), kind)
        if len(symbols.found.found) > found or UNKNOWN in (checked.type, kind):
            return
        try:
            computed = constant_value(checked)
        except NotComputable as error:
            if error.problem:
                symbols.report(
                    messages.CONSTANT_VALUE,
                    error.place,
                    hint=error.hint,
                    name=raw.name,
                    problem=error.problem,
                )
            else:
                symbols.report(messages.NOT_CONSTANT, error.place, name=raw.name)
            return
        symbols.constants[raw.name] = tree.Constant(raw.name, kind, computed, raw.span)


def _constant_names(raw: syntax.Expr, known: dict[str, syntax.Constant]) -> list[str]:
    """The constants that an expression names."""
    names: list[str] = []
    waiting: list[object] = [raw]
    while waiting:
        match waiting.pop():
            case syntax.Name(name=name) if name in known:
                names.append(name)
            case syntax.Unary(operand=operand):
                waiting.append(operand)
            case syntax.Binary(left=left, right=right):
                waiting += [left, right]
            case syntax.Member(object=owner):
                waiting.append(owner)
            case syntax.Call(function=function, arguments=arguments):
                waiting += [function, *arguments]
    return names
