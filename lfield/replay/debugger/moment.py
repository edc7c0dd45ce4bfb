"""Moments of a replay: the points of a turn at which it can be stopped and inspected."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple, Protocol

from lfield.host.core import HostCore
from lfield.host.effects import Effect
from lfield.replay.debugger.statement_table import SourceLine, StatementTable
from lfield.replay.replay_environment import ReplayEnvironment
from lfield.vm.agent import Agent
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import FRAME_DEPTH, THREAD_FRAME, THREAD_ID, THREAD_PC

#: Added to the depth of a frame of a portal: it is called by a frame of its coordinator.
PORTAL_DEPTH = 1_000_000


class Phase(IntEnum):
    """REST: between two turns. INPUT: a turn has received its input. STATEMENT: a thread is about to execute
    a statement. END: the turn is over, and has effects."""

    REST = 0
    INPUT = 1
    STATEMENT = 2
    END = 3


class ThreadKey(NamedTuple):
    """A thread of an agent. `logical` is the coordinator that it works for: itself, or the one whose portal
    call it serves; otherwise AGENT#THREAD."""

    logical: str
    agent: str
    thread: int

    @property
    def has_caller(self) -> bool:
        """Whether the thread serves the portal call of a coordinator."""
        return self.logical not in (self.agent, f"{self.agent}#{self.thread}")


class ReplayState(NamedTuple):
    """The core of a host, its knowledge of its environment, and the statements of its program.

    The event log of the core begins at the turn `origin`.
    """

    core: HostCore
    environment: ReplayEnvironment
    table: StatementTable
    origin: int


class Moment:
    """A point of a replay, which is valid until the replay continues.

    In the phase STATEMENT, `block` and `thread` are those that run, and `place` is the place of the thread in
    its block. `step` is the number of the moment in its turn.
    """

    def __init__(
        self,
        state: ReplayState,
        phase: Phase,
        step: int = 0,
        effects: Sequence[Effect] = (),
        block: Block | None = None,
        place: int = 0,
    ) -> None:
        self.core, self.environment, self.table, self.origin = state
        self.phase, self.step = phase, step
        #: The effects of this turn until now.
        self.effects = effects
        self.block, self.place = block, place

    @property
    def agents(self) -> dict[str, Agent]:
        """The agents of the host by id."""
        return self.core.machine.agents

    @property
    def pc(self) -> int:
        """The instruction that is about to be executed, -1 outside of statements."""
        return -1 if self.block is None else self.block.w[self.place + THREAD_PC]

    @property
    def line(self) -> SourceLine | None:
        """The line of the instruction."""
        return None if self.block is None else self.table.line_of(self.pc)

    @cached_property
    def running(self) -> ThreadKey | None:
        """The thread that is about to execute a statement."""
        if self.block is None:
            return None
        w = self.block.w
        return thread_key(self.core, self.block.text(w[layout.W_ID]), w[self.place + THREAD_ID])

    @cached_property
    def depth(self) -> int:
        """The depth of the frame that is about to execute a statement, within its logical thread."""
        if self.block is None or self.running is None:
            return 0
        w = self.block.w
        depth: int = w[w[self.place + THREAD_FRAME] + FRAME_DEPTH]
        return depth if self.running.agent == self.running.logical else depth + PORTAL_DEPTH


def thread_key(core: HostCore, agent: str, thread: int) -> ThreadKey:
    """The key of a thread of an agent of a host."""
    found = core.machine.agents.get(agent)
    if found is None or found.member.kind == "coordinator":
        return ThreadKey(agent, agent, thread)
    caller = core.machine.served_calls.caller(found, thread)
    return ThreadKey(f"{agent}#{thread}" if caller is None else caller.id, agent, thread)


class Target(Protocol):
    """The target of a search: `is_met` is called with each moment in order.

    `stops` are the statements at which the target can be met, None for all. It may compare a moment with its
    predecessor: `start` is called with a moment at rest, before the first of a sequence.
    """

    @property
    def stops(self) -> frozenset[int] | None:
        """The statements at which the target can be met, besides the phases INPUT and END."""

    def start(self, moment: Moment) -> None:
        """Called with a moment at rest before a sequence of moments."""

    def is_met(self, moment: Moment) -> bool:
        """Whether the search ends here."""
