"""Starts and stops coordinators of golden programs: the home of all of them, in memory.

The decisions are those of the home of a mission (`lfield/host/sequencing`), without disk, rights and other
hosts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.vm.agent import STOPPED
from lfield.vm.engine_interface import AgentLimits, Trap

if TYPE_CHECKING:
    from lfield.vm.agent import Agent, TeamMember
    from lfield.vm.machine import Machine


class GoldenSequencer:
    """The runs of the startable coordinators; `attach` gives it the machine."""

    def __init__(self) -> None:
        self._machine: Machine | None = None
        #: The number of starts, and the end of each coordinator.
        self._starts: dict[str, int] = {}
        self._ends: dict[str, str] = {}
        self._waiting: list[tuple[Agent, str]] = []

    def attach(self, machine: Machine) -> None:
        """Sets the machine that runs the coordinators."""
        self._machine = machine

    def start(self, asking: Agent, member: TeamMember, request: int) -> bool | None:
        """Starts a coordinator at once, if it does not run."""
        assert self._machine is not None
        if member.id in self._machine.agents:
            raise Trap("ReservedException", f"{member.id} runs here already", member.id)
        self._starts[member.id] = self._starts.get(member.id, 0) + 1
        self._machine.start(member, AgentLimits(), self._starts[member.id])
        return True

    def has_started(self, member: TeamMember, request: int) -> bool:
        """Always False: a start returns at once."""
        return False

    def stop(self, asking: Agent, member: TeamMember) -> bool | None:
        """Orders the end of a coordinator, which `end_of` waits for."""
        assert self._machine is not None
        if asking.id == member.id:
            raise Trap("ConstraintException", f"{asking.id} cannot wait for its own end")
        if (agent := self._machine.agents.get(member.id)) is not None:
            self._machine.stop_coordinator(agent, f"it was stopped by {asking.id}")
        return True

    def end_of(self, asking: Agent, member: TeamMember) -> str | None:
        """The last end of a coordinator in a word; None while it runs."""
        assert self._machine is not None
        if member.id in self._machine.agents:
            self._waiting.append((asking, member.id))
            return None
        return self._ends.get(member.id, "not started")

    def abandon_wait(self, agent: Agent) -> bool:
        """Cancels the wait of a coordinator; returns whether it did wait."""
        before = len(self._waiting)
        self._waiting = [pair for pair in self._waiting if pair[0] is not agent]
        return len(self._waiting) < before

    def is_running(self, asking: Agent, member: TeamMember) -> bool | None:
        """Whether the machine runs the coordinator."""
        assert self._machine is not None
        return member.id in self._machine.agents

    def on_ended(self, agent: Agent) -> None:
        """Continues the coordinators that wait for one that has ended."""
        failed = f"failed: {agent.report.splitlines()[0]}" if agent.ended == "died" else ""
        self._ends[agent.id] = failed or (STOPPED if agent.report == STOPPED else "done")
        waiting, self._waiting = self._waiting, []
        for asking, name in waiting:
            if name != agent.id:
                self._waiting.append((asking, name))
            elif self._machine is not None:
                self._machine.unfreeze(asking)
