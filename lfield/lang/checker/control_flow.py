"""Control flow: warnings for statements and catches that are never reached, and missing returns."""

from __future__ import annotations

from collections.abc import Sequence

from lfield.lang import messages
from lfield.lang.checker.symbols import Symbols
from lfield.lang.tree import (
    BlockStmt,
    Break,
    Call,
    Continue,
    If,
    Literal_,
    Loop,
    Method,
    Reserve,
    Return,
    Stmt,
    Throw,
    Together,
    Try,
    Within,
)
from lfield.lang.tree_traversal import (
    all_statements,
    descendants,
    else_if,
    left_spine,
    nested_bodies,
    statement_expressions,
)
from lfield.lang.types import UNKNOWN, VOID, ClassType, Type, distance

_CAUSES: dict[type[Stmt], str] = {
    Return: "return",
    Break: "break",
    Continue: "continue",
    Throw: "throw",
    Loop: "endless loop",
}


_TIME_LIMIT = ClassType("TimeLimitException")


def check_flow(symbols: Symbols, method: Method) -> None:
    """Report the warnings of a method without errors. Falling off the end is legal (appendix D does it)."""
    falls_off = _Flow(symbols).completes(method.body)
    if falls_off and method.result not in (VOID, UNKNOWN):
        symbols.report(messages.MISSING_RETURN, method.end, method=f"{method.kind} {method.name}")


def _cause(terminator: Stmt) -> str:
    return _CAUSES.get(type(terminator), "statement that never ends")


def _may_limit(body: Sequence[Stmt]) -> bool:
    """Whether statements may throw a TimeLimitException of their own: by a `within`, a method or a throw."""
    return any(
        isinstance(stmt, Within | Throw)
        or any(isinstance(part, Call) for value in statement_expressions(stmt) for part in descendants(value))
        for stmt in all_statements(body)
    )


class _Flow:
    """A walk over the statements of a method."""

    def __init__(self, symbols: Symbols) -> None:
        self.symbols = symbols
        #: Every `try` whose `finally` never reaches its end: no jump out of it continues.
        self.swallowing: set[Try] = set()
        #: The number of enclosing `within` without a `finally` between.
        self.limits = 0

    def completes(self, body: Sequence[Stmt]) -> bool:
        """Whether control can reach the end of these statements."""
        return self.terminator(body) is None

    def terminator(self, body: Sequence[Stmt]) -> Stmt | None:
        """The first of these statements that control never passes; the statement after it is reported."""
        terminator: Stmt | None = None
        reported = False
        for stmt in body:
            if terminator is not None and not reported:
                cause = _cause(terminator)
                self.symbols.report(messages.UNREACHABLE, stmt.span, cause=cause)
                reported = True
            passes = self.statement_completes(stmt)
            if terminator is None and not passes:
                terminator = stmt
        return terminator

    def statement_completes(self, stmt: Stmt) -> bool:
        """Whether control can reach the end of a statement."""
        match stmt:
            case Return() | Break() | Continue() | Throw():
                return False
            case BlockStmt() | Together() | Reserve():
                return self.completes(stmt.body)
            case Within():
                return self.within(stmt)
            case If():
                ladder = [stmt, *reversed(left_spine(stmt, else_if))]
                ends = [self.completes(rung.then) for rung in ladder]
                return any([*ends, self.completes(ladder[-1].otherwise)])
            case Loop():
                self.completes(stmt.body)
                endless = isinstance(stmt.condition, Literal_) and stmt.condition.value is True
                return not endless or self.has_break(stmt.body)
            case Try():
                self.check_catches(stmt)
                ends = [self.completes(stmt.body), *(self.completes(clause.body) for clause in stmt.catches)]
                return self.finally_completes(stmt) and any(ends)
        return True

    def within(self, stmt: Within) -> bool:
        """Whether control can reach the end of a `within`."""
        self.limits += 1
        passes = self.completes(stmt.body)
        self.limits -= 1
        return passes

    def finally_completes(self, stmt: Try) -> bool:
        """Whether control can reach the end of the `finally`; without one, True."""
        limits, self.limits = self.limits, 0
        leaving = self.terminator(stmt.last or [])
        self.limits = limits
        if leaving is None:
            return True
        self.swallowing.add(stmt)
        self.symbols.report(messages.LOSING_FINALLY, leaving.span, cause=_cause(leaving))
        return False

    def check_catches(self, attempt: Try) -> None:
        """Report a catch with no exceptions left by earlier ones, or that the exception of a `within`
        around it skips.
        """
        earlier: list[Type] = []
        for clause in attempt.catches:
            kind = clause.local.type
            if self.limits and kind == _TIME_LIMIT and not _may_limit(attempt.body):
                self.symbols.report(messages.LIMIT_PASSES, clause.local.span)
            taker = next((e for e in earlier if distance(kind, e) is not None), None)
            if taker is not None:
                self.symbols.report(messages.UNREACHABLE_CATCH, clause.local.span, earlier=f"catch ({taker})")
            earlier.append(kind)

    def has_break(self, body: Sequence[Stmt]) -> bool:
        """Whether a break in a loop's body leaves this loop."""
        waiting = list(body)
        while waiting:
            stmt = waiting.pop()
            if isinstance(stmt, Break):
                return True
            if not isinstance(stmt, Loop) and stmt not in self.swallowing:
                waiting += [inner for part in nested_bodies(stmt) for inner in part]
        return False
