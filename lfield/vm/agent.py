"""One agent on this host: its block, and what the host keeps about it besides."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lfield.vm.contract import Limits, Reading
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block


@dataclass(frozen=True, slots=True)
class Member:
    """An agent of the team as every host knows it: its number is its place in the deployment."""

    number: int
    id: str
    type: str
    kind: str  # "resource" or "coordinator"
    host: int
    arguments: tuple[str, ...] = ()


class Agent:
    """An agent that is here. None of its execution state is outside `block`.

    `open` is false until a resource's init has come to its first pause: calls wait in `waiting` till then.
    `lines` holds what threads have written since their last newline. `polls` counts how often a thread has
    yielded in a row; such threads poll. `seen` is the block as the last of them left it, empty when another
    thread has run since; `asked` are those that looked beyond the block; `pollers` are parked. `readings` are
    the telemetry that the host keeps for it, by device call; a coordinator names no device and has none.

    `broken` says of one that has died that a bug of lfield has ended it, not its program.

    `kept` is true while a coordinator stands at a portal call and its host has its block on the disk as it is
    there. A `fenced` one begins no portal unless its host allows it.
    `callers` has, by the id of each coordinator that a resource has served, the newest copy of it: its
    generation and sequence. `cancels` are the threads of a resource whose calls are cancelled, each with the
    reason that is still to be thrown in it, '' once it was. A resource is `reserved` while somebody has it:
    its host sets that, and is asked (`World.serves`) before each of its portals begins.

    `offset` is what is added to the host's monotonic clock, in ns, for the clock of a coordinator, by which
    its time limits run. `alarm` is when they are looked at next, on the host's clock; `overdue` is true when
    one is over that could not be thrown yet, and `over` says what is thrown when the call that it has
    cancelled comes back. `fetched` are the calls of its `together` whose results it has taken here since
    its host last asked.
    """

    open: bool
    frozen: bool
    kept: bool
    ended = ""
    report = ""
    broken = False
    served = 0
    seen = b""
    polled = False
    fenced = False
    reserved = False
    offset = 0
    alarm = math.inf
    overdue = False
    over = ""

    # By hand, and with what seldom changes in the class: one is made at every hop.
    def __init__(
        self,
        member: Member,
        block: Block,
        limits: Limits,
        readings: list[Reading | None],
        *,
        open: bool,
        frozen: bool = False,
        kept: bool = False,
    ) -> None:
        self.member, self.block, self.limits, self.readings = member, block, limits, readings
        self.open, self.frozen, self.kept = open, frozen, kept
        #: The id of the deployment.
        self.id = member.id
        self.waiting: list[tuple[Agent, int]] = []
        self.blocked: list[int] = []
        self.lines: dict[int, str] = {}
        self.polls: dict[int, int] = {}
        self.asked: set[int] = set()
        self.pollers: set[int] = set()
        self.callers: dict[str, tuple[int, int]] = {}
        self.cancels: dict[int, str] = {}
        self.fetched: list[tuple[str, int, int]] = []

    @property
    def hops(self) -> int:
        """Migrations made so far."""
        return self.block.w[layout.W_HOPS]

    @property
    def generation(self) -> int:
        """Which start of its home it is of, counted."""
        return self.block.w[layout.W_GENERATION]

    @property
    def sequence(self) -> int:
        """Number of its last attempt to migrate."""
        return self.block.w[layout.W_SEQUENCE]
