"""The method of a loop's thread, as if it were written in L (decision 106):

    int period = f2i(round(1e9 / rate));                 // or 1e9 * seconds, in ns
    int due = -1;
    while (true) {
        int following = tick(due, period);               // waits
        if (due >= 0 && following - due > period) overruns = overruns + 1;
        due = following;
        boolean starts = false;
        try { starts = condition; engaged = starts; }
        catch (DeviceException e) { tick_failed(e); engaged = true; }
        if (engaged) { if (lower.running) suppress(lower); ... }
        if (starts) {
            running = true;
            if (!(higher.engaged || ...)) {
                control();                               // with a priority above 0
                try { body(); }
                catch (CancelledException e) { }         // it was suppressed
                catch (DeviceException e) { tick_failed(e); }
            }
            running = false;
        }
    }

`running` is set before `engaged` of higher loops is read, and those set `engaged` before they read `running`:
a body that starts between these steps either does not run or is suppressed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from lfield.lang import messages, syntax, tree
from lfield.lang.checker.conversions import require_type
from lfield.lang.checker.expressions import condition, value
from lfield.lang.checker.library.loop_members import is_below
from lfield.lang.checker.scope import BodyContext, Scope
from lfield.lang.checker.symbols import Symbols
from lfield.lang.tree import Expr, Field, Local, ResourceLoop, Stmt
from lfield.lang.types import BOOLEAN, INT, REAL, VOID, ClassType, Type
from lfield.text.suggestions import listed

#: The shortest and longest period, in seconds.
MIN_PERIOD, MAX_PERIOD = 0.001, 1000.0
_CANCELLED, _DEVICE = ClassType("CancelledException"), ClassType("DeviceException")


def check_loop(symbols: Symbols, body: tree.Method, head: syntax.LoopHead) -> None:
    """Check the head of a loop, and fill the method of its thread."""
    loop = body.unit.loop(body.name)
    if loop is None or loop.body is not body:
        return
    context = BodyContext(symbols, body.unit, loop.ticks, Scope())
    lower = [other for other in body.unit.loops if is_below(other, loop)]
    if lower and head.condition is None:
        names = listed([f"'{other.body.name}'" for other in lower])
        symbols.report(messages.LOOP_UNCONDITIONAL, head.place or body.span, name=body.name, lower=names)
    period = _nanoseconds(context, head)
    holds = None if head.condition is None else condition(context, head.condition)
    higher = [other for other in body.unit.loops if is_below(loop, other)]
    ticks = _Ticks(loop, context.this(body.span))
    loop.ticks.body.extend(ticks.statements(period, holds, higher, lower))


def _nanoseconds(body: BodyContext, head: syntax.LoopHead) -> Expr:
    """The period in ns."""
    rate = require_type(body.symbols, value(body, head.rate), REAL)
    constant = _constant(rate)
    if constant is not None:
        period = constant if head.every else 1.0 / constant if constant else math.inf
        if not MIN_PERIOD <= period <= MAX_PERIOD:
            body.report(
                messages.LOOP_PERIOD,
                head.rate.span,
                given="infinite" if math.isinf(period) else f"{period:g} s",
            )
    span, second = rate.span, tree.Literal_(rate.span, REAL, 1e9)
    product = tree.Binary(span, REAL, "*" if head.every else "/", second, rate)
    return tree.LibraryCall(span, INT, "f2i", [tree.LibraryCall(span, REAL, "round", [product])])


def _constant(rate: Expr) -> float | None:
    match rate:
        case tree.ToReal(operand=operand):
            return _constant(operand)
        case tree.Negate(operand=operand) if (inner := _constant(operand)) is not None:
            return -inner
        case tree.Literal_(value=int() | float() as number):
            return float(number)
    return None


class _Ticks:
    """The statements of the thread of one loop, all at the place of its name."""

    def __init__(self, loop: ResourceLoop, this: tree.This) -> None:
        self._loop, self._this, self._span = loop, this, loop.body.span
        self._period, self._due, self._following = (self._local(INT) for _ in range(3))
        self._starts = self._local(BOOLEAN)

    def statements(
        self, period: Expr, holds: Expr | None, higher: Sequence[ResourceLoop], lower: Sequence[ResourceLoop]
    ) -> list[Stmt]:
        """All statements; `period` is in ns."""
        span = self._span
        each: list[Stmt] = [
            *self._wait(),
            *self._decide(holds),
            *([self._suppress(lower)] if lower else []),
            tree.If(span, self._get(self._starts), self._run(higher), []),
        ]
        return [
            tree.Declare(span, self._period, period),
            tree.Declare(span, self._due, self._literal(INT, -1)),
            tree.Loop(span, self._literal(BOOLEAN, True), each, []),
        ]

    def _wait(self) -> list[Stmt]:
        """Wait for the tick, and count an overrun of the one before."""
        due, following, overruns = self._get(self._due), self._get(self._following), self._loop.overruns
        wait = tree.LoopCall(self._span, INT, "tick", [due, self._get(self._period)])
        passed = tree.Binary(self._span, INT, "-", following, due)
        is_late = tree.Logical(
            self._span,
            BOOLEAN,
            "&&",
            tree.Binary(self._span, BOOLEAN, ">=", due, self._literal(INT, 0)),
            tree.Binary(self._span, BOOLEAN, ">", passed, self._get(self._period)),
        )
        count = tree.Binary(self._span, INT, "+", self._get(overruns), self._literal(INT, 1))
        return [
            tree.Declare(self._span, self._following, wait),
            tree.If(self._span, is_late, [self._set(overruns, count)], []),
            self._set(self._due, following),
        ]

    def _decide(self, holds: Expr | None) -> list[Stmt]:
        """Whether the body starts, and whether lower loops are suppressed."""
        starts, engaged, yes = self._starts, self._loop.engaged, self._literal(BOOLEAN, True)
        if holds is None:
            return [tree.Declare(self._span, starts, yes), self._set(engaged, yes)]
        evaluate = [self._set(starts, holds), self._set(engaged, self._get(starts))]
        unknown = self._caught(_DEVICE, lambda thrown: [self._failed(thrown), self._set(engaged, yes)])
        return [
            tree.Declare(self._span, starts, self._literal(BOOLEAN, False)),
            tree.Try(self._span, evaluate, [unknown]),
        ]

    def _suppress(self, lower: Sequence[ResourceLoop]) -> Stmt:
        each: list[Stmt] = [
            tree.If(
                self._span,
                self._get(other.running),
                [self._do(tree.LoopCall(self._span, VOID, "suppress", [], other.ticks))],
                [],
            )
            for other in lower
        ]
        return tree.If(self._span, self._get(self._loop.engaged), each, [])

    def _run(self, higher: Sequence[ResourceLoop]) -> list[Stmt]:
        """Run the body, unless a higher loop is engaged."""
        span, running = self._span, self._loop.running
        body = tree.Try(
            span,
            [self._do(tree.Call(span, VOID, self._this, self._loop.body, []))],
            [
                self._caught(_CANCELLED, lambda thrown: []),
                self._caught(_DEVICE, lambda thrown: [self._failed(thrown)]),
            ],
        )
        steps: list[Stmt] = [body]
        if self._loop.controls:
            steps.insert(0, self._do(tree.LoopCall(span, VOID, "control", [])))
        for other in higher:
            steps = [tree.If(span, tree.Not(span, BOOLEAN, self._get(other.engaged)), steps, [])]
        return [
            self._set(running, self._literal(BOOLEAN, True)),
            *steps,
            self._set(running, self._literal(BOOLEAN, False)),
        ]

    # --- nodes ------------------------------------------------------------------------------------------

    def _local(self, kind: Type) -> Local:
        return Local("", kind, self._span)

    def _literal(self, kind: Type, value: bool | int | float) -> Expr:
        return tree.Literal_(self._span, kind, value)

    def _get(self, variable: Local | Field) -> tree.LocalGet | tree.FieldGet:
        if isinstance(variable, Local):
            return tree.LocalGet(self._span, variable.type, variable)
        return tree.FieldGet(self._span, variable.type, self._this, variable)

    def _set(self, variable: Local | Field, value: Expr) -> Stmt:
        return self._do(tree.Assign(self._span, variable.type, self._get(variable), value))

    def _do(self, call: Expr) -> Stmt:
        return tree.Evaluate(self._span, call)

    def _failed(self, thrown: Local) -> Stmt:
        return self._do(tree.LoopCall(self._span, VOID, "tick_failed", [self._get(thrown)]))

    def _caught(self, kind: Type, handle: Callable[[Local], list[Stmt]]) -> tree.Catch:
        thrown = self._local(kind)
        return tree.Catch(thrown, handle(thrown))
