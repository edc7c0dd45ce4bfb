"""Portal calls that a `together` starts: those that are statements, or the right side of an assignment.

The body of a method is checked as if it had no `together`; then the calls of each `together` are collected.
"""

from __future__ import annotations

from msgspec import Struct
from msgspec.structs import replace

from lfield.lang import messages
from lfield.lang.capability_port import is_portal
from lfield.lang.checker.symbols import Symbols
from lfield.lang.checker.together.aliases import Aliases
from lfield.lang.checker.together.result_targets import StartedCall, check_targets, result_target
from lfield.lang.checker.together.target_uses import check_uses
from lfield.lang.tree import (
    Assign,
    Async,
    Call,
    Declare,
    Evaluate,
    Expr,
    Local,
    Loop,
    PortalCall,
    Reserve,
    StartCall,
    Stmt,
    Together,
    ToReal,
    Try,
    Within,
)
from lfield.lang.tree_traversal import (
    all_statements,
    descendants,
    nested_bodies,
    statement_expressions,
    subexpressions,
)


class _CallSite(Struct, frozen=True):
    """The context of statements of a together: in a loop, and inside which forbidding keyword."""

    loop: bool = False
    barring_keyword: str = ""


def mark_started_calls(symbols: Symbols, body: list[Stmt], *, whole: bool) -> None:
    """Convert the calls of every together in a body to `StartCall`s; report those that cannot be started.

    A body that is not `whole` has errors: calls may be missing.
    """
    blocks = [stmt for stmt in all_statements(body) if isinstance(stmt, Together)]
    aliases = Aliases(body if blocks else [])
    for block in blocks:
        before = len(symbols.found.found)
        started = _StartedCalls(symbols).collect(block)
        if not started and whole and len(symbols.found.found) == before:
            symbols.report(messages.TOGETHER_EMPTY, block.span)
        check_targets(symbols, block, started)
        check_uses(symbols, block, [call.start for call in started], aliases)


class _StartedCalls:
    """The calls of one `together`, without those of a nested one."""

    def __init__(self, symbols: Symbols) -> None:
        self.symbols = symbols
        self.started: list[StartedCall] = []

    def collect(self, block: Together) -> list[StartedCall]:
        """The calls that a `together` starts, in the order of the text."""
        waiting = [(block.body, _CallSite())]
        while waiting:
            body, place = waiting.pop()
            for at, stmt in enumerate(body):
                body[at] = self.statement(stmt, place)
                waiting += _inner(stmt, place)
        return sorted(self.started, key=lambda call: call.start.span.start)

    def statement(self, stmt: Stmt, place: _CallSite) -> Stmt:
        """The statement, or the call that it starts."""
        match stmt:
            case Together():
                return stmt
            case Reserve():
                self.symbols.report(messages.RESERVE_INSIDE, stmt.span)
            case Evaluate(value=value) if not place.barring_keyword and (call := _portal_call(value)):
                return self.start_call(StartCall(stmt.span, call, None), place)
            case Evaluate(value=Assign(target=target, value=value)) if not place.barring_keyword and (
                call := _portal_call(value)
            ):
                if (place_of_it := result_target(self.symbols, target, call)) is not None:
                    return self.start_call(StartCall(stmt.span, call, place_of_it), place)
            case Declare(local=Local(name=str() as name) as local, value=Expr() as value) if (
                name and not place.barring_keyword and _portal_call(value)
            ):
                self.symbols.report(messages.TOGETHER_DECLARED, local.span, name=name, type=local.type)
            case _:
                for value in statement_expressions(stmt):
                    self.refuse(value, place)
        return stmt

    def start_call(self, call: StartCall, place: _CallSite) -> StartCall:
        """Add a call that is started; no other call is part of it."""
        for value in [
            *subexpressions(call.call),
            *(subexpressions(call.target) if call.target is not None else []),
        ]:
            self.refuse(value, place)
        self.started.append(StartedCall(call, place.loop))
        return call

    def refuse(self, value: Expr, place: _CallSite) -> None:
        """Report the calls inside an expression."""
        started = {id(part.call) for part in descendants(value) if isinstance(part, Async)}
        for part in descendants(value):
            if isinstance(part, Async):
                self.symbols.report(messages.ASYNC_TOGETHER, part.span)
            elif id(part) in started:
                continue
            elif _portal_call(part) is part and place.barring_keyword:
                self.symbols.report(messages.TOGETHER_BARRED, part.span, keyword=place.barring_keyword)
            elif _portal_call(part) is part:
                self.symbols.report(messages.TOGETHER_INSIDE, part.span)


def _portal_call(value: Expr) -> PortalCall | Call | None:
    """The call of a portal, or of a portal of an offer, in an expression; widened or unchanged."""
    call = value.operand if isinstance(value, ToReal) else value
    if isinstance(call, PortalCall) or (isinstance(call, Call) and is_portal(call.method)):
        return call
    return None


def _inner(stmt: Stmt, place: _CallSite) -> list[tuple[list[Stmt], _CallSite]]:
    """The bodies of a statement that are the together's own, with their places."""
    match stmt:
        case Together() | Reserve():
            return []
        case Loop():
            place = replace(place, loop=True)
        case Within():
            place = replace(place, barring_keyword=place.barring_keyword or "within")
        case Try():
            place = replace(place, barring_keyword=place.barring_keyword or "try")
    return [(body, place) for body in nested_bodies(stmt)]
