"""Hosts that consist of the quorum core, and the real time, which is unknown to them.

Each host has a clock with its own rate, which restarts when its computer boots. Messages are lost, delayed
and reordered; links are cut, also in one direction. The run is determined by a scenario and its seed.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Collection
from itertools import count
from typing import Any

from quorum_host import HostLife
from quorum_judge import Judge
from quorum_scenario import Fault, Scenario

from lfield.replication.lease.core import Quorum
from lfield.wire.coordinator_messages import Locate

#: The delay of a message in seconds, normal and slow.
SWIFT, SLOW = (0.001, 0.02), (0.05, 3.0)
#: Seconds, in addition to three heartbeat intervals, in which every coordinator acts after all faults.
TIMEOUT = 12.0
#: The duration of a commit in seconds, normal and on a slow disk.
COMMIT, SLOW_COMMIT = (0.001, 0.02), (0.2, 4.0)


class Computer:
    """A host over all its lives: its disk, its clock, and whether it is stopped."""

    def __init__(self, name: str, rate: float, zero: float) -> None:
        self.name, self.rate, self.zero = name, rate, zero
        self.disk: dict[tuple, object] = {}
        self.life: HostLife | None = None
        self.frozen = False
        #: Events that arrived while it was stopped.
        self.backlog: list[Callable[[], None]] = []

    def clock(self, real: float) -> float:
        """The time on its clock, in seconds since it was booted."""
        return (real - self.zero) * self.rate

    def real(self, local: float) -> float:
        """The real time of a time on its clock."""
        return self.zero + local / self.rate


class World:
    """The environment of the hosts. `now` is real time, in seconds."""

    def __init__(self, scenario: Scenario, core: type[Quorum] = Quorum) -> None:
        self.scenario, self.core = scenario, core
        self.now, self.rng = 0.0, random.Random(scenario.seed)
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._count, self._lives = count(), count(1)
        self.judge = Judge(self)
        #: Until when each direction is cut, lossy, or late; until when a host's disk is slow.
        self.cut: dict[tuple[str, str], float] = {}
        self.lossy: dict[tuple[str, str], float] = {}
        self.late: dict[tuple[str, str], float] = {}
        self.slow: dict[str, float] = {}
        self.hosts = {
            name: Computer(name, rate, -self.rng.uniform(0.0, 1e5))
            for name, rate in zip(scenario.hosts, scenario.rates, strict=True)
        }
        for name in scenario.hosts:
            self.boot(name)
        for agent, home in scenario.agents.items():
            life = self.hosts[home].life
            assert life
            life.start(agent)
        for fault in scenario.faults:
            self.at(fault.at, lambda fault=fault: self._apply(fault))

    # --- time -----------------------------------------------------------------------------------------

    def at(self, when: float, event: Callable[[], None]) -> None:
        """Schedule an event at a real time."""
        heapq.heappush(self._events, (max(when, self.now), next(self._count), event))

    def run(self, until: float) -> None:
        """Execute all events until a time."""
        while self._events and self._events[0][0] <= until:
            self.now, _, event = heapq.heappop(self._events)
            event()
        self.now = until

    def _is_active(self, troubled: dict[Any, float], what: object) -> bool:
        return self.now < troubled.get(what, 0.0)

    def commit(self, name: str) -> float:
        """The duration of a commit of that host, in seconds."""
        return self.rng.uniform(*(SLOW_COMMIT if self._is_active(self.slow, name) else COMMIT))

    # --- messages -------------------------------------------------------------------------------------

    def send(self, sender: str, host: str, message: object) -> None:
        """Send a message."""
        way = sender, host
        if self._is_active(self.cut, way) or (self._is_active(self.lossy, way) and self.rng.random() < 0.5):
            return
        ambush = self.scenario.ambush and self.now < self.scenario.until
        if ambush and isinstance(message, Locate) and self.rng.random() < 0.2:
            self._leave_one_link(sender)
        delay = self.rng.uniform(*(SLOW if self._is_active(self.late, way) else SWIFT))
        self.at(self.now + delay, lambda: self._deliver(sender, host, message))

    def _deliver(self, sender: str, host: str, message: object) -> None:
        life = self.hosts[host].life
        if life:
            life.enter(lambda: life.on_message(sender, message))

    # --- faults ---------------------------------------------------------------------------------------

    def boot(self, name: str) -> None:
        """Start a life of a host with the records on its disk."""
        computer = self.hosts[name]
        if computer.life is None:
            self.judge.disturbed = self.now
            computer.life = HostLife(self, computer, next(self._lives))
            computer.life.join()

    def kill(self, name: str) -> None:
        """End a life. Its devices execute their last commands until these expire."""
        computer = self.hosts[name]
        self.judge.disturbed = self.now
        computer.life, computer.backlog, computer.frozen = None, [], False

    def reboot(self, name: str) -> None:
        """Boot a computer; its clock starts near zero."""
        if self.hosts[name].life is None:
            self.hosts[name].zero = self.now - self.rng.uniform(0.0, 5.0)
            self.boot(name)

    def freeze(self, name: str) -> None:
        """Stop a process; its clock continues."""
        self.judge.disturbed = self.now
        self.hosts[name].frozen = self.hosts[name].life is not None

    def thaw(self, name: str) -> None:
        """Continue a stopped process, with the events of the meantime in any order."""
        computer = self.hosts[name]
        if computer.frozen:
            self.judge.disturbed = self.now
            computer.frozen = False
            backlog, computer.backlog = computer.backlog, []
            self.rng.shuffle(backlog)
            for event in backlog:
                event()

    def _apply(self, fault: Fault) -> None:
        name, end = fault.hosts[0], self.now + fault.span
        match fault.kind:
            case "crash":
                self.kill(name)
                self.at(end, lambda: self.reboot(name))
            case "restart":
                self.kill(name)
                self.at(end, lambda: self.boot(name))
            case "freeze":
                self.freeze(name)
                self.at(end, lambda: self.thaw(name))
            case "slow disk":
                self.slow[name] = end
            case _:
                self._apply_to_links(fault, end)

    def _apply_to_links(self, fault: Fault, end: float) -> None:
        hit = {"lossy": self.lossy, "late": self.late}.get(fault.kind, self.cut)
        hit.update((way, max(end, hit.get(way, end))) for way in self._ways(fault.kind, fault.hosts))

    def _leave_one_link(self, asker: str) -> None:
        """When a host suspects, restore all links, except those with another host."""
        self.cut.clear()
        hosts = asker, self.rng.choice([name for name in self.hosts if name != asker])
        self._apply_to_links(Fault(self.now, "link", hosts, 0.0), self.now + 4.0)

    def _ways(self, kind: str, hosts: Collection[str]) -> list[tuple[str, str]]:
        first, *_ = hosts
        inside, outside = set(hosts), [name for name in self.hosts if name not in hosts]
        out = [(one, other) for one in hosts for other in outside]
        match kind:
            case "only":
                return [
                    (one, other) for one in self.hosts for other in self.hosts if not {one, other} <= inside
                ]
            case "link":
                return [(one, other) for one in inside for other in inside if one != other]
            case "island":
                return out + [(other, one) for one, other in out]
            case "deaf":
                return [(other, first) for other in self.hosts if other != first]
            case "mute":
                return [(first, other) for other in self.hosts if other != first]
            case "one way":
                return [(one, other) for one in inside for other in inside if one < other]
        return [(one, other) for one in self.hosts for other in self.hosts if {one, other} & inside]

    def heal(self) -> None:
        """Restore all links and start all hosts."""
        for troubled in (self.cut, self.lossy, self.late, self.slow):
            troubled.clear()
        for name in self.hosts:
            self.thaw(name)
            self.boot(name)


def judged(scenario: Scenario, core: type[Quorum] = Quorum) -> World:
    """Run the scenario, then a time without faults: every coordinator acts again, or has terminated."""
    world = World(scenario, core)
    world.run(scenario.until)
    world.heal()
    world.run(scenario.until + TIMEOUT + 3.0 * scenario.interval)
    for agent in scenario.agents:
        has_acted = world.judge.acted.get(agent, 0.0) >= scenario.until
        if not has_acted and not world.judge.has_terminated(agent):
            world.judge.breach(f"{agent} has not acted again although there are no faults")
    return world
