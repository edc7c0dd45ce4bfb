"""`together`: its calls are collected, begun and fetched as one. `within`: what follows has an end in time.
`reserve`: nobody else is served by what it keeps.

    gather; pop ^sentinel          then the body, in which `begin` collects a call
    start                          before what does more than compute: all that is collected begins
    fetch                          at the end of the block: all are back, their results where they belong
    leave                          on every other way out, as the code of a `finally`

    hold; pop ^kept                what a `reserve` keeps
    take                           and then its body
    drop                           on every way out, as the code of a `finally`

A call's result goes to an element of an array. A local that takes one has an array of length 1 beside it, and
gets its element behind the block.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lfield.bytecode.program import INT, LIMIT, RESERVED, Handler
from lfield.compiler.begun.twins import Settle
from lfield.compiler.calls import Calls
from lfield.compiler.frame import Evaluator, Frame, Label
from lfield.compiler.leaving import Guard, Ways
from lfield.lang import chains, tree, types
from lfield.lang.tree import (
    Begin,
    Break,
    Continue,
    Declare,
    Element,
    Evaluate,
    Local,
    LocalGet,
    PortalCall,
    Return,
    Stmt,
    Throw,
    Try,
)
from lfield.lang.types import array_of


@dataclass(slots=True, eq=False)
class _Gathering:
    """The calls of one `together`: the slot of their sentinel, the arrays beside locals, what guards them.

    In the twin of an offer's method (twins.py) the sentinel is its caller's, and so is the guard (None).
    """

    sentinel: int
    arrays: dict[Local, int]
    guard: Guard | None


class Parallel:
    """What is worked at one time, and for how long, in one method."""

    def __init__(self, frame: Frame, evaluator: Evaluator, ways: Ways) -> None:
        self._frame = frame
        self._evaluator = evaluator
        self._calls = Calls(frame, evaluator)
        self._ways = ways
        #: The gatherings around, innermost last; None where no call can be collected.
        self._around: list[_Gathering | None] = []
        ticket = frame.tables.ticket_of(frame.method)
        if ticket is not None:
            self._around.append(_Gathering(frame.slots.of(ticket), {}, None))

    # --- together -------------------------------------------------------------------------------------

    def together(self, stmt: tree.Together, block: Callable[[], None]) -> None:
        """A whole `together`; `block` compiles its body."""
        frame, code = self._frame, self._frame.code
        arrays = self._arrays(stmt)
        sentinel = frame.slots.temporary(frame.tables.ticket_type)
        code.emit("gather")
        code.emit("pop", sentinel)
        guard = self._ways.open()
        self._around.append(_Gathering(sentinel, arrays, guard))
        block()
        self._around.pop()
        code.line = stmt.span.line
        self._calls.push("fetch", [sentinel])
        end = Label()
        code.jump("jmp", end)
        self._ways.close(guard, lambda: self._calls.push("leave", [sentinel, guard.thrown]), through=False)
        code.place(end)
        for local, array in arrays.items():
            code.emit("gete", frame.slots.of(local), array, frame.constant(0))
        frame.slots.release(sentinel, *arrays.values())

    def _arrays(self, stmt: tree.Together) -> dict[Local, int]:
        """An array with the value of each local that takes a result: one whose call is not begun keeps it."""
        frame, code = self._frame, self._frame.code
        arrays: dict[Local, int] = {}
        for local in _taking(stmt.body):
            kind = frame.tables.type_index(array_of(local.type))
            array = arrays[local] = frame.slots.temporary(kind)
            first = frame.slots.temporary(INT)
            code.emit("newarray", array, kind, frame.constant(1))
            code.emit("move", first, frame.constant(0))
            code.emit("pute", array, first, frame.slots.of(local))
            frame.slots.release(first)
        return arrays

    def begin(self, stmt: Begin) -> None:
        """Collect a call; where its result goes is found out first, as in any assignment."""
        gathering = self._around[-1]
        assert gathering is not None, "the checker lets no call of a together into a try or within of it"
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
            twin = frame.tables.twin(stmt.call.method)
            given = place if len(twin.parameters) > len(stmt.call.arguments) + 1 else []
            self._calls.push("call", [*operands, gathering.sentinel, *given], frame.tables.method_index(twin))
        if isinstance(stmt.target, Element):
            frame.slots.release(*place)
        frame.slots.release(*operands)

    def settle(self, stmt: Settle) -> None:
        """Collect what a call has given already."""
        gathering = self._around[-1]
        assert gathering is not None, "only a twin has one, and it has no try or within"
        place = self._calls.operands([stmt.target.array, stmt.target.index])
        value = self._evaluator.operand(stmt.value)
        kind = self._frame.tables.type_index(stmt.target.array.type)
        self._calls.push("settle", [gathering.sentinel, *place, value], kind)
        self._frame.slots.release(*place, value)

    def _check(self, element: Element | None, place: Sequence[int]) -> None:
        """An element that is not there is found when its call begins: reading it throws."""
        if element is not None:
            frame = self._frame
            read = frame.result(element.type, None)
            frame.code.emit("gete", read, *place)
            frame.slots.release(read)

    # --- beginning early ------------------------------------------------------------------------------

    def start_before(self, stmt: Stmt) -> None:
        """All that is collected begins before a statement that does more than compute."""
        gathering = self._around[-1] if self._around else None
        if gathering is not None and self._works(stmt, gathering):
            self._calls.push("start", [gathering.sentinel])

    def start_before_value(self, expr: tree.Expr) -> None:
        """As `start_before`, of a condition."""
        gathering = self._around[-1] if self._around else None
        if gathering is not None and self._frame.tables.work.inside(expr):
            self._calls.push("start", [gathering.sentinel])

    def _works(self, stmt: Stmt, gathering: _Gathering) -> bool:
        work, guard = self._frame.tables.work, gathering.guard
        match stmt:
            case tree.Together() | tree.Within() | tree.Reserve() | Try() | Throw():
                return True
            case Return():
                return guard is not None or (stmt.value is not None and work.inside(stmt.value))
            case Break():
                return guard is not None and self._ways.leaves(guard, self._ways.loop.end)
            case Continue():
                return guard is not None and self._ways.leaves(guard, self._ways.loop.step)
            case Evaluate(value=value) | Declare(value=tree.Expr() as value) | Settle(value=value):
                return work.inside(value)
            case Begin(call=call, target=target):
                parts = [*chains.parts(call), *(chains.parts(target) if target is not None else [])]
                return any(map(work.inside, parts))
        return False

    def apart(self, block: Callable[[], None]) -> None:
        """A part of a `together` in which it collects no calls."""
        self._around.append(None)
        block()
        self._around.pop()

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
        self.apart(block)
        if start < code.position:
            frame.handlers.append(Handler(start, code.position, 0, 0, end, LIMIT))
        frame.slots.release(end)

    # --- reserve --------------------------------------------------------------------------------------

    def reserve(self, stmt: tree.Reserve, block: Callable[[], None]) -> None:
        """A whole `reserve`; `block` compiles its body. Where it takes is inside: it may have a part then."""
        frame, code = self._frame, self._frame.code
        who = self._evaluator.operand(stmt.who)
        kept = frame.slots.temporary(frame.tables.type_index(array_of(types.INT)))
        self._calls.push("hold", [who])
        code.emit("pop", kept)
        frame.slots.release(who)
        guard = self._ways.open()
        self._calls.push("take", [kept])
        self.apart(block)
        frame.handlers.append(Handler(guard.start, code.position, 0, 0, kept, RESERVED))
        self._ways.close(guard, lambda: self._calls.push("drop", [kept]), through=True)
        frame.slots.release(kept)


def _taking(body: Sequence[Stmt]) -> list[Local]:
    """The locals that take results of a `together` itself, not of one inside it."""
    found: dict[Local, None] = {}
    for one in body:
        match one:
            case Begin(target=LocalGet(local=local)):
                found[local] = None
            case tree.Together():
                continue
        for inner in chains.bodies(one):
            found.update(dict.fromkeys(_taking(inner)))
    return list(found)
