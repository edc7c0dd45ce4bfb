"""Several machines and no network: coordinators leave, and calls begin and come back, when a test says."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

from lfield.bytecode.program import DeviceCall, Program
from lfield.clock import ManualClock
from lfield.manifest import DeviceValue
from lfield.testing.golden import Desk
from lfield.vm.agent import Agent, Member
from lfield.vm.attached import Rules
from lfield.vm.begun import Beginning, Begun
from lfield.vm.contract import Limits
from lfield.vm.machine import Machine
from lfield.vm.memory.collector import collect
from lfield.vm.world import PENDING, Pending


class Place(Desk):
    """The world of one host. `lets` and `keeps` say whether calls begin, and results are kept, at once.

    `asked` are the calls that wanted to begin; `unkept` the results that wait for a disk. Devices never
    answer: `waiting` has who waits for them; `cancels` says whether they can be cancelled.
    """

    def __init__(self) -> None:
        super().__init__()
        self.lets = self.keeps = self.cancels = True
        self.asked: list[list[Beginning]] = []
        self.unkept: list[Begun] = []
        self.waiting: list[tuple[Agent, int]] = []
        self.cancelled: list[int] = []

    def begins(self, agent: Agent, calls: Sequence[Beginning]) -> bool:
        assert agent.frozen
        self.asked.append(list(calls))
        return self.lets

    def came_back(self, begun: Begun) -> None:
        if self.keeps:
            self.machine.kept_result(begun.key)
        else:
            self.unkept.append(begun)

    def device(
        self, agent: Agent, thread: int, call: DeviceCall, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        self.waiting.append((agent, thread))
        return PENDING

    def cancel(self, agent: Agent, thread: int) -> bool:
        self.cancelled.append(thread)
        return self.cancels


class Joined:
    """Hosts with one resource each, r0, r1 ..., and a coordinator `boss` that starts on host 0.

    `hops` counts its migrations; whoever wants to a host in `cut` is told that it is unreachable.
    """

    def __init__(
        self,
        program: Program,
        hosts: int,
        kind: str = "Post",
        limits: Limits | None = None,
        place: Callable[[], Place] = Place,
        rules: Rules | None = None,
    ) -> None:
        self.program, self.clock, self.limits = program, ManualClock(), limits or Limits()
        self.rules = rules
        self.team = [Member(i, f"r{i}", kind, "resource", i) for i in range(hosts)]
        self.team.append(Member(hosts, "boss", "Boss", "coordinator", 0))
        self.places: list[Place] = []
        self.machines: list[Machine] = []
        self.cut: set[int] = set()
        self.hops = 0
        self.route = [0]
        for host in range(hosts):
            self.places.append(place())
            self.machines.append(self._machine(host, 1 + host))
        self.machines[0].start(self.team[-1], self.limits, 1)

    def _machine(self, host: int, life: int) -> Machine:
        place = self.places[host]
        place.machine = Machine(self.program, self.team, host, life, place, self.clock, random.Random(1))
        place.machine.attached.rules = self.rules
        place.machine.start(self.team[host], self.limits, 0)
        return place.machine

    def restart(self, host: int, kept: Sequence[Begun] = ()) -> Machine:
        """Another life of a host, which knows what was kept of its begun calls."""
        self.places[host].departures.clear()
        self.machines[host] = self._machine(host, 100 + host)
        self.machines[host].restore_begun(kept)
        return self.machines[host]

    @property
    def printed(self) -> list[str]:
        """What was said, host by host."""
        return [line for place in self.places for line in place.output]

    @property
    def boss(self) -> tuple[int, Agent]:
        """Where the coordinator is, and the coordinator."""
        return next((i, m.agents["boss"]) for i, m in enumerate(self.machines) if "boss" in m.agents)

    def still(self) -> float | None:
        """Run all machines until nothing can happen at this time; the seconds until something can."""
        for _ in range(10_000):
            pauses = [machine.run() for machine in self.machines]
            if 0.0 not in pauses:
                return min((pause for pause in pauses if pause is not None), default=None)
        raise AssertionError("the machines never rest")

    def carry(self) -> bool:
        """Let whoever wants to leave do so; false when nobody wants."""
        for source, place in enumerate(self.places):
            if place.departures:
                agent, resource = place.departures.pop()
                self.leave(source, agent, resource.host)
                return True
        return False

    def leave(self, source: int, agent: Agent, target: int) -> None:
        """One hop, or the word that the host is unreachable."""
        if target in self.cut:
            message = f"host {target} cannot be reached"
            self.machines[source].resume(agent, "UnreachableResourceException", message)
            return
        image = bytes(self.machines[source].pack(agent))
        self.machines[source].release(agent)
        arrived = self.machines[target].admit(agent.member, image, agent.limits)
        self.machines[target].go(arrived)
        self.hops += 1
        self.route.append(target)

    def run(self, until: float = 1000.0) -> None:
        """All to the end, or to a time on the clock that is counted from now; hops take no time."""
        end = self.clock.now + until
        while True:
            pause = self.still()
            if self.carry():
                continue
            if pause is None or self.clock.now + pause > end:
                self.clock.advance(max(0.0, end - self.clock.now) if pause is not None else 0.0)
                return
            self.clock.advance(pause)


class Collecting(Joined):
    """Collects everything whenever it can, and packs and restores the coordinator on every hop."""

    def still(self) -> float | None:
        for _ in range(100_000):
            pauses = [machine.run() for machine in self.machines]
            for machine in self.machines:
                for agent in machine.agents.values():
                    collect(agent.block, machine.layouts)
            if 0.0 not in pauses:
                return min((pause for pause in pauses if pause is not None), default=None)
        raise AssertionError("the machines never rest")
