"""What an engine is given and what it gives back: limits, readings, exits and traps.

Everything the world can see happens between two calls of an engine's `run`, so one engine may take over from
another in the middle of an execution. All that engines share is this file and the block.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from msgspec import Struct

from lfield.bytecode.program import BOOLEAN, INT, REAL

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
    """The budget is used up; the thread can go on."""


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


class Trap(Exception):
    """What cannot be done and becomes an L exception of the class `kind`."""

    def __init__(self, kind: str, message: str, source: str = "") -> None:
        self.kind, self.message, self.source = kind, message, source
        super().__init__(message)


SPENT = Spent()
BLOCKED = Blocked()
