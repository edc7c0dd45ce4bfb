"""Where control can go: warnings for statements and catches that are never reached, and missing returns."""

from __future__ import annotations

from collections.abc import Sequence

from lfield.lang import messages
from lfield.lang.chains import bodies, chain, further
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
    Together,
    Try,
    Within,
)
from lfield.lang.types import UNKNOWN, VOID, Type, distance

_CAUSES: dict[type[Stmt], str] = {
    Return: "return",
    Break: "break",
    Continue: "continue",
    Throw: "throw",
    Loop: "endless loop",
}


def check_flow(symbols: Symbols, method: Method) -> None:
    """Report the warnings of a method without errors. Falling off the end is legal (appendix D does it)."""
    falls_off = _Flow(symbols).ends(method.body)
    if falls_off and method.result not in (VOID, UNKNOWN):
        symbols.report(messages.FALLS_OFF, method.end, method=f"{method.kind} {method.name}")


class _Flow:
    """A walk over the statements of a method."""

    def __init__(self, symbols: Symbols) -> None:
        self.symbols = symbols
        #: Every `try` whose `finally` never comes to its end: what leaves it goes no further.
        self.swallowing: set[Try] = set()

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
            case Block() | Together() | Within():
                return self.ends(one.body)
            case If():
                ladder = [one, *reversed(chain(one, further))]
                ends = [self.ends(rung.then) for rung in ladder]
                return any([*ends, self.ends(ladder[-1].otherwise)])
            case Loop():
                self.ends(one.body)
                endless = isinstance(one.condition, Literal_) and one.condition.value is True
                return not endless or self.has_break(one.body)
            case Try():
                self.catches(one.catches)
                ends = [self.ends(one.body), *(self.ends(clause.body) for clause in one.catches)]
                return self.last_ends(one) and any(ends)
        return True

    def last_ends(self, one: Try) -> bool:
        """Whether control can come to the end of the `finally`; without one it is there already."""
        if one.last is None or self.ends(one.last):
            return True
        self.swallowing.add(one)
        leaving = next((last for last in one.last if not self.passes(last)), one)
        cause = _CAUSES.get(type(leaving), "statement that never ends")
        self.symbols.report(messages.LOSING_FINALLY, leaving.span, cause=cause)
        return False

    def catches(self, clauses: Sequence[Catch]) -> None:
        """Report a catch that an earlier one of the same try leaves nothing for."""
        earlier: list[Type] = []
        for clause in clauses:
            kind = clause.local.type
            taker = next((e for e in earlier if distance(kind, e) is not None), None)
            if taker is not None:
                self.symbols.report(messages.UNREACHABLE_CATCH, clause.local.span, earlier=f"catch ({taker})")
            earlier.append(kind)

    def has_break(self, body: Sequence[Stmt]) -> bool:
        """Whether a break in a loop's body leaves this loop."""
        waiting = list(body)
        while waiting:
            one = waiting.pop()
            if isinstance(one, Break):
                return True
            if isinstance(one, Try) and one in self.swallowing:
                waiting += one.last or []
            elif not isinstance(one, Loop):
                waiting += [inner for part in bodies(one) for inner in part]
        return False
