"""Leaving loops, methods and what a `finally` guards: wherever control goes, that code runs first.

The code of a `finally` is there once. Who leaves what it guards notes the way and jumps there:

    move ^way, 2          a `break` that leaves the try
    move ^thrown, null
    jmp entry
    ...
    move ^thrown, null    the try came to its end
    target:               an exception comes here, in ^thrown
    move ^way, 0
    entry: ...            the code of the `finally`
                          then on by the way noted, or ^thrown again, or just on

So a method grows with its text, however its exits are nested, and every line has one place in the code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple

from lfield.bytecode.program import ANY, BOOLEAN, FINALLY, INT, LANDING, Handler
from lfield.compiler.frame import Frame, Label


class Loop(NamedTuple):
    """Where `continue` and `break` go."""

    step: Label
    end: Label


@dataclass(slots=True, eq=False)
class Guard:
    """Instructions that lead to a `finally`, from `start` on.

    `ways` numbers what leaves them: by the label of a loop further out, or None for a `return`. The slots of
    the way and of the value to be returned are there once they are needed (0: not yet).
    """

    start: int
    thrown: int
    entry: Label = field(default_factory=Label)
    way: int = 0
    result: int = 0
    ways: dict[Label | None, int] = field(default_factory=dict)


class Ways:
    """What is around the statement that is being compiled, and the ways out of it."""

    def __init__(self, frame: Frame) -> None:
        self._frame = frame
        self._around: list[Loop | Guard] = []

    @property
    def loop(self) -> Loop:
        """The innermost loop; the checker has seen to it that there is one."""
        return next(one for one in reversed(self._around) if isinstance(one, Loop))

    @property
    def looping(self) -> bool:
        """Whether there is a loop around."""
        return any(isinstance(one, Loop) for one in self._around)

    @contextmanager
    def inside(self, loop: Loop) -> Iterator[None]:
        """The body and the step of a loop."""
        self._around.append(loop)
        yield
        self._around.pop()

    def crossed(self, to: Label | None) -> Guard | None:
        """The innermost guard on the way to a label of a loop, or out of the method (None)."""
        for one in reversed(self._around):
            if isinstance(one, Guard):
                return one
            if to in one:
                return None
        return None

    def leaves(self, guard: Guard, to: Label | None) -> bool:
        """Whether the way to a label of a loop, or out of the method (None), leads out of a guard."""
        inner = self._around[self._around.index(guard) :]
        return not any(isinstance(one, Loop) and to in one for one in inner)

    def jump(self, to: Label) -> None:
        """Go to a label of a loop."""
        guard = self.crossed(to)
        if guard is None:
            self._frame.code.jump("jmp", to)
        else:
            self._by(guard, to)

    def back(self, result: int | None) -> None:
        """Return from the method, with an operand or nothing; the operand is released."""
        frame, guard = self._frame, self.crossed(None)
        if guard is None:
            self._return(result)
        elif result is None:
            self._by(guard, None)
        else:
            kind = frame.tables.type_index(frame.method.result)
            guard.result = guard.result or frame.slots.temporary(kind)
            frame.code.emit("move", guard.result, result)
            frame.slots.release(result)
            self._by(guard, None)

    def _return(self, result: int | None) -> None:
        if result is None:
            self._frame.code.emit("rtn")
            return
        self._frame.code.emit("return", result)
        self._frame.slots.release(result)

    def _by(self, guard: Guard, to: Label | None) -> None:
        frame = self._frame
        guard.way = guard.way or frame.slots.temporary(INT)
        number = guard.ways.setdefault(to, len(guard.ways) + 1)
        frame.code.emit("move", guard.way, frame.constant(number))
        frame.code.emit("move", guard.thrown, frame.constant(None))
        frame.code.jump("jmp", guard.entry)

    # --- guards ---------------------------------------------------------------------------------------

    def open(self) -> Guard:
        """What follows is guarded, until `close`."""
        guard = Guard(self._frame.code.position, self._frame.slots.temporary(ANY))
        self._around.append(guard)
        return guard

    def close(self, guard: Guard, last: Callable[[], None], *, through: bool) -> None:
        """The end of what is guarded, and the code that runs when control leaves it.

        `through`: also when it just comes to the end; otherwise control cannot be there.
        """
        frame, code = self._frame, self._frame.code
        assert self._around.pop() is guard
        ends = code.reachable
        assert through or not ends
        landing = code.position
        code.emit("move", guard.thrown, frame.constant(None))
        if guard.start < landing:
            handler = Handler(guard.start, landing, code.position, 0, guard.thrown, FINALLY)
            frame.handlers.append(handler)
            code.place(Label(), entered=True)
        if guard.ways:
            code.emit("move", guard.way, frame.constant(0))
        code.place(guard.entry)
        last()
        if landing < code.position:
            frame.handlers.append(Handler(landing, code.position, 0, 0, 0, LANDING))
        self._go_on(guard, ends)
        used = (guard.thrown, guard.way, guard.result)
        frame.slots.release(*(slot for slot in used if slot))

    def _go_on(self, guard: Guard, ends: bool) -> None:
        """Behind the code of a `finally`: where control was going, or the exception again."""
        frame, code = self._frame, self._frame.code
        if not code.reachable:
            return
        for to, number in guard.ways.items():
            test, other = frame.slots.temporary(BOOLEAN), Label()
            code.emit("eqi", test, guard.way, frame.constant(number))
            frame.slots.release(test)
            if to is not None and self.crossed(to) is None:
                code.jump("bnz", to, test)
                continue
            code.jump("bz", other, test)
            if to is not None:
                self.jump(to)
            else:
                self.back(guard.result or None)
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
