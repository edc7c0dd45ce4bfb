"""What a step works on: the block of the running thread, its frame, and the ways to leave."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from lfield.vm.contract import Exit, Limits, Reading, Trap
from lfield.vm.memory.block import Block

#: The number of no instruction: the engine leaves, `Registers.exit` says why.
LEAVE = -1


class Registers:
    """Mirrors of the block for the length of one run; `slots` is the word of slot 0 of the frame."""

    __slots__ = (
        "asked",
        "block",
        "builtins",
        "class_names",
        "exit",
        "frame",
        "instructions",
        "limits",
        "now",
        "others",
        "pc",
        "place",
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
    #: The instruction that has raised something, then the one to go on at.
    pc: int
    #: Where the record of the running thread is.
    place: int
    exit: Exit
    #: One for each instruction that may be done yet.
    instructions: Iterator[None]
    limits: Limits
    class_names: list[str]
    #: How many of the first classes are built in.
    builtins: int
    #: By class, the field that has the exceptions of other calls of a `together`.
    others: dict[int, int]
    #: The agent's readings by device call, None where the host has to be asked; the time that judges them.
    readings: Sequence[Reading | None]
    now: Callable[[], float]
    #: Whether this run has read one.
    asked: bool


Step = Callable[[Registers], int]


def null_use(what: str) -> Trap:
    """The trap for a null reference where a thing was needed."""
    return Trap("NullException", f"{what} of null")
