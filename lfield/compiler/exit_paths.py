"""Exits from loops, methods and guarded code: the code of a `finally` runs on each of them.

The code of a `finally` exists once. An exit stores its number and jumps there:

    move ^exit, 2         a `break` that leaves the try
    move ^thrown, null
    jmp entry
    ...
    move ^thrown, null    normal end of the try
    target:               entry of an exception, in ^thrown
    move ^exit, 0
    entry: ...            the code of the `finally`
                                                then the continuation of the exit, or ^thrown again, or fall
                                                through

So the size of a method is linear in its source, however its exits are nested, and every line occurs once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

from msgspec import Struct, field

from lfield.bytecode.program import ANY, BOOLEAN, FINALLY, INT, LANDING, Handler
from lfield.compiler.method_frame import Label, MethodFrame


class LoopLabels(NamedTuple):
    """The targets of `continue` and `break`."""

    step: Label
    end: Label


class FinallyGuard(Struct, eq=False):
    """Instructions that are guarded by a `finally`, from `start` on.

    `exits` numbers the exits: by the label of an outer loop, or None for a `return`. The slots of
    the exit number and of the returned value are allocated on demand (0: not yet).
    """

    start: int
    thrown: int
    entry: Label = field(default_factory=Label)
    exit_slot: int = 0
    result: int = 0
    exits: dict[Label | None, int] = field(default_factory=dict)


class ExitPaths:
    """The constructs around the current statement, and the exits from them."""

    def __init__(self, frame: MethodFrame) -> None:
        self._frame = frame
        self._enclosing: list[LoopLabels | FinallyGuard] = []

    @property
    def loop(self) -> LoopLabels:
        """The innermost loop; the checker ensures that there is one."""
        return next(scope for scope in reversed(self._enclosing) if isinstance(scope, LoopLabels))

    @property
    def is_in_loop(self) -> bool:
        """Whether the statement is in a loop."""
        return any(isinstance(scope, LoopLabels) for scope in self._enclosing)

    @contextmanager
    def loop_body(self, loop: LoopLabels) -> Iterator[None]:
        """The body and the step of a loop."""
        self._enclosing.append(loop)
        yield
        self._enclosing.pop()

    def crossed_guard(self, label: Label | None) -> FinallyGuard | None:
        """The innermost guard that is left by a jump to a label of a loop, or by a return (None)."""
        for scope in reversed(self._enclosing):
            if isinstance(scope, FinallyGuard):
                return scope
            if label in scope:
                return None
        return None

    def exits_guard(self, guard: FinallyGuard, label: Label | None) -> bool:
        """Whether a jump to a label of a loop, or a return (None), leaves a guard."""
        inner = self._enclosing[self._enclosing.index(guard) :]
        return not any(isinstance(scope, LoopLabels) and label in scope for scope in inner)

    def jump(self, label: Label) -> None:
        """Jump to a label of a loop."""
        guard = self.crossed_guard(label)
        if guard is None:
            self._frame.code.jump("jmp", label)
        else:
            self._route_through(guard, label)

    def emit_return(self, result: int | None) -> None:
        """Return from the method, with an operand or nothing; the operand is released."""
        frame, guard = self._frame, self.crossed_guard(None)
        if guard is None:
            self._return(result)
        elif result is None:
            self._route_through(guard, None)
        else:
            kind = frame.tables.type_index(frame.method.result)
            guard.result = guard.result or frame.slots.temporary(kind)
            frame.code.emit("move", guard.result, result)
            frame.slots.release(result)
            self._route_through(guard, None)

    def _return(self, result: int | None) -> None:
        if result is None:
            self._frame.code.emit("rtn")
            return
        self._frame.code.emit("return", result)
        self._frame.slots.release(result)

    def _route_through(self, guard: FinallyGuard, label: Label | None) -> None:
        frame = self._frame
        guard.exit_slot = guard.exit_slot or frame.slots.temporary(INT)
        number = guard.exits.setdefault(label, len(guard.exits) + 1)
        frame.code.emit("move", guard.exit_slot, frame.constant(number))
        frame.code.emit("move", guard.thrown, frame.constant(None))
        frame.code.jump("jmp", guard.entry)

    # --- guards ---------------------------------------------------------------------------------------

    def open(self) -> FinallyGuard:
        """Start guarding the following code, until `close`."""
        guard = FinallyGuard(self._frame.code.position, self._frame.slots.temporary(ANY))
        self._enclosing.append(guard)
        return guard

    def close(self, guard: FinallyGuard, last: Callable[[], None], *, through: bool) -> None:
        """End the guarded code, and compile the code that runs when control leaves it.

        `through`: it also runs at the normal end; otherwise the end must be unreachable.
        """
        frame, code = self._frame, self._frame.code
        assert self._enclosing.pop() is guard
        ends = code.reachable
        assert through or not ends
        landing = code.position
        code.emit("move", guard.thrown, frame.constant(None))
        if guard.start < landing:
            handler = Handler(guard.start, landing, code.position, 0, guard.thrown, FINALLY)
            frame.handlers.append(handler)
            code.place(Label(), entered=True)
        if guard.exits:
            code.emit("move", guard.exit_slot, frame.constant(0))
        code.place(guard.entry)
        last()
        if landing < code.position:
            frame.handlers.append(Handler(landing, code.position, 0, 0, 0, LANDING))
        self._emit_continuations(guard, ends)
        used = (guard.thrown, guard.exit_slot, guard.result)
        frame.slots.release(*(slot for slot in used if slot))

    def _emit_continuations(self, guard: FinallyGuard, ends: bool) -> None:
        """After the code of a `finally`: jump to the target of the exit, or throw again."""
        frame, code = self._frame, self._frame.code
        if not code.reachable:
            return
        for label, number in guard.exits.items():
            test, other = frame.slots.temporary(BOOLEAN), Label()
            code.emit("eqi", test, guard.exit_slot, frame.constant(number))
            frame.slots.release(test)
            if label is not None and self.crossed_guard(label) is None:
                code.jump("bnz", label, test)
                continue
            code.jump("bz", other, test)
            if label is not None:
                self.jump(label)
            else:
                self.emit_return(guard.result or None)
                guard.result = 0
            code.place(other)
        end = Label()
        if ends:
            test = frame.slots.temporary(BOOLEAN)
            code.emit("eqnull", test, guard.thrown)
            frame.slots.release(test)
            code.jump("bnz", end, test)
        code.emit("throw", guard.thrown)
        code.place(end)
