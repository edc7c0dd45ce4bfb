"""Loops of resources: their declarations, and calls of their methods.

A loop is declared with three fields that have no name in L; `running()` and `overruns()` read two of them.
The statements of its thread are made later, when all loops are known (`checker/loops`).
"""

from __future__ import annotations

from lfield.lang import messages, syntax, tree
from lfield.lang.checker.conversions import OverloadCandidate, choose_overload, unknown
from lfield.lang.checker.scope import BodyContext
from lfield.lang.checker.symbols import Symbols
from lfield.lang.types import BOOLEAN, INT, VOID

#: The most loops of a resource: each is a thread, and threads for portals must remain.
MAX_LOOPS = 16


def add_loop(unit: tree.Unit, body: tree.Method, head: syntax.LoopHead) -> None:
    """Add the loop with that body to its resource."""
    name, span = body.name, body.span
    ticks = tree.Method(name, "ticks", unit, [], VOID, False, False, span, span)
    fields = [
        unit.add_hidden_field(f"{name}.{field}", kind, span)
        for field, kind in (("running", BOOLEAN), ("engaged", BOOLEAN), ("overruns", INT))
    ]
    unit.add_loop(tree.ResourceLoop(body, ticks, head.priority, *fields))


def declare_loops(symbols: Symbols, unit: tree.Unit) -> None:
    """Report loops that conflict with fields, and those that are too many."""
    for loop in unit.loops:
        field = unit.field(loop.body.name)
        if field is not None:
            line = field.span.line
            symbols.report(messages.LOOP_NAME, loop.body.span, name=loop.body.name, line=line)
    if len(unit.loops) > MAX_LOOPS:
        last = max(unit.loops, key=lambda loop: loop.body.span.start)
        symbols.report(messages.TOO_MANY_LOOPS, last.body.span, limit=MAX_LOOPS)


def is_below(loop: tree.ResourceLoop, other: tree.ResourceLoop) -> bool:
    """Whether a loop is suppressed while the other one is engaged; loops without priority never are."""
    return loop.priority is not None and other.priority is not None and loop.priority < other.priority


def check_loop_call(
    body: BodyContext,
    raw: syntax.Call,
    function: syntax.Member,
    loop: tree.ResourceLoop,
    arguments: list[tree.Expr],
) -> tree.Expr:
    """`loop.running()` or `loop.overruns()`."""
    field = {"running": loop.running, "overruns": loop.overruns}.get(function.name)
    if field is None:
        body.report(messages.LOOP_MEMBER, function.place, name=function.name)
        return unknown(raw.span)
    candidate = OverloadCandidate(function.name, (), field)
    if choose_overload(body.symbols, function.place, [candidate], arguments) is None:
        return unknown(raw.span)
    return tree.FieldGet(raw.span, field.type, body.this(raw.span), field)
