"""Many hosts in one process on virtual time: the real cores, links that can be cut, computers that can die.

Sockets and processes are models here; everything that decides is what runs on a robot. There is no loop and
no thread: one queue of what is due, in the order of time and then of asking, so one seed is one run.
"""

from __future__ import annotations

import hashlib
import heapq
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations

from lfield.bytecode.program import DeviceCall
from lfield.capability.directory.news import Trouble
from lfield.clock import ManualClock
from lfield.errors import DeviceError
from lfield.host.core import HostCore
from lfield.host.effects import Call, Effect, KeepStart, Say, Write
from lfield.manifest import DeviceValue, Observation
from lfield.mission.mission import Mission
from lfield.mobility.effects import Send, SendTransfer
from lfield.vm.contract import Reading
from lfield.wire.messages import Control, Hello, Transfer

#: Seconds until a link that can be is there (again), and that a message is under way: at least and at most.
RECONNECT, LATENCY = (0.05, 1.0), (0.001, 0.02)
#: Seconds between the start of a host's resources and that of its coordinators.
CENSUS = 1.5
#: Turns of one host that may follow one another at the same moment: more, and it spins.
MOST_TURNS = 100_000

Watch = Callable[["Fleet"], None]


@dataclass(slots=True)
class Life:
    """One life of one host, from its start to its crash."""

    core: HostCore
    nearby: Links
    #: The number of its next turn: one that was arranged before is none any more.
    turn: int = 0
    output: list[str] = field(default_factory=list)


class Links:
    """What a host of the simulation has nearby: its links, and no devices."""

    def __init__(self, others: list[str], now: float) -> None:
        self.away: dict[str, float] = dict.fromkeys(others, now)
        self.heard: dict[str, float] = {}

    def last_heard(self, host: str) -> float | None:
        """When something last came from a host."""
        return self.heard.get(host)

    def last(self, device: str, quantity: str) -> Observation | None:
        """There are no devices."""
        return None

    def trouble(self, device: str) -> Trouble | None:
        """There are no devices."""
        return Trouble(f"{device}: not simulated")

    def query(self, agent: str, call: DeviceCall) -> DeviceValue:
        """There are no devices: raises DeviceError."""
        raise DeviceError(call.field, "is not simulated")

    def reading(self, agent: str, call: DeviceCall) -> Reading | None:
        """There are no devices."""
        return None


class Fleet:
    """The hosts of a mission, all up at the beginning. Everything that is left to chance comes from `seed`.

    `watch` is called after every event, and raises AssertionError for what must never be. A portal call of a
    host that cannot be reached is given up after `unreachable_after` seconds.
    """

    def __init__(
        self,
        mission: Mission,
        seed: int = 0,
        watch: Watch = lambda fleet: None,
        unreachable_after: float = 10.0,
    ) -> None:
        self.mission, self.dice, self._watch = mission, random.Random(seed), watch
        self.unreachable_after = unreachable_after
        #: Called for every new life of a host.
        self.on_boot: Callable[[str, Life], None] = lambda name, life: None
        #: The record of starts of each host: it stays when the host crashes, and may be lost.
        self.disks: dict[str, int] = {}
        self.clock = ManualClock(0.0)
        self.lives: dict[str, Life] = {}
        self.left: set[str] = set()
        #: Every line of program output and of the logs: seconds, host, text.
        self.log: list[tuple[float, str, str]] = []
        #: The pairs that are linked, with the number of the link, and those that cannot be.
        self.linked: dict[frozenset[str], int] = {}
        self.apart: set[frozenset[str]] = set()
        self.events = self.transfers = 0
        self._queue: list[tuple[float, int, Callable[[], None]]] = []
        self._asked = 0
        self._links = 0
        self._calling: set[frozenset[str]] = set()
        #: When the last message of each direction of each link arrives: none overtakes another.
        self._last_due: dict[tuple[int, str], float] = {}
        for name in mission.team.hosts:
            self.boot(name)

    # --- time -----------------------------------------------------------------------------------------

    def later(self, seconds: float, event: Callable[[], None]) -> None:
        """Let something happen after so many seconds."""
        self._asked += 1
        heapq.heappush(self._queue, (self.clock.now + seconds, self._asked, event))

    def run(self, seconds: float) -> None:
        """Let time go on for so long."""
        end = self.clock.now + seconds
        while self._queue and self._queue[0][0] <= end:
            self.clock.now, _, event = heapq.heappop(self._queue)
            self.events += 1
            event()
            self._watch(self)
        self.clock.now = end

    @property
    def digest(self) -> str:
        """What tells one run from another: the hash of all that was said, and when."""
        lines = (f"{at:.9f} {host} {text}\n" for at, host, text in self.log)
        return hashlib.sha256("".join(lines).encode()).hexdigest()

    # --- hosts ----------------------------------------------------------------------------------------

    def boot(self, name: str) -> None:
        """Start a host, with nothing left of its earlier life."""
        others = [other for other in self.mission.team.hosts if other != name]
        nearby = Links(others, self.clock.now)
        dice = random.Random(self.dice.random())
        life = self.dice.getrandbits(62) + 1
        core = HostCore(self.mission, name, life, self.clock, nearby, dice, self.unreachable_after)
        started = self.lives[name] = Life(core, nearby)
        self.enter(name, started, core.start_resources)
        for other in others:
            self._reconnect(name, other)
        start = partial(core.start_coordinators, self.disks.get(name))
        self.later(CENSUS, lambda: self.enter(name, started, start))
        self.on_boot(name, started)

    def lose_disk(self, name: str) -> None:
        """A host has no record of its starts any more."""
        self.disks.pop(name, None)

    def leave(self, name: str) -> None:
        """A host ends in order, for good."""
        self.left.add(name)
        self.crash(name)

    def crash(self, name: str) -> None:
        """End a host as a power cut does."""
        del self.lives[name]
        for pair in [pair for pair in self.linked if name in pair]:
            self._lose(pair)

    def enter(self, name: str, life: Life, event: Callable[[], None]) -> None:
        """An event of a host, if it is still alive; then its turn, and what comes of it."""
        if self.lives.get(name) is not life:
            return
        event()
        self._turn(name, life)

    def _turn(self, name: str, life: Life) -> None:
        for _ in range(MOST_TURNS):
            pause = life.core.run()
            for effect in life.core.take():
                self._carry_out(name, life, effect)
            if pause != 0.0:
                break
        else:
            raise AssertionError(f"{name} spins at {self.clock.now:.3f} s")
        life.turn += 1
        if pause is not None:
            self.later(pause, partial(self._come_back, name, life, life.turn))

    def _come_back(self, name: str, life: Life, turn: int) -> None:
        if life.turn == turn:
            self.enter(name, life, lambda: None)

    def _carry_out(self, name: str, life: Life, effect: Effect) -> None:
        match effect:
            case Send():
                self.send(name, effect.host, partial(self._received, effect.message))
            case SendTransfer():
                self.transfers += 1
                arrival = partial(self._arrived, effect.header, bytes(effect.block))
                self.send(name, effect.host, arrival)
            case Write() | Say():
                if isinstance(effect, Write):
                    life.output.append(effect.text)
                self.log.append((self.clock.now, name, effect.text))
            case Call():
                life.core.answered(effect, DeviceError(effect.call.field, "is not simulated"))
            case KeepStart():
                self.disks[name] = effect.generation
                life.core.kept(effect.generation)
            case _:
                pass

    # --- links ----------------------------------------------------------------------------------------

    def cut(self, one: str, other: str) -> None:
        """Break a link with all that is on its way, and let no new one come about until `heal`."""
        pair = frozenset((one, other))
        self.apart.add(pair)
        self._lose(pair)

    def heal(self, one: str, other: str) -> None:
        """Let links come about again."""
        self.apart.discard(frozenset((one, other)))

    def heal_all(self) -> None:
        """Let all links come about again, and start all hosts that are down."""
        self.apart.clear()
        for name in self.mission.team.hosts:
            if name not in self.lives.keys() | self.left:
                self.boot(name)

    def _reconnect(self, one: str, other: str) -> None:
        """Try to link two hosts by and by; one attempt at a time."""
        pair = frozenset((one, other))
        if pair not in self._calling:
            self._calling.add(pair)
            self.later(self.dice.uniform(*RECONNECT), partial(self._connect, one, other))

    def _connect(self, one: str, other: str) -> None:
        pair = frozenset((one, other))
        self._calling.discard(pair)
        if pair in self.linked or not pair <= self.lives.keys():
            return
        if pair in self.apart:
            self._reconnect(one, other)
            return
        self._links += 1
        self.linked[pair] = self._links
        for near, far in ((one, other), (other, one)):
            self.send(near, far, partial(self._greeted, self.lives[near].core.hello()))

    def _lose(self, pair: frozenset[str]) -> None:
        if self.linked.pop(pair, None) is None:
            return
        one, other = sorted(pair)
        for near, far in ((one, other), (other, one)):
            life = self.lives.get(near)
            if life is not None and far not in life.nearby.away:
                life.nearby.away[far] = self.clock.now
                self.later(0.0, partial(self.enter, near, life, partial(life.core.unlinked, far)))
        self._reconnect(one, other)

    def send(self, near: str, far: str, arrive: Callable[[str, str], None]) -> None:
        """Put something on its way; when the link breaks meanwhile, it is lost."""
        number = self.linked.get(frozenset((near, far)))
        if number is None:
            return
        due = max(self._last_due.get((number, near), 0.0), self.clock.now + self.dice.uniform(*LATENCY))
        self._last_due[number, near] = due
        self.later(due - self.clock.now, partial(self._deliver, number, near, far, arrive))

    def _deliver(self, number: int, near: str, far: str, arrive: Callable[[str, str], None]) -> None:
        if self.linked.get(frozenset((near, far))) == number:
            self.lives[far].nearby.heard[near] = self.clock.now
            arrive(near, far)

    def _greeted(self, hello: Hello, near: str, far: str) -> None:
        life = self.lives[far]
        life.nearby.away.pop(near, None)
        self.enter(far, life, partial(life.core.linked, hello))

    def _received(self, message: Control, near: str, far: str) -> None:
        life = self.lives[far]
        self.enter(far, life, partial(life.core.received, near, message))

    def _arrived(self, header: Transfer, block: bytes, near: str, far: str) -> None:
        life = self.lives[far]
        self.enter(far, life, partial(life.core.arrived, near, header, memoryview(block)))


@dataclass(frozen=True, slots=True)
class Weather:
    """What goes wrong, drawn from the dice of a fleet: mean seconds between two faults of a kind, 0 for none.

    A link that is cut is healed, a host that crashed is started, after up to `lasts` seconds.
    """

    cut_every: float = 0.0
    crash_every: float = 0.0
    lasts: float = 8.0

    def over(self, fleet: Fleet) -> None:
        """Let it break over a fleet from now on."""
        for mean, strike in ((self.cut_every, self._cut), (self.crash_every, self._crash)):
            if mean:
                fleet.later(fleet.dice.expovariate(1.0 / mean), partial(self._strike, fleet, mean, strike))

    def _strike(self, fleet: Fleet, mean: float, strike: Callable[[Fleet], None]) -> None:
        strike(fleet)
        fleet.later(fleet.dice.expovariate(1.0 / mean), partial(self._strike, fleet, mean, strike))

    def _cut(self, fleet: Fleet) -> None:
        one, other = fleet.dice.choice(list(combinations(fleet.mission.team.hosts, 2)))
        fleet.cut(one, other)
        fleet.later(fleet.dice.uniform(0.0, self.lasts), partial(fleet.heal, one, other))

    def _crash(self, fleet: Fleet) -> None:
        name = fleet.dice.choice(fleet.mission.team.hosts)
        if name in fleet.lives:
            fleet.crash(name)
            fleet.later(fleet.dice.uniform(0.0, self.lasts), partial(_boot_again, fleet, name))


def _boot_again(fleet: Fleet, name: str) -> None:
    if name not in fleet.lives.keys() | fleet.left:
        fleet.boot(name)


def copies(fleet: Fleet) -> Mapping[tuple[str, int], list[str]]:
    """The hosts on which each start of each coordinator can run now: agent and generation, host names."""
    found: dict[tuple[str, int], list[str]] = {}
    for name, life in fleet.lives.items():
        for agent in life.core.machine.agents.values():
            if agent.member.kind == "coordinator" and not agent.frozen and not agent.ended:
                found.setdefault((agent.id, agent.generation), []).append(name)
    return found
