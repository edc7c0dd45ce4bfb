"""What an engine is given and what it gives back: limits, readings, exits and traps.

Everything the world can see happens between two calls of an engine's `run`, so one engine may take over from
another in the middle of an execution. All that engines share is this file and the block.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from msgspec import Struct

from lfield.bytecode.program import BOOLEAN, INT, REAL, Program, Quad
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import Layouts
from lfield.vm.memory.space import Space

#: The kinds of values that are one word and need no room on a heap.
PLAIN = (BOOLEAN, INT, REAL)
#: The longest time that a cancelled portal may be given to tidy up, in seconds.
MAX_TIDY = 600.0


@dataclass(frozen=True, slots=True)
class Limits:
    """What one agent may use. Every limit ends in a `LimitException` that L code can catch.

    `heap` in bytes; `call_depth` in calls; lengths in elements and characters; `threads` at one time. Only
    `tidy` ends otherwise: a portal that is cancelled has so many seconds to tidy up, then it is ended.
    """

    heap: int = 1 << 20
    call_depth: int = 1000
    array_length: int = 1 << 20
    string_length: int = 1 << 20
    threads: int = 64
    tidy: float = 5.0


class Reading:
    """One quantity of one device: `word` is valid while the host's monotonic clock is before `until`.

    A query without parameters asks the host once. From then on the engine reads the word itself, which costs
    hardly more than a variable. Whatever is not plain (too old, never reported, text, an array) still leaves
    the engine. The host changes readings only between two runs: one run sees one state of the world.
    """

    __slots__ = ("until", "word")

    def __init__(self) -> None:
        self.word, self.until = 0, -math.inf


class Exit(Struct, frozen=True):
    """Why an engine came back. A struct, since one is made in every turn (see `mobility.effects`)."""


class Done(Exit, frozen=True):
    """The thread's first method returned; `word` is its result as it stood in a slot."""

    word: int


class Spent(Exit, frozen=True):
    """The budget is used up, or it has taken long; the thread can go on."""


class Stopped(Exit, frozen=True):
    """The thread has come to an instruction where its engine was asked to stop."""


class Blocked(Exit, frozen=True):
    """Another thread of the agent holds the monitor; the instruction runs again later."""


class Outside(Exit, frozen=True):
    """A head that only the machine can carry out.

    `op` is its opcode, `operand` its own operand, `words` the arguments as they stood in their slots.
    The thread stands at the first instruction of the group; `Engine.complete` gives it the result.
    """

    op: int
    operand: int
    words: list[int]


class Thrown(Exit, frozen=True):
    """Nobody in the thread catches the object at `place`; its frames stand as they were."""

    place: int


class NoRoom(Exit, frozen=True):
    """The heap lacks `words`; after a collection the same instruction runs again."""

    words: int


@dataclass(frozen=True, slots=True)
class Group:
    """A prepared group: its head, the slot its result goes to (-1: none), and the instruction after it.

    `kind` is the type kind of the result, as in bytecode.program. `parks` is true for the `yield` of
    `while (true) yield();`.
    """

    head: Quad
    destination: int
    after: int
    kind: int
    parks: bool


class Trap(Exception):
    """What cannot be done and becomes an L exception of the class `kind`."""

    def __init__(self, kind: str, message: str, source: str = "") -> None:
        self.kind, self.message, self.source = kind, message, source
        super().__init__(message)


SPENT = Spent()
STOPPED = Stopped()
BLOCKED = Blocked()


class Engine(Protocol):
    """Runs threads of blocks of one program. Keeps nothing between two runs: another one may go on."""

    #: How many times as much as the reference engine it does in the same time.
    pace: int

    @property
    def space(self) -> Space:
        """Where the blocks that it runs best have their bytes."""

    @property
    def layouts(self) -> Layouts:
        """Where references are, for the collector and the copier."""

    @property
    def groups(self) -> Mapping[int, Group]:
        """The groups of the program, by their first instruction."""

    @property
    def asked(self) -> bool:
        """Whether the last run has read what is beyond the block."""

    @property
    def unused(self) -> int:
        """How many instructions of its budget the last run has not used."""

    def run(
        self,
        block: Block,
        thread: int,
        budget: int,
        limits: Limits,
        readings: Sequence[Reading | None] = (),
    ) -> Exit:
        """Run the thread at `thread` for at most `budget` instructions; `readings` are by device call.

        On return the thread's frame and pc in the block are where it will go on: behind what is done, or at
        the instruction (the group) that could not be done here.
        """

    def complete(self, block: Block, thread: int, word: int) -> None:
        """Give the group the thread stands at its result; the thread goes on behind it."""

    def throw(self, block: Block, thread: int, thrown: int) -> bool:
        """Throw the object at `thrown` where the thread stands; false when nobody catches it."""


#: Makes an engine for a program. It judges readings by the clock it is given.
Engines = Callable[[Program, Callable[[], float]], Engine]
