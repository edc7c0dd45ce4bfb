"""Registers of the interpreter, and the steps that change its frame or exit: calls, returns, monitors, and
host calls (table J.3).

The steps of a frame write the registers themselves, in this file only: a method call in each L call and
return would make the engine measurably slower.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import repeat

from lfield.bytecode.program import Program
from lfield.vm.engine_interface import (
    BUDGET_EXHAUSTED,
    MONITOR_BLOCKED,
    AgentLimits,
    EngineExit,
    HostCall,
    Reading,
    ThreadDone,
    Trap,
)
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block, template
from lfield.vm.memory.layout import (
    FRAME,
    FRAME_CALLER,
    FRAME_DEPTH,
    FRAME_RETURN,
    FRAME_SLOTS,
    THREAD_FRAME,
    THREAD_ID,
)

#: A number that is no instruction: the engine exits with `Registers.exit`.
LEAVE = -1


class Registers:
    """Copies of data of the block during one run; `slots` is the word of slot 0 of the frame."""

    __slots__ = (
        "block",
        "builtins",
        "class_names",
        "exit",
        "frame",
        "has_read_external",
        "instructions",
        "limits",
        "now",
        "others",
        "pc",
        "place",
        "plain_arrays",
        "r",
        "readings",
        "slots",
        "w",
    )

    block: Block
    w: memoryview[int]
    r: memoryview[float]
    frame: int
    slots: int
    #: The instruction that raised an exception, then the next one.
    pc: int
    #: The place of the running thread's record.
    place: int
    exit: EngineExit
    #: One item per remaining instruction of the budget.
    instructions: Iterator[None]
    limits: AgentLimits
    #: The agent's readings by device call, None if the host must be queried.
    readings: Sequence[Reading | None]
    #: Whether this run has read a reading.
    has_read_external: bool

    def __init__(self, program: Program, class_names: list[str], now: Callable[[], float]) -> None:
        #: The number of built-in classes, which have the lowest indexes.
        self.builtins = program.builtins
        #: By class, the field with the exceptions of other calls of a `together`.
        self.others = program.others
        self.class_names = class_names
        #: By type, the type of the ARRAY with the elements of an array.
        self.plain_arrays = [program.core.plain_array(i) for i in range(len(program.core.types))]
        #: The clock that determines the validity of readings.
        self.now = now

    def load(
        self,
        block: Block,
        thread: int,
        budget: int,
        limits: AgentLimits,
        readings: Sequence[Reading | None],
    ) -> None:
        """Prepare a run of the thread at the place `thread`."""
        self.block, self.w, self.r = block, block.w, block.r
        self.limits, self.readings, self.has_read_external = limits, readings, False
        self.frame = frame = block.w[thread + THREAD_FRAME]
        self.slots = frame + FRAME_SLOTS
        self.place = thread
        self.exit = BUDGET_EXHAUSTED
        self.instructions = repeat(None, budget)

    def leave(self, reason: EngineExit) -> int:
        """End the run for a reason; returns LEAVE."""
        self.exit = reason
        return LEAVE

    def locate(self, pc: int) -> None:
        """Set the number of the running instruction, for an exception that it raises."""
        self.pc = pc

    def enter_handler(self, frame: int, pc: int) -> None:
        """Continue at a handler in a frame."""
        self.frame, self.slots, self.pc = frame, frame + FRAME_SLOTS, pc


Step = Callable[[Registers], int]


def null_use(use: str) -> Trap:
    """The trap for a null reference."""
    return Trap("NullException", f"{use} of null")


#: A prepared argument: its slot, or None and the word of the constant.
Argument = tuple[int | None, int]


def call(arguments: list[Argument], method: int, words: int, entry: int, after: int, name: str) -> Step:
    """A whole call group: a frame for the callee with the arguments in its first slots."""
    blank = template(FRAME, method, words)
    first = arguments[0][0]

    def step(m: Registers) -> int:
        block, w, slots = m.block, m.w, m.slots
        if first is not None and not w[slots + first]:
            raise null_use(f"call of '{name}'")
        depth = w[m.frame + FRAME_DEPTH] + 1
        if depth > m.limits.call_depth:
            raise Trap("LimitException", f"calls are nested deeper than {m.limits.call_depth}")
        place = block.place_template(blank)
        w[place + FRAME_CALLER] = m.frame
        w[place + FRAME_RETURN] = after
        w[place + FRAME_DEPTH] = depth
        into = place + FRAME_SLOTS
        for slot, constant in arguments:
            w[into] = constant if slot is None else w[slots + slot]
            into += 1
        m.frame = place
        m.slots = place + FRAME_SLOTS
        return entry

    return step


def enter(synchronized: bool, after: int) -> Step:
    """`frame`: acquires the agent's monitor if the method is synchronized."""
    if not synchronized:
        return lambda m: after

    def step(m: Registers) -> int:
        w = m.w
        owner, thread = w[layout.W_OWNER], w[m.place + THREAD_ID]
        if owner and owner != thread:
            m.exit = MONITOR_BLOCKED
            return LEAVE
        w[layout.W_OWNER] = thread
        w[layout.W_ENTRIES] += 1
        return after

    return step


def release(w: memoryview[int]) -> None:
    """Release the monitor once; the monitor is free after as many releases as acquisitions."""
    w[layout.W_ENTRIES] -= 1
    if not w[layout.W_ENTRIES]:
        w[layout.W_OWNER] = 0


def leave(result: Argument | None, words: int, synchronized: bool, destinations: dict[int, int]) -> Step:
    """`return` and `rtn`: pass the result to the caller and continue after its call; a frame has `words`
    words.

    `destinations` has the slot of the pop, by the instruction after a call group with a result.
    """
    slot, constant = result or (None, 0)

    def step(m: Registers) -> int:
        w, frame = m.w, m.frame
        word = constant if slot is None else w[m.slots + slot]
        if synchronized:
            release(w)
        caller = w[frame + FRAME_CALLER]
        if not caller:
            m.exit = ThreadDone(word)
            return LEAVE
        after = w[frame + FRAME_RETURN]
        # A frame on the top of the heap is freed at once: calls without allocations produce no garbage.
        if frame + words == m.block.top:
            m.block.set_top(frame)
        m.frame = caller
        m.slots = caller + FRAME_SLOTS
        destination = destinations.get(after)
        if destination is None:
            return after
        w[m.slots + destination] = word
        return after + 1

    return step


def host_call(arguments: list[Argument], op: int, operand: int, checked: dict[int, str]) -> Step:
    """A host call; `checked` has the arguments that must not be null."""
    must = tuple(checked.items())

    def step(m: Registers) -> int:
        w, slots = m.w, m.slots
        words = [constant if slot is None else w[slots + slot] for slot, constant in arguments]
        for number, subject in must:
            if not words[number]:
                raise null_use(subject)
        m.exit = HostCall(op, operand, words)
        return LEAVE

    return step


def reading(query_step: Step, call: int, into: int, after: int) -> Step:
    """A telemetry query: the last reading while valid, otherwise `ask` calls the host."""

    def step(m: Registers) -> int:
        known = m.readings[call]
        if known is None or m.now() >= known.until:
            return query_step(m)
        m.w[m.slots + into] = known.word
        m.has_read_external = True
        return after

    return step
