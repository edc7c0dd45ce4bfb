"""`together` collects calls, starts them and awaits all; `within` sets a time limit; `reserve` locks
resources; `wait until` waits in a monitor.

    gather; pop ^sentinel          then the body, in which `begin` collects a call
    start                          before a side effect: starts the collected calls
    fetch                          at the end of the block: awaits all calls, stores their results
    leave                          on every other exit, as the code of a `finally`

    hold; pop ^held                the resources of a `reserve`
    take                           and then its body
    drop                           on every exit, as the code of a `finally`

    test: bnz end, ^condition      a `wait until`
    wait_leave; pop ^entries       leaves the monitor, or throws at the end of the time
    wait_enter                     waits until another thread has left it, and enters it again
    jmp test

A call's result is stored into an element of an array. A local that receives one has an array of length 1, and
is assigned from it after the block.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from msgspec import Struct

from lfield.bytecode.program import INT, LIMIT, RESERVED, Handler
from lfield.compiler.async_variants.async_methods import SettleResult
from lfield.compiler.call_emitter import CallEmitter
from lfield.compiler.exit_paths import ExitPaths, FinallyGuard
from lfield.compiler.method_frame import Evaluator, Label, MethodFrame
from lfield.lang import tree, tree_traversal, types
from lfield.lang.tree import (
    Break,
    Continue,
    Declare,
    Element,
    Evaluate,
    Local,
    LocalGet,
    PortalCall,
    Return,
    StartCall,
    Stmt,
    Throw,
    Try,
)
from lfield.lang.types import array_of


class _OpenTogether(Struct, eq=False):
    """The calls of one `together`: the slot of their sentinel, the arrays of locals, and the guard of the
    body.

    In the asynchronous variant of an offer's method (async_methods.py) the sentinel and the guard (None) are
    those of the caller.
    """

    sentinel: int
    arrays: dict[Local, int]
    guard: FinallyGuard | None


class CoordinationEmitter:
    """The `together`, `within` and `reserve` blocks of one method."""

    def __init__(self, frame: MethodFrame, evaluator: Evaluator, exit_paths: ExitPaths) -> None:
        self._frame = frame
        self._evaluator = evaluator
        self._calls = CallEmitter(frame, evaluator)
        self._exit_paths = exit_paths
        #: The enclosing `together` blocks, innermost last; None where no call can be collected.
        self._enclosing: list[_OpenTogether | None] = []
        ticket = frame.tables.ticket_of(frame.method)
        if ticket is not None:
            self._enclosing.append(_OpenTogether(frame.slots.of(ticket), {}, None))

    # --- together -------------------------------------------------------------------------------------

    def together(self, stmt: tree.Together, block: Callable[[], None]) -> None:
        """A whole `together`; `block` compiles its body."""
        frame, code = self._frame, self._frame.code
        arrays = self._arrays(stmt)
        sentinel = frame.slots.temporary(frame.tables.ticket_type)
        code.emit("gather")
        code.emit("pop", sentinel)
        guard = self._exit_paths.open()
        self._enclosing.append(_OpenTogether(sentinel, arrays, guard))
        block()
        self._enclosing.pop()
        code.set_line(stmt.span.line)
        self._calls.push("fetch", [sentinel])
        end = Label()
        code.jump("jmp", end)
        self._exit_paths.close(
            guard, lambda: self._calls.push("leave", [sentinel, guard.thrown]), through=False
        )
        code.place(end)
        for local, array in arrays.items():
            code.emit("gete", frame.slots.of(local), array, frame.constant(0))
        frame.slots.release(sentinel, *arrays.values())

    def _arrays(self, stmt: tree.Together) -> dict[Local, int]:
        """An array with the value of each local that receives a result, so that it is kept if its call never
        starts."""
        frame, code = self._frame, self._frame.code
        arrays: dict[Local, int] = {}
        for local in _result_locals(stmt.body):
            kind = frame.tables.type_index(array_of(local.type))
            array = arrays[local] = frame.slots.temporary(kind)
            first = frame.slots.temporary(INT)
            code.emit("newarray", array, kind, frame.constant(1))
            code.emit("move", first, frame.constant(0))
            code.emit("pute", array, first, frame.slots.of(local))
            frame.slots.release(first)
        return arrays

    def collect_call(self, stmt: StartCall) -> None:
        """Collect a call; the target of its result is evaluated first, as in any assignment."""
        gathering = self._enclosing[-1]
        assert gathering is not None, "the checker rejects calls of a together inside its try or within"
        frame = self._frame
        array, index = frame.constant(None), frame.constant(0)
        match stmt.target:
            case LocalGet(local=local):
                array = gathering.arrays[local]
            case Element() as target:
                array = self._evaluator.value(target.array)
                index = self._evaluator.operand(target.index)
        element = stmt.target if isinstance(stmt.target, Element) and gathering.guard else None
        place = [array, index]
        if isinstance(stmt.call, PortalCall):
            operands = self._calls.operands([stmt.call.proxy, *stmt.call.arguments])
            self._check(element, place)
            portal = frame.tables.method_index(stmt.call.portal)
            self._calls.push("begin", [gathering.sentinel, *place, *operands], portal)
        else:
            operands = self._calls.operands([stmt.call.object, *stmt.call.arguments])
            self._check(element, place)
            twin = frame.tables.async_variant(stmt.call.method)
            result_element = place if len(twin.parameters) > len(stmt.call.arguments) + 1 else []
            self._calls.push(
                "call", [*operands, gathering.sentinel, *result_element], frame.tables.method_index(twin)
            )
        if isinstance(stmt.target, Element):
            frame.slots.release(*place)
        frame.slots.release(*operands)

    def settle_result(self, stmt: SettleResult) -> None:
        """Collect the result of a call that has been executed."""
        gathering = self._enclosing[-1]
        assert gathering is not None, "only a variant has one, and it has no try or within"
        place = self._calls.operands([stmt.target.array, stmt.target.index])
        value = self._evaluator.operand(stmt.value)
        kind = self._frame.tables.type_index(stmt.target.array.type)
        self._calls.push("settle", [gathering.sentinel, *place, value], kind)
        self._frame.slots.release(*place, value)

    def _check(self, element: Element | None, place: Sequence[int]) -> None:
        """Evaluate an element when its call starts, so that a bad index throws there."""
        if element is not None:
            frame = self._frame
            read = frame.result(element.type, None)
            frame.code.emit("gete", read, *place)
            frame.slots.release(read)

    # --- early start ----------------------------------------------------------------------------------

    def start_before(self, stmt: Stmt) -> None:
        """Start the collected calls before a statement with side effects."""
        gathering = self._enclosing[-1] if self._enclosing else None
        if gathering is not None and self._must_start_before(stmt, gathering):
            self._calls.push("start", [gathering.sentinel])

    def start_before_value(self, expr: tree.Expr) -> None:
        """As `start_before`, for a condition."""
        gathering = self._enclosing[-1] if self._enclosing else None
        if gathering is not None and self._frame.tables.effect_analysis.has_effects(expr):
            self._calls.push("start", [gathering.sentinel])

    def _must_start_before(self, stmt: Stmt, gathering: _OpenTogether) -> bool:
        work, guard = self._frame.tables.effect_analysis, gathering.guard
        match stmt:
            case tree.Together() | tree.Within() | tree.Reserve() | Try() | Throw():
                return True
            case Return():
                return guard is not None or (stmt.value is not None and work.has_effects(stmt.value))
            case Break():
                return guard is not None and self._exit_paths.exits_guard(guard, self._exit_paths.loop.end)
            case Continue():
                return guard is not None and self._exit_paths.exits_guard(guard, self._exit_paths.loop.step)
            case Evaluate(value=value) | Declare(value=tree.Expr() as value) | SettleResult(value=value):
                return work.has_effects(value)
            case StartCall(call=call, target=target):
                parts = [
                    *tree_traversal.subexpressions(call),
                    *(tree_traversal.subexpressions(target) if target is not None else []),
                ]
                return any(map(work.has_effects, parts))
        return False

    def without_collecting(self, block: Callable[[], None]) -> None:
        """A part of a `together` that collects no calls."""
        self._enclosing.append(None)
        block()
        self._enclosing.pop()

    # --- within ---------------------------------------------------------------------------------------

    def within(self, stmt: tree.Within, block: Callable[[], None]) -> None:
        """A whole `within`; `block` compiles its body."""
        frame, code = self._frame, self._frame.code
        seconds = self._evaluator.operand(stmt.seconds)
        end = frame.slots.temporary(INT)
        self._calls.push("limit", [seconds])
        code.emit("pop", end)
        frame.slots.release(seconds)
        start = code.position
        self.without_collecting(block)
        if start < code.position:
            frame.handlers.append(Handler(start, code.position, 0, 0, end, LIMIT))
        frame.slots.release(end)

    # --- wait until -----------------------------------------------------------------------------------

    def wait_until(self, stmt: tree.WaitUntil, branch: Callable[[tree.Expr, bool, Label], None]) -> None:
        """`wait until (condition) within (seconds);`: `branch` compiles the condition."""
        frame, code = self._frame, self._frame.code
        limit = frame.constant(0)
        if stmt.seconds is not None:
            seconds = self._evaluator.operand(stmt.seconds)
            self._calls.push("wait_limit", [seconds])
            frame.slots.release(seconds)
            limit = frame.slots.temporary(INT)
            code.emit("pop", limit)
        polls = frame.constant(frame.tables.effect_analysis.reads_outside(stmt.condition))
        entries = frame.slots.temporary(INT)
        test, end = Label(), Label()
        code.place(test, entered=True)
        branch(stmt.condition, True, end)
        code.set_line(stmt.span.line)
        self._calls.push("wait_leave", [limit, polls])
        code.emit("pop", entries)
        self._calls.push("wait_enter", [entries, limit])
        code.jump("jmp", test)
        code.place(end)
        frame.slots.release(entries, *([limit] if limit >= 0 else []))

    # --- reserve --------------------------------------------------------------------------------------

    def reserve(self, stmt: tree.Reserve, block: Callable[[], None]) -> None:
        """A whole `reserve`; `block` compiles its body. `take` is guarded: it may fail after some
        resources."""
        frame, code = self._frame, self._frame.code
        resource = self._evaluator.operand(stmt.target)
        held = frame.slots.temporary(frame.tables.plain_array_type(types.INT))
        self._calls.push("hold", [resource])
        code.emit("pop", held)
        frame.slots.release(resource)
        guard = self._exit_paths.open()
        self._calls.push("take", [held])
        self.without_collecting(block)
        frame.handlers.append(Handler(guard.start, code.position, 0, 0, held, RESERVED))
        self._exit_paths.close(guard, lambda: self._calls.push("drop", [held]), through=True)
        frame.slots.release(held)


def _result_locals(body: Sequence[Stmt]) -> list[Local]:
    """The locals that receive results of a `together` itself, not of a nested one."""
    found: dict[Local, None] = {}
    for stmt in body:
        match stmt:
            case StartCall(target=LocalGet(local=local)):
                found[local] = None
            case tree.Together():
                continue
        for inner in tree_traversal.nested_bodies(stmt):
            found.update(dict.fromkeys(_result_locals(inner)))
    return list(found)
