"""Hosts that have only the quorum core, and the real time that none of them knows.

Each host has a clock with a rate of its own, which begins anew when its computer boots. Messages are lost,
delayed and reordered; links are cut, also in one direction. Everything follows from a story and its seed.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Collection
from itertools import count
from typing import Any

from quorum_host import HostLife
from quorum_judge import Judge
from quorum_scenario import Fault, Story

from lfield.replication.lease.core import Quorum
from lfield.wire.coordinator_messages import Locate

#: A message takes so long, in seconds, when nothing holds it up; and when something does.
SWIFT, SLOW = (0.001, 0.02), (0.05, 3.0)
#: When all is well, every coordinator acts after so many seconds and three of its intervals.
PATIENCE = 12.0
#: What a commit takes, in seconds; and on a disk that is slow.
COMMIT, SLOW_COMMIT = (0.001, 0.02), (0.2, 4.0)


class Computer:
    """A host over all its lives: its disk, its clock, and whether it is stopped."""

    def __init__(self, name: str, rate: float, zero: float) -> None:
        self.name, self.rate, self.zero = name, rate, zero
        self.disk: dict[tuple, object] = {}
        self.life: HostLife | None = None
        self.frozen = False
        #: What has come while it was stopped.
        self.backlog: list[Callable[[], None]] = []

    def clock(self, real: float) -> float:
        """What its clock shows, in seconds since it was booted."""
        return (real - self.zero) * self.rate

    def real(self, local: float) -> float:
        """When its clock shows that."""
        return self.zero + local / self.rate


class World:
    """What is outside of hosts. `now` is real time, in seconds."""

    def __init__(self, story: Story, core: type[Quorum] = Quorum) -> None:
        self.story, self.core = story, core
        self.now, self.rng = 0.0, random.Random(story.seed)
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._count, self._lives = count(), count(1)
        self.judge = Judge(self)
        #: Until when each direction is cut, loses half, or is late; until when a host's disk is slow.
        self.cut: dict[tuple[str, str], float] = {}
        self.lossy: dict[tuple[str, str], float] = {}
        self.late: dict[tuple[str, str], float] = {}
        self.slow: dict[str, float] = {}
        self.hosts = {
            name: Computer(name, rate, -self.rng.uniform(0.0, 1e5))
            for name, rate in zip(story.hosts, story.rates, strict=True)
        }
        for name in story.hosts:
            self.boot(name)
        for agent, home in story.agents.items():
            life = self.hosts[home].life
            assert life
            life.start(agent)
        for fault in story.faults:
            self.at(fault.at, lambda fault=fault: self._strike(fault))

    # --- time -----------------------------------------------------------------------------------------

    def at(self, when: float, event: Callable[[], None]) -> None:
        """Something happens at that real time."""
        heapq.heappush(self._events, (max(when, self.now), next(self._count), event))

    def run(self, until: float) -> None:
        """Everything that happens until then."""
        while self._events and self._events[0][0] <= until:
            self.now, _, event = heapq.heappop(self._events)
            event()
        self.now = until

    def _is(self, troubled: dict[Any, float], what: object) -> bool:
        return self.now < troubled.get(what, 0.0)

    def commit(self, name: str) -> float:
        """How long a commit of that host takes, in seconds."""
        return self.rng.uniform(*(SLOW_COMMIT if self._is(self.slow, name) else COMMIT))

    # --- messages -------------------------------------------------------------------------------------

    def send(self, sender: str, host: str, message: object) -> None:
        """A message leaves."""
        way = sender, host
        if self._is(self.cut, way) or (self._is(self.lossy, way) and self.rng.random() < 0.5):
            return
        ambush = self.story.ambush and self.now < self.story.until
        if ambush and isinstance(message, Locate) and self.rng.random() < 0.2:
            self._ambush(sender)
        delay = self.rng.uniform(*(SLOW if self._is(self.late, way) else SWIFT))
        self.at(self.now + delay, lambda: self._deliver(sender, host, message))

    def _deliver(self, sender: str, host: str, message: object) -> None:
        life = self.hosts[host].life
        if life:
            life.enter(lambda: life.on_message(sender, message))

    # --- faults ---------------------------------------------------------------------------------------

    def boot(self, name: str) -> None:
        """A host begins a life, with what is on its disk."""
        computer = self.hosts[name]
        if computer.life is None:
            self.judge.disturbed = self.now
            computer.life = HostLife(self, computer, next(self._lives))
            computer.life.join()

    def kill(self, name: str) -> None:
        """A life ends. What its devices were last told they do until that runs out."""
        computer = self.hosts[name]
        self.judge.disturbed = self.now
        computer.life, computer.backlog, computer.frozen = None, [], False

    def reboot(self, name: str) -> None:
        """A computer comes back, and its clock shows little more than nothing."""
        if self.hosts[name].life is None:
            self.hosts[name].zero = self.now - self.rng.uniform(0.0, 5.0)
            self.boot(name)

    def freeze(self, name: str) -> None:
        """A process is stopped; its clock is not."""
        self.judge.disturbed = self.now
        self.hosts[name].frozen = self.hosts[name].life is not None

    def thaw(self, name: str) -> None:
        """It goes on, with what has come meanwhile, in any order."""
        computer = self.hosts[name]
        if computer.frozen:
            self.judge.disturbed = self.now
            computer.frozen = False
            backlog, computer.backlog = computer.backlog, []
            self.rng.shuffle(backlog)
            for event in backlog:
                event()

    def _strike(self, fault: Fault) -> None:
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
                self._blow(fault, end)

    def _blow(self, fault: Fault, end: float) -> None:
        hit = {"lossy": self.lossy, "late": self.late}.get(fault.kind, self.cut)
        hit.update((way, max(end, hit.get(way, end))) for way in self._ways(fault.kind, fault.hosts))

    def _ambush(self, asker: str) -> None:
        """When a host suspects, all links come back, but for those with another one."""
        self.cut.clear()
        hosts = asker, self.rng.choice([name for name in self.hosts if name != asker])
        self._blow(Fault(self.now, "link", hosts, 0.0), self.now + 4.0)

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
        """Every link is well, and every host is up, from now on."""
        for troubled in (self.cut, self.lossy, self.late, self.slow):
            troubled.clear()
        for name in self.hosts:
            self.thaw(name)
            self.boot(name)


def judged(story: Story, core: type[Quorum] = Quorum) -> World:
    """The whole story, then a time in which all is well: every coordinator acts again, or has terminated."""
    world = World(story, core)
    world.run(story.until)
    world.heal()
    world.run(story.until + PATIENCE + 3.0 * story.interval)
    for agent in story.agents:
        has_acted = world.judge.acted.get(agent, 0.0) >= story.until
        if not has_acted and not world.judge.has_terminated(agent):
            world.judge.breach(f"{agent} has not acted again although all is well")
    return world
