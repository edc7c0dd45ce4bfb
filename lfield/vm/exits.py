"""Why an engine came back. Everything the world can see happens between two calls of run."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Exit:
    """Root of the exits."""


@dataclass(frozen=True, slots=True)
class Done(Exit):
    """The thread's first method returned; `word` is its result as it stood in a slot."""

    word: int


@dataclass(frozen=True, slots=True)
class Spent(Exit):
    """The budget is used up; the thread can go on."""


@dataclass(frozen=True, slots=True)
class Blocked(Exit):
    """Another thread of the agent holds the monitor; the instruction runs again later."""


@dataclass(frozen=True, slots=True)
class Outside(Exit):
    """A head that only the machine can carry out.

    `op` is its opcode, `operand` its own operand, `words` the arguments as they stood in their slots.
    The thread stands at the first instruction of the group; `Engine.complete` gives it the result.
    """

    op: int
    operand: int
    words: list[int]


@dataclass(frozen=True, slots=True)
class Thrown(Exit):
    """Nobody in the thread catches the object at `place`; its frames stand as they were."""

    place: int


@dataclass(frozen=True, slots=True)
class NoRoom(Exit):
    """The heap lacks `words`; after a collection the same instruction runs again."""

    words: int


class Trap(Exception):
    """What cannot be done and becomes an L exception of the class `kind`."""

    def __init__(self, kind: str, message: str, source: str = "") -> None:
        self.kind, self.message, self.source = kind, message, source
        super().__init__(message)


SPENT = Spent()
BLOCKED = Blocked()
