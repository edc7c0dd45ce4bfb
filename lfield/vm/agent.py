"""One agent on this host: its block, and what the host keeps about it besides."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from lfield.vm.contract import Limits, Reading
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block

#: 'unknown' where a deployment was read without its program: such a team is only asked.
AgentKind = Literal["resource", "coordinator", "unknown"]


@dataclass(frozen=True, slots=True)
class Member:
    """An agent of the team as every host knows it: its number is its place in the deployment."""

    number: int
    id: str
    type: str
    kind: AgentKind
    host: int
    arguments: tuple[str, ...] = ()


class Agent:
    """An agent that is here. None of its execution state is outside `block`."""

    #: How it ended, '' while it is here; of one that died `report` is why, with a line for each call, and
    #: `broken` says whether a bug of lfield has ended it, not its program.
    ended = ""
    report = ""
    broken = False
    #: How many portals of it have returned.
    served = 0
    #: The block as the last thread that polls left it, empty when another thread has run since.
    seen = b""
    #: Whether the thread whose turn it was polls.
    polled = False
    #: Whether it may be recovered elsewhere: it begins no portal unless its host allows it.
    fenced = False
    #: Whether somebody has it, a resource: its host sets that, and is asked (`World.serves`) before each of
    #: its portals begins.
    reserved = False
    #: What is added to the host's monotonic clock, in ns, for the clock of a coordinator, by which its time
    #: limits run.
    offset = 0
    #: When these are looked at next, on the host's clock.
    alarm = math.inf
    #: Whether one is over that could not be thrown yet.
    overdue = False
    #: What is thrown when the call comes back that a limit has cancelled, and when that was over (ns).
    over, over_at = "", 0
    #: Why a limit that is over could not be thrown in time; why one did not leave that would come too late.
    late_since = too_far = ""

    # By hand, and with what seldom changes in the class: one is made at every hop.
    def __init__(
        self,
        member: Member,
        block: Block,
        limits: Limits,
        readings: list[Reading | None],
        *,
        opened: bool,
        frozen: bool = False,
        kept: bool = False,
    ) -> None:
        self.member, self.block, self.limits = member, block, limits
        #: The telemetry that the host keeps for it, by device call; a coordinator has none.
        self.readings = readings
        #: False until a resource's init has come to its first pause: calls wait in `waiting` till then.
        self.open = opened
        #: Whether it stands still until its host says how it goes on: at a hop, or at a portal call.
        self.frozen = frozen
        #: Whether it stands at a portal call, a coordinator, and its block is on the disk as it is there.
        self.kept = kept
        #: The id of the deployment.
        self.id = member.id
        #: Those whose calls wait until it is open, each with the thread.
        self.waiting: list[tuple[Agent, int]] = []
        #: Threads that wait for its monitor.
        self.blocked: list[int] = []
        #: What threads have written since their last newline.
        self.lines: dict[int, str] = {}
        #: How often a thread has yielded in a row; such threads poll.
        self.polls: dict[int, int] = {}
        #: Those of them that looked beyond the block.
        self.asked: set[int] = set()
        #: Those of them that are parked.
        self.pollers: set[int] = set()
        #: By the id of each coordinator that a resource has served, the newest copy of it: its generation and
        #: sequence.
        self.callers: dict[str, tuple[int, int]] = {}
        #: The threads of a resource whose calls are cancelled, each with the reason that is still to be
        #: thrown in it, '' once it was.
        self.cancels: dict[int, str] = {}
        #: The calls of its `together` whose results it has taken here since its host last asked.
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
