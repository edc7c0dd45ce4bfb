"""The calls that a program makes: portal calls of coordinators and device calls of resources, in order."""

from __future__ import annotations

import math
from typing import NamedTuple

from msgspec import Struct

from lfield.host.core import HostCore
from lfield.host.effects import CallDevice
from lfield.replay.team_check import location_of
from lfield.vm.agent import Agent
from lfield.vm.inspection.traceback import FrameLocation


class LoggedCall(Struct, frozen=True):
    """A call of an agent: `text` is compared, `place` is its file and line in L.

    `at` is in seconds since 1970, `host` is the host of the call.
    """

    agent: str
    text: str
    at: float
    host: str
    place: str


class CallDifference(NamedTuple):
    """The difference in the calls of an agent: their number (from 1), and both calls, None for none."""

    agent: str
    number: int
    recorded: LoggedCall | None
    replayed: LoggedCall | None

    @property
    def at(self) -> float:
        """The time of the earlier call."""
        return min(each.at for each in (self.recorded, self.replayed) if each is not None)


class CallLog:
    """The calls of all agents of a team, as they are made."""

    def __init__(self) -> None:
        self.by_agent: dict[str, list[LoggedCall]] = {}
        #: The number of recorded device calls that were not made until then.
        self.missed_calls = 0
        #: The time when the first host halted its agents, or the recording ended.
        self.ended_at = math.inf
        #: The agents that have ended, and were not halted by their hosts.
        self.ended: set[str] = set()
        #: The most instructions that a thread has executed without a call or a pause.
        self.longest_computation = 0
        self._endless = 0

    @property
    def count(self) -> int:
        """The number of calls."""
        return sum(len(calls) for calls in self.by_agent.values()) - self._endless

    def end(self, at: float, missed_calls: int) -> None:
        """Record the end of the recording."""
        self.ended_at, self.missed_calls = at, missed_calls

    def may_follow(self, recorded: CallLog) -> bool:
        """Whether more time could show whether this program makes the recorded calls, and no others."""
        own = self.by_agent
        if self._endless:
            return False
        if any(len(own.get(agent, ())) < len(calls) for agent, calls in recorded.by_agent.items()):
            return True
        return bool(recorded.ended - self.ended) and recorded.first_difference(self) is None

    def add_device_call(self, core: HostCore, command: CallDevice, at: float) -> None:
        """Record an instruction of a resource to a device."""
        call = command.call
        values = ", ".join(_text(value) for value in command.values)
        self._add(command.agent, f"{call.field}.{call.instruction}({values})", core, at)

    def add_portal_call(self, core: HostCore, caller: str, resource: Agent, method: int, at: float) -> None:
        """Record that a portal of a resource of this host has started for a coordinator."""
        agent = core.machine.agents.get(caller)
        name = core.machine.program.core.methods[method].name
        text = f"{resource.id}.{name}"
        if agent is not None:
            self._add(agent, text, core, at)
        else:
            self._append(caller, text, core, None, at)

    def add_departure(self, core: HostCore, caller: str, text: str, at: float) -> None:
        """Record that a coordinator has left its host for a portal call."""
        if (agent := core.machine.agents.get(caller)) is not None:
            self._add(agent, text, core, at)

    def add_computation(self, core: HostCore, agent: str, location: FrameLocation | None, at: float) -> None:
        """Record a thread that computes on without a call or a pause: it differs from any call."""
        self._endless += 1
        self._append(agent, "computes on without a call or a pause", core, location, at)

    def _add(self, agent: Agent, text: str, core: HostCore, at: float) -> None:
        self._append(agent.id, text, core, location_of(agent, core.machine.program), at)

    def _append(
        self, agent: str, text: str, core: HostCore, location: FrameLocation | None, at: float
    ) -> None:
        place = "" if location is None else f"{location.file}:{location.line}"
        self.by_agent.setdefault(agent, []).append(LoggedCall(agent, text, at, core.name, place))

    def first_difference(self, other: CallLog) -> CallDifference | None:
        """The earliest difference of another log to this one; None if both have the same calls.

        Of several at one time, an additional call is the cause of the missing ones.
        """
        found = [
            difference
            for agent in sorted(self.by_agent.keys() | other.by_agent.keys())
            if (difference := self._difference(other, agent)) is not None
        ]
        return min(found, key=lambda each: (each.at, each.replayed is None), default=None)

    def _difference(self, other: CallLog, agent: str) -> CallDifference | None:
        recorded, replayed = self.by_agent.get(agent, []), other.by_agent.get(agent, [])
        for number in range(max(len(recorded), len(replayed))):
            recorded_call = recorded[number] if number < len(recorded) else None
            replayed_call = replayed[number] if number < len(replayed) else None
            if (
                recorded_call is None
                and replayed_call is not None
                and replayed_call.at >= self.ended_at
                and agent not in self.ended
            ):
                # The recorded agent was halted then.
                return None
            if recorded_call is None or replayed_call is None or recorded_call.text != replayed_call.text:
                return CallDifference(agent, number + 1, recorded_call, replayed_call)
        return None


def _text(value: object) -> str:
    return f"{value:.9g}" if isinstance(value, float) else repr(value)
