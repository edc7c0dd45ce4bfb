"""Several machines without a network: a test decides when coordinators migrate, and calls start and
return."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

from lfield.bytecode.program import DeviceCallRecord, Program
from lfield.clock import ManualClock
from lfield.manifest import DeviceValue
from lfield.testing.golden import GoldenWorld
from lfield.vm.agent import Agent, MachineTeam, TeamMember
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.hooks import CallRules
from lfield.vm.host_interface import PENDING, Pending
from lfield.vm.machine import Machine
from lfield.vm.memory.collector import collect
from lfield.vm.pending_call import CallRequest, PendingCall


class HostWorldStub(GoldenWorld):
    """A stub of one host. `lets` and `keeps`: calls start, and results are persisted, at once.

    `asked` are the calls that waited for permission; `unkept` the results that wait for a disk. Devices never
    answer: `waiting` has their callers; `cancels` says whether they can be cancelled.
    """

    def __init__(self) -> None:
        super().__init__()
        self.lets = self.keeps = self.cancels = True
        self.asked: list[list[CallRequest]] = []
        self.unkept: list[PendingCall] = []
        self.waiting: list[tuple[Agent, int]] = []
        self.cancelled: list[int] = []
        #: The last wait of each coordinator for the first of several calls.
        self.cancel_requests: list[tuple[Agent, Sequence[tuple[TeamMember, int]]]] = []
        self.watched: dict[str, tuple[Agent, Sequence[tuple[TeamMember, int]]]] = {}

    def request_cancels(self, agent: Agent, calls: Sequence[tuple[TeamMember, int]]) -> None:
        self.cancel_requests.append((agent, calls))

    def watch_calls(self, agent: Agent, calls: Sequence[tuple[TeamMember, int]]) -> None:
        self.watched[agent.id] = agent, calls

    def may_start_calls(self, agent: Agent, calls: Sequence[CallRequest]) -> bool:
        assert agent.frozen
        self.asked.append(list(calls))
        return self.lets

    def on_call_completed(self, begun: PendingCall) -> None:
        if self.keeps:
            self.machine.pending_calls.on_persisted(begun.key)
        else:
            self.unkept.append(begun)

    def call_device(
        self, agent: Agent, thread: int, call: DeviceCallRecord, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        self.waiting.append((agent, thread))
        return PENDING

    def cancel(self, agent: Agent, thread: int) -> bool:
        self.cancelled.append(thread)
        return self.cancels


class JoinedHosts:
    """Hosts with resources, and a coordinator that starts on host 0.

    `team` ends with the coordinator; a number of hosts means one resource on each, r0, r1 ..., and `boss`.
    `images` are the bytes of every migration; hosts in `cut` are unreachable.
    """

    def __init__(
        self,
        program: Program,
        team: int | Sequence[TeamMember],
        kind: str = "Post",
        limits: AgentLimits | None = None,
        place: Callable[[], GoldenWorld] = HostWorldStub,
        rules: CallRules | None = None,
    ) -> None:
        self.program, self.clock, self.limits = program, ManualClock(), limits or AgentLimits()
        self.rules = rules
        if isinstance(team, int):
            boss = TeamMember(team, "boss", "Boss", "coordinator", 0)
            team = [*(TeamMember(i, f"r{i}", kind, "resource", i) for i in range(team)), boss]
        self.team = team
        self.places: list[GoldenWorld] = []
        self.machines: list[Machine] = []
        self.cut: set[int] = set()
        self.images: list[bytes] = []
        self.route = [0]
        for host in range(1 + max(member.host for member in team)):
            self.places.append(place())
            self.machines.append(self._machine(host, 1 + host))
        self.machines[0].start(self.team[-1], self.limits, 1)

    def _machine(self, host: int, life: int) -> Machine:
        place = self.places[host]
        place.machine = Machine(
            self.program, MachineTeam(self.team, host, life), place, self.clock, random.Random(1)
        )
        place.machine.hooks.rules = self.rules
        for member in self.team[:-1]:
            if member.host == host:
                place.machine.start(member, self.limits, 0)
        return place.machine

    def restart(self, host: int, kept: Sequence[PendingCall] = (), life: int = 0) -> Machine:
        """A new incarnation of a host, with the persisted records of its pending calls."""
        self.places[host].departures.clear()
        self.machines[host] = self._machine(host, life or 100 + host)
        self.machines[host].pending_calls.restore(kept)
        return self.machines[host]

    @property
    def printed(self) -> list[str]:
        """The output, host by host."""
        return [line for place in self.places for line in place.output]

    @property
    def boss(self) -> tuple[int, Agent]:
        """The host of the coordinator, and the coordinator."""
        return next((i, m.agents["boss"]) for i, m in enumerate(self.machines) if "boss" in m.agents)

    def still(self) -> float | None:
        """Run all machines until none is ready; returns the seconds until one is."""
        for _ in range(10_000):
            pauses = [machine.run() for machine in self.machines]
            if 0.0 not in pauses:
                return min((pause for pause in pauses if pause is not None), default=None)
        raise AssertionError("the machines never rest")

    def carry(self) -> bool:
        """Perform a requested migration; false when there is none."""
        for source, place in enumerate(self.places):
            if place.departures:
                agent, resource = place.departures.pop()
                self.leave(source, agent, resource.host)
                return True
        return False

    def report(self) -> bool:
        """Report calls that have ended to the coordinators that wait for them; false when there are none."""
        waits = [(place, wait) for place in self.places for wait in getattr(place, "watched", {}).values()]
        for place, (agent, calls) in waits:
            ended = [number for resource, number in calls if self._has_ended(agent, resource, number)]
            if ended and agent.waits_for_any:
                place.machine.pending_calls.on_ended_elsewhere(agent.id, agent.generation, ended)
                return True
        return False

    def _deliver_cancels(self) -> None:
        """Pass on what coordinators have asked other hosts to cancel."""
        for place in self.places:
            requests = getattr(place, "cancel_requests", [])
            while requests:
                agent, calls = requests.pop()
                for resource, number in calls:
                    if resource.host not in self.cut:
                        pending = self.machines[resource.host].pending_calls
                        pending.cancel_started(agent.id, agent.generation, [number])

    def _has_ended(self, agent: Agent, resource: TeamMember, number: int) -> bool:
        calls = self.machines[resource.host].pending_calls.calls()
        call = next((one for one in calls if one.key == (agent.id, agent.generation, number)), None)
        return resource.host in self.cut or call is None or (call.state != "running" and call.is_persisted)

    def leave(self, source: int, agent: Agent, target: int) -> None:
        """One hop, or the error for an unreachable host."""
        if target in self.cut:
            message = f"host {target} cannot be reached"
            self.machines[source].resume(agent, "UnreachableResourceException", message)
            return
        self.machines[target].unfreeze(self.move(source, agent, target))

    def move(self, source: int, agent: Agent, target: int) -> Agent:
        """The migration of a coordinator, which is frozen afterwards."""
        self.images.append(bytes(self.machines[source].pack(agent)))
        self.machines[source].release(agent)
        self.route.append(target)
        return self.machines[target].inject(agent.member, self.images[-1], agent.limits)

    def hop(self, source: int) -> Agent:
        """The migration of the coordinator that wants to leave this host."""
        agent, resource = self.places[source].departures.pop()
        return self.move(source, agent, resource.host)

    def run(self, until: float = 1000.0) -> None:
        """Run to the end, or for a time from now; hops take no time."""
        end = self.clock.now + until
        while True:
            pause = self.still()
            self._deliver_cancels()
            if self.carry() or self.report():
                continue
            if pause is None or self.clock.now + pause > end:
                self.clock.advance(max(0.0, end - self.clock.now) if pause is not None else 0.0)
                return
            self.clock.advance(pause)


class CollectingHosts(JoinedHosts):
    """Runs a garbage collection at every opportunity, and packs and restores the coordinator on every hop."""

    def still(self) -> float | None:
        for _ in range(100_000):
            pauses = [machine.run() for machine in self.machines]
            for machine in self.machines:
                for agent in machine.agents.values():
                    collect(agent.block, machine.layouts)
            if 0.0 not in pauses:
                return min((pause for pause in pauses if pause is not None), default=None)
        raise AssertionError("the machines never rest")
