"""Targets for the results of a `together`: locals declared outside it, or elements of arrays in such locals.

All assignments happen at the end of the block, in the order of the calls. So a local is assigned once, by one
call.
"""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct

from lfield.lang import messages
from lfield.lang.checker.conversions import with_article
from lfield.lang.checker.symbols import Symbols
from lfield.lang.checker.together.aliases import base, named
from lfield.lang.tree import (
    Call,
    Declare,
    Element,
    FieldGet,
    Local,
    LocalGet,
    PortalCall,
    StartCall,
    Together,
    Try,
)
from lfield.lang.tree_traversal import all_statements
from lfield.lang.types import UNKNOWN


class StartedCall(Struct, frozen=True):
    """A call of a together, and whether it is in a loop of it."""

    start: StartCall
    loop: bool


def result_target(
    symbols: Symbols, target: LocalGet | FieldGet | Element, call: PortalCall | Call
) -> LocalGet | Element | None:
    """The target, if it can take the result of a call; if not, it is reported."""
    if isinstance(target, FieldGet) or not isinstance(named(base(target)), Local):
        symbols.report(messages.TOGETHER_TARGET, target.span)
        return None
    if target.type != call.type and UNKNOWN not in (target.type, call.type):
        expected, actual = with_article(target.type), with_article(call.type)
        symbols.report(messages.TOGETHER_TYPE, target.span, expected=expected, given=actual)
        return None
    return target


def check_targets(symbols: Symbols, block: Together, started: Sequence[StartedCall]) -> None:
    """Report targets that are declared in the block, and locals that it may assign twice."""
    declared = _declared(block)
    first: dict[Local, int] = {}
    for call in started:
        target = call.start.target
        local = None if target is None else named(base(target))
        if target is None or not isinstance(local, Local):
            continue
        if local in declared:
            symbols.report(messages.TOGETHER_DECLARED, target.span, name=local.name, type=local.type)
        elif isinstance(target, LocalGet) and local in first:
            symbols.report(messages.TOGETHER_DOUBLE_TARGET, target.span, name=local.name, line=first[local])
        elif isinstance(target, LocalGet) and call.loop:
            symbols.report(messages.TOGETHER_LOOP, target.span, name=local.name)
        if isinstance(target, LocalGet):
            first.setdefault(local, target.span.line)


def _declared(block: Together) -> set[Local]:
    """The locals that are declared anywhere in a together."""
    found: set[Local] = set()
    for stmt in all_statements(block.body):
        if isinstance(stmt, Declare):
            found.add(stmt.local)
        elif isinstance(stmt, Try):
            found.update(clause.local for clause in stmt.catches)
    return found
