"""Where control can go: warnings for statements and catches that are never reached, and missing returns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lfield.lang import messages
from lfield.lang.checker.symbols import Symbols
from lfield.lang.tree import (
    Block,
    Break,
    Catch,
    Continue,
    If,
    Literal_,
    Loop,
    Method,
    Return,
    Stmt,
    Throw,
    Try,
)
from lfield.lang.types import BOOLEAN, EXCEPTION, INT, REAL, UNKNOWN, VOID, Type

_CAUSES: dict[type[Stmt], str] = {
    Return: "return",
    Break: "break",
    Continue: "continue",
    Throw: "throw",
    Loop: "endless loop",
}
_DEFAULTS: dict[Type, str] = {INT: "0", REAL: "0.0", BOOLEAN: "false"}


def check_flow(symbols: Symbols, method: Method) -> None:
    """Report the warnings of a method without errors. Falling off the end is legal (appendix D does it)."""
    falls_off = _Flow(symbols).ends(method.body)
    if falls_off and method.result not in (VOID, UNKNOWN):
        default = _DEFAULTS.get(method.result, "null")
        name = f"{method.kind} {method.name}"
        symbols.report(messages.FALLS_OFF, method.end, method=name, default=default)


class _Flow:
    """A walk over the statements of a method."""

    def __init__(self, symbols: Symbols) -> None:
        self.symbols = symbols

    def ends(self, body: Sequence[Stmt]) -> bool:
        """Whether control can come to the end of these statements; the first unreachable one is reported."""
        reached = True
        blocker: Stmt | None = None
        for one in body:
            if not reached and blocker is not None:
                cause = _CAUSES.get(type(blocker), "statement that never ends")
                self.symbols.report(messages.UNREACHABLE, one.span, cause=cause)
                blocker = None
            passes = self.passes(one)
            if reached and not passes:
                reached, blocker = False, one
        return reached

    def passes(self, one: Stmt) -> bool:
        """Whether control can come to the end of a statement."""
        match one:
            case Return() | Break() | Continue() | Throw():
                return False
            case Block():
                return self.ends(one.body)
            case If():
                ends = [self.ends(one.then), self.ends(one.otherwise)]
                return any(ends)
            case Loop():
                self.ends(one.body)
                endless = isinstance(one.condition, Literal_) and one.condition.value is True
                return not endless or any(_breaks(one.body))
            case Try():
                self.catches(one.catches)
                ends = [self.ends(one.body), *(self.ends(clause.body) for clause in one.catches)]
                return any(ends)
        return True

    def catches(self, clauses: Sequence[Catch]) -> None:
        """Report a catch that an earlier one of the same try leaves nothing for."""
        earlier: list[Type] = []
        for clause in clauses:
            kind = clause.local.type
            taker = next((e for e in earlier if e in (EXCEPTION, kind)), None)
            if taker is not None:
                self.symbols.report(messages.UNREACHABLE_CATCH, clause.local.span, earlier=f"catch ({taker})")
            earlier.append(kind)


def _breaks(body: Sequence[Stmt]) -> Iterator[bool]:
    """True for every break in a loop's body that leaves this loop."""
    for one in body:
        match one:
            case Break():
                yield True
            case Block():
                yield from _breaks(one.body)
            case If():
                yield from _breaks([*one.then, *one.otherwise])
            case Try():
                yield from _breaks(one.body)
                for clause in one.catches:
                    yield from _breaks(clause.body)
