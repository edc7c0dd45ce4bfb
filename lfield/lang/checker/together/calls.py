"""Which portal calls a `together` begins: those that stand alone in it, or right of an assignment.

The body of a method is checked as if there were no `together`; then each of them takes its calls.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from lfield.lang import messages
from lfield.lang.capabilities import is_portal
from lfield.lang.chains import bodies, inside, parts, statements, values
from lfield.lang.checker.symbols import Symbols
from lfield.lang.checker.together.aliases import Aliases
from lfield.lang.checker.together.targets import Begun, check_targets, taker
from lfield.lang.checker.together.uses import check_uses
from lfield.lang.tree import (
    Assign,
    Begin,
    Call,
    Declare,
    Evaluate,
    Expr,
    Local,
    Loop,
    PortalCall,
    Reserve,
    Stmt,
    Together,
    ToReal,
    Try,
    Within,
)


@dataclass(frozen=True, slots=True)
class _Place:
    """Where statements of a together stand: whether in a loop, and the word that bars calls there."""

    loop: bool = False
    barred: str = ""


def begin_calls(symbols: Symbols, body: list[Stmt], *, whole: bool) -> None:
    """Make the calls of every together in a body to `Begin`s; what cannot be begun is reported.

    A body that is not `whole` has mistakes: calls may be missing.
    """
    blocks = [one for one in statements(body) if isinstance(one, Together)]
    aliases = Aliases(body if blocks else [])
    for block in blocks:
        before = len(symbols.found.found)
        begun = _Calls(symbols).taken(block)
        if not begun and whole and len(symbols.found.found) == before:
            symbols.report(messages.TOGETHER_EMPTY, block.span)
        check_targets(symbols, block, begun)
        check_uses(symbols, block, [one.begin for one in begun], aliases)


class _Calls:
    """The calls of one together; those of one inside it are its own."""

    def __init__(self, symbols: Symbols) -> None:
        self.symbols = symbols
        self.begun: list[Begun] = []

    def taken(self, block: Together) -> list[Begun]:
        """What it begins, in the order of the text."""
        waiting = [(block.body, _Place())]
        while waiting:
            body, place = waiting.pop()
            for at, one in enumerate(body):
                body[at] = self.statement(one, place)
                waiting += _inner(one, place)
        return sorted(self.begun, key=lambda one: one.begin.span.start)

    def statement(self, one: Stmt, place: _Place) -> Stmt:
        """The statement, or the call that it begins."""
        match one:
            case Together():
                return one
            case Reserve():
                self.symbols.report(messages.RESERVE_INSIDE, one.span)
            case Evaluate(value=value) if not place.barred and (call := _called(value)):
                return self.begin(Begin(one.span, call, None), place)
            case Evaluate(value=Assign(target=target, value=value)) if not place.barred and (
                call := _called(value)
            ):
                if (place_of_it := taker(self.symbols, target, call)) is not None:
                    return self.begin(Begin(one.span, call, place_of_it), place)
            case Declare(local=Local(name=str() as name) as local, value=Expr() as value) if (
                name and not place.barred and _called(value)
            ):
                self.symbols.report(messages.TOGETHER_DECLARED, local.span, name=name, type=local.type)
            case _:
                for value in values(one):
                    self.refuse(value, place)
        return one

    def begin(self, made: Begin, place: _Place) -> Begin:
        """Keep a call that is begun; no other call is part of it."""
        for value in [*parts(made.call), *(parts(made.target) if made.target is not None else [])]:
            self.refuse(value, place)
        self.begun.append(Begun(made, place.loop))
        return made

    def refuse(self, value: Expr, place: _Place) -> None:
        """Report the calls inside an expression."""
        for one in inside(value):
            if _called(one) is one and place.barred:
                self.symbols.report(messages.TOGETHER_BARRED, one.span, word=place.barred)
            elif _called(one) is one:
                self.symbols.report(messages.TOGETHER_INSIDE, one.span)


def _called(value: Expr) -> PortalCall | Call | None:
    """The call of a portal, or of a portal of an offer, that an expression is; widened or as it is."""
    one = value.operand if isinstance(value, ToReal) else value
    if isinstance(one, PortalCall) or (isinstance(one, Call) and is_portal(one.method)):
        return one
    return None


def _inner(one: Stmt, place: _Place) -> list[tuple[list[Stmt], _Place]]:
    """The bodies of a statement that are the together's own, with their places."""
    match one:
        case Together() | Reserve():
            return []
        case Loop():
            place = replace(place, loop=True)
        case Within():
            place = replace(place, barred=place.barred or "within")
        case Try():
            place = replace(place, barred=place.barred or "try")
    return [(body, place) for body in bodies(one)]
