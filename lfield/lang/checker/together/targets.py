"""Where the results of a `together` go: locals declared outside it, or elements of arrays in such locals.

All assignments happen at its end, in the order of the calls. So a local is assigned once, and by one call.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lfield.lang import messages
from lfield.lang.chains import statements
from lfield.lang.checker.fitting import shown
from lfield.lang.checker.symbols import Symbols
from lfield.lang.checker.together.aliases import base, named
from lfield.lang.tree import (
    Begin,
    Call,
    Declare,
    Element,
    FieldGet,
    Local,
    LocalGet,
    PortalCall,
    Together,
    Try,
)
from lfield.lang.types import UNKNOWN


@dataclass(frozen=True, slots=True)
class Begun:
    """A call of a together, and whether it stands in a loop of it."""

    begin: Begin
    loop: bool


def taker(
    symbols: Symbols, target: LocalGet | FieldGet | Element, call: PortalCall | Call
) -> LocalGet | Element | None:
    """The target, if it can take the result of a call; if not, it is reported."""
    if isinstance(target, FieldGet) or not isinstance(named(base(target)), Local):
        symbols.report(messages.TOGETHER_TARGET, target.span)
        return None
    if target.type != call.type and UNKNOWN not in (target.type, call.type):
        wanted, given = shown(target.type), shown(call.type)
        symbols.report(messages.TOGETHER_TYPE, target.span, wanted=wanted, given=given)
        return None
    return target


def check_targets(symbols: Symbols, block: Together, begun: Sequence[Begun]) -> None:
    """Report targets that are declared in the block, and locals that it may assign twice."""
    declared = _declared(block)
    first: dict[Local, int] = {}
    for one in begun:
        target = one.begin.target
        local = None if target is None else named(base(target))
        if target is None or not isinstance(local, Local):
            continue
        if local in declared:
            symbols.report(messages.TOGETHER_DECLARED, target.span, name=local.name, type=local.type)
        elif isinstance(target, LocalGet) and local in first:
            symbols.report(messages.TOGETHER_TWICE, target.span, name=local.name, line=first[local])
        elif isinstance(target, LocalGet) and one.loop:
            symbols.report(messages.TOGETHER_LOOP, target.span, name=local.name)
        if isinstance(target, LocalGet):
            first.setdefault(local, target.span.line)


def _declared(block: Together) -> set[Local]:
    """The locals that are declared anywhere in a together."""
    found: set[Local] = set()
    for one in statements(block.body):
        if isinstance(one, Declare):
            found.add(one.local)
        elif isinstance(one, Try):
            found.update(clause.local for clause in one.catches)
    return found
