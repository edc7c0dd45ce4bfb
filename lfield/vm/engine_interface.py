"""Engine interface: limits, readings, exits and traps.

All externally visible effects happen between two `run` calls, so one engine can replace another during an
execution. Engines share only this file and the block.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from msgspec import Struct

from lfield.bytecode.program import BOOLEAN, INT, REAL, Program, Quad
from lfield.vm.memory.block import Block
from lfield.vm.memory.block_allocator import BlockAllocator
from lfield.vm.memory.layout import Layouts

#: Kinds of values that are one word and need no heap.
PLAIN = (BOOLEAN, INT, REAL)
#: Maximum grace period of a cancelled portal, in seconds.
MAX_TIDY_SECONDS = 600.0


class AgentLimits(Struct, frozen=True):
    """Resource limits of one agent. A program that exceeds one gets a `LimitException` that L code can catch.

    `heap` in bytes; `call_depth` in calls; lengths in elements and characters; `threads` at one time. `tidy`
    is of another kind: the grace period in seconds after which a cancelled portal is ended.
    """

    heap: int = 1 << 20
    call_depth: int = 1000
    array_length: int = 1 << 20
    string_length: int = 1 << 20
    threads: int = 64
    tidy: float = 5.0


class Reading:
    """One quantity of one device: `word` is valid while the host's monotonic clock is before `until`.

    The first query without parameters asks the host. Later queries read the word directly, as fast as a
    variable. Other values (outdated, never reported, text, array) are queried from the host. The host changes
    readings only between two runs, so their state is constant during a run.
    """

    __slots__ = ("until", "word")

    def __init__(self) -> None:
        self.word, self.until = 0, -math.inf

    def update(self, word: int, until: float) -> None:
        """Set the word, and the end of its validity."""
        self.word, self.until = word, until


class EngineExit(Struct, frozen=True):
    """The reason for the return of an engine. A struct, as every turn makes one (see `mobility.effects`)."""


class ThreadDone(EngineExit, frozen=True):
    """The thread's first method returned; `word` is its result as in a slot."""

    word: int


class BudgetExhausted(EngineExit, frozen=True):
    """The budget or time slice is used up; the thread can continue."""


class Halted(EngineExit, frozen=True):
    """The thread has reached an instruction at which its engine was asked to stop."""


class MonitorBlocked(EngineExit, frozen=True):
    """Another thread of the agent holds the monitor; the instruction is repeated later."""


class HostCall(EngineExit, frozen=True):
    """An instruction that only the machine can execute.

    `op` is its opcode, `operand` its own operand, `words` the arguments as in their slots. The thread is at
    the instruction.
    """

    op: int
    operand: int
    words: list[int]


class UncaughtThrow(EngineExit, frozen=True):
    """The object at `place` is not caught in the thread; its frames are unchanged."""

    place: int


class HeapExhausted(EngineExit, frozen=True):
    """The heap lacks `words`; after a collection the same instruction is repeated."""

    words: int


class Group(Struct, frozen=True):
    """A prepared call group: its head, the slot of its result (-1: none), and the next instruction.

    `kind` is the type kind of the result, as in bytecode.program. `parks` is true for the `yield` of `while
    (true) yield();`.
    """

    head: Quad
    destination: int
    after: int
    kind: int
    parks: bool


class Trap(Exception):
    """A failed operation, which becomes an L exception of class `kind`."""

    def __init__(self, kind: str, message: str, source: str = "") -> None:
        self.kind, self.message, self.source = kind, message, source
        super().__init__(message)


BUDGET_EXHAUSTED = BudgetExhausted()
HALTED = Halted()
MONITOR_BLOCKED = MonitorBlocked()


class Engine(Protocol):
    """Runs threads of blocks of one program. Stateless between runs: another engine may continue."""

    #: The speed relative to the reference engine.
    pace: int

    @property
    def space(self) -> BlockAllocator:
        """The allocator for the blocks that this engine runs best."""

    @property
    def layouts(self) -> Layouts:
        """Positions of references, for the collector and the copier."""

    @property
    def groups(self) -> Mapping[int, Group]:
        """The groups of the program, by their first instruction."""

    @property
    def has_read_external(self) -> bool:
        """Whether the last run has read state outside the block."""

    @property
    def unused_budget(self) -> int:
        """The instructions of the budget that the last run has not used."""

    def run(
        self,
        block: Block,
        thread: int,
        budget: int,
        limits: AgentLimits,
        readings: Sequence[Reading | None] = (),
    ) -> EngineExit:
        """Run the thread at `thread` for at most `budget` instructions; `readings` are by device call.

        On return, frame and pc in the block are the position at which the thread will continue: after
        completed instructions, or at the instruction (the group) that could not be executed here.
        """

    def complete(self, block: Block, thread: int, word: int) -> None:
        """Pass the result to the thread's group; the thread continues after it."""

    def throw(self, block: Block, thread: int, thrown: int) -> bool:
        """Throw the object at `thrown` at the thread's position; false if it is not caught."""


class EngineWrapper:
    """Base class of engines that pass all calls on to another engine, and change a part of them.

    A subclass that overrides `run` sets `has_read_external` and `unused_budget`.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self.pace = engine.pace
        self.has_read_external, self.unused_budget = False, 0

    @property
    def space(self) -> BlockAllocator:
        """See `Engine`."""
        return self._engine.space

    @property
    def layouts(self) -> Layouts:
        """See `Engine`."""
        return self._engine.layouts

    @property
    def groups(self) -> Mapping[int, Group]:
        """See `Engine`."""
        return self._engine.groups

    def run(
        self,
        block: Block,
        thread: int,
        budget: int,
        limits: AgentLimits,
        readings: Sequence[Reading | None] = (),
    ) -> EngineExit:
        """See `Engine`."""
        engine = self._engine
        leave = engine.run(block, thread, budget, limits, readings)
        self.has_read_external, self.unused_budget = engine.has_read_external, engine.unused_budget
        return leave

    def complete(self, block: Block, thread: int, word: int) -> None:
        """See `Engine`."""
        self._engine.complete(block, thread, word)

    def throw(self, block: Block, thread: int, thrown: int) -> bool:
        """See `Engine`."""
        return self._engine.throw(block, thread, thrown)


#: Creates an engine for a program, with the clock that determines the validity of readings.
Engines = Callable[[Program, Callable[[], float]], Engine]
