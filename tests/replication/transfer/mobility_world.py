"""Simulated hosts around `Mobility`, with a faulty network, and a judge of all hosts.

Coordinators only hop and count; a block is their name, start, last number and count. The judge
(`World.check`) checks the promises of `lfield/docs/mobility.md` on all hosts at once.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations

from lfield.replication.transfer.core import Mobility
from lfield.replication.transfer.effects import (
    DropTerminated,
    MarkInDoubt,
    MarkMigrated,
    ResumeWithException,
    Send,
    SendTransfer,
    TerminateCopy,
    TransferRefusal,
)
from lfield.replication.transfer.generations import outranks
from lfield.wire.messages import Hello

PROGRAM = b"p" * 32
TIMEOUT = 10.0

Start = tuple[str, int]


@dataclass
class SimHost:
    """One life of one host: its machine holds counts of coordinators instead of blocks."""

    name: str
    incarnation: int
    mobility: Mobility = None
    running: dict[Start, int] = field(default_factory=dict)
    frozen: dict[Start, int] = field(default_factory=dict)
    greeted: dict[str, int] = field(default_factory=dict)  # peer -> incarnation
    doubted: set[Start] = field(default_factory=set)
    full: bool = False

    def drop(self, start: Start) -> None:
        self.running.pop(start, None)
        self.frozen.pop(start, None)


@dataclass(frozen=True)
class Packet:
    """A message in flight between two lives."""

    source: str
    target: str
    incarnation: int
    link: int
    content: object  # Hello, SendTransfer or a message


class World:
    """Hosts, links, packets, time, and the true states."""

    def __init__(self, names: str, agents: dict[str, str], mobility: type[Mobility] = Mobility) -> None:
        self.names, self.homes, self.machine = list(names), agents, mobility
        self.now = 0.0
        self.lives = 0
        self.links = 0
        self.hosts: dict[str, SimHost] = {}
        self.packets: list[Packet] = []
        self.open: dict[frozenset[str], int] = {}
        self.injected: Counter[tuple[str, int, int]] = Counter()
        self.count: dict[Start, int] = {}  # the true state of every start
        self.finished: set[Start] = set()
        self.superseded: set[Start] = set()
        self.dead: set[Start] = set()  # its host died, or it was given up in doubt
        self.doubtful: set[Start] = set()  # a receiver died, and its verdict with it
        for name in self.names:
            self.boot(name)

    # Events

    def boot(self, name: str) -> None:
        self.lives += 1
        host = SimHost(name, self.lives)
        self.enter(host)
        for agent, home in self.homes.items():
            if home == name:
                host.mobility.start(agent, self.lives)
                host.running[agent, self.lives] = self.count[agent, self.lives] = 0

    def enter(self, host: SimHost) -> None:
        """Start a life without records."""
        host.mobility = self.machine(
            self.hello(host),
            peers=self.names,
            agents=list(self.homes),
            unreachable_after=TIMEOUT,
        )
        self.hosts[host.name] = host

    def kill(self, name: str) -> None:
        host = self.hosts.pop(name)
        self.dead |= host.running.keys() | host.frozen.keys()
        for other in self.hosts.values():
            for known in other.mobility.known_states():
                if known.where == name and known.state in ("PREPARED", "IN DOUBT"):
                    self.doubtful.add((known.agent, known.generation))
        for pair in [pair for pair in self.open if name in pair]:
            del self.open[pair]

    def unlinked_pairs(self) -> list[tuple[str, str]]:
        pairs = combinations(sorted(self.hosts), 2)
        return [pair for pair in pairs if frozenset(pair) not in self.open]

    def connect(self, one: str, other: str) -> None:
        pair = frozenset((one, other))
        if pair in self.open or not {one, other} <= self.hosts.keys():
            return
        self.links += 1
        self.open[pair] = self.links
        for source, target in ((one, other), (other, one)):
            greeting = self.hello(self.hosts[source])
            self.packets.append(self.packet(source, target, greeting))

    def cut(self, one: str, other: str) -> None:
        """Break the link; each side notices when `notice` is called."""
        self.open.pop(frozenset((one, other)), None)

    def notice(self, name: str, peer: str) -> None:
        host = self.hosts.get(name)
        if host is not None and frozenset((name, peer)) not in self.open and peer in host.greeted:
            del host.greeted[peer]
            host.mobility.on_unlinked(peer)

    def deliver(self, packet: Packet) -> None:
        host = self.hosts.get(packet.target)
        if host is None or host.incarnation != packet.incarnation:
            return
        content, source = packet.content, packet.source
        if isinstance(content, Hello):
            if self.open.get(frozenset((source, host.name))) == packet.link:
                host.greeted[source] = content.incarnation
                self.apply(host, host.mobility.on_linked(content))
        elif isinstance(content, SendTransfer):
            inject = partial(self.inject, host)
            self.apply(host, host.mobility.on_transfer(source, content.header, content.block, inject))
        else:
            self.apply(host, host.mobility.on_message(source, content, self.now))

    def work(self, host: SimHost, start: Start) -> None:
        host.running[start] += 1
        self.count[start] += 1

    def wander(self, host: SimHost, start: Start, target: str) -> None:
        count = host.frozen[start] = host.running.pop(start)
        agent, generation = start

        def seal(sequence: int) -> bytes:
            return f"{agent} {generation} {sequence} {count}".encode()

        self.apply(host, host.mobility.depart(agent, target, seal, self.now))

    def finish(self, host: SimHost, start: Start, outcome: str) -> None:
        host.drop(start)
        self.finished.add(start)
        self.apply(host, host.mobility.on_ended(*start, outcome))

    def advance(self, seconds: float) -> None:
        self.now += seconds
        for host in list(self.hosts.values()):
            self.apply(host, host.mobility.tick(self.now))

    # Effects

    def inject(self, host: SimHost, header, block: bytes) -> TransferRefusal | None:
        if host.full:
            return TransferRefusal("LimitException", "no memory left")
        agent, generation, sequence, count = bytes(block).decode().split()
        start = agent, int(generation)
        assert start == (header.agent, header.generation)
        assert int(sequence) == header.sequence, "a block must carry its own number"
        self.injected[*start, header.sequence] += 1
        host.drop(start)
        host.running[start] = int(count)
        return None

    def apply(self, host: SimHost, effects) -> None:
        for effect in effects:
            match effect:
                case Send(target, message):
                    if target in host.greeted:
                        self.packets.append(self.packet(host.name, target, message))
                case SendTransfer(target, header, _):
                    alive = self.hosts.get(target)
                    if alive is None or alive.incarnation != header.receiver_memory:
                        self.doubtful.add((header.agent, header.generation))
                    self.packets.append(self.packet(host.name, target, effect))
                case ResumeWithException(agent, generation):
                    host.running[agent, generation] = host.frozen.pop((agent, generation))
                case MarkMigrated(agent, generation) | DropTerminated(agent, generation):
                    host.frozen.pop((agent, generation), None)
                case TerminateCopy(agent, generation):
                    host.drop((agent, generation))
                    if self.outcome(host, agent, generation) == "superseded":
                        self.superseded.add((agent, generation))
                    else:
                        assert (agent, generation) in host.doubted
                        self.dead.add((agent, generation))
                case MarkInDoubt(agent, generation):
                    assert (agent, generation) in host.frozen
                    host.doubted.add((agent, generation))

    def outcome(self, host: SimHost, agent: str, generation: int) -> str:
        known = {(known.agent, known.generation): known for known in host.mobility.known_states()}
        return known[agent, generation].outcome

    def heal(self) -> None:
        """Start all hosts, renew all links, deliver everything, and let enough time pass."""
        for name in self.names:
            if name not in self.hosts:
                self.boot(name)
        for host in self.hosts.values():
            host.full = False
        for _ in range(3):
            for one, other in combinations(self.names, 2):
                self.cut(one, other)
                self.notice(one, other)
                self.notice(other, one)
                self.connect(one, other)
            while self.packets:
                self.deliver(self.packets.pop(0))
            self.advance(TIMEOUT + 1)

    # The judge

    def check(self) -> None:
        live = Counter(start for host in self.hosts.values() for start in host.running)
        for start, copies in live.items():
            assert copies == 1, f"{copies} live copies of {start}"
        for identity, times in self.injected.items():
            assert times == 1, f"{identity} was injected {times} times"
        for host in self.hosts.values():
            for start, count in host.running.items():
                assert count == self.count[start], f"an old copy of {start} runs on {host.name}"
        held = live.keys() | {start for host in self.hosts.values() for start in host.frozen}
        for start in self.count:
            assert start in held or start in self.excused, f"{start} has vanished"
        for agent, generation in self.superseded:
            better = any(a == agent and outranks(g, generation) for a, g in self.count)
            assert better, f"{agent} was stopped without a reason"

    def check_healed(self) -> None:
        """Check the promises after `heal`."""
        self.check()
        live = Counter(start for host in self.hosts.values() for start in host.running)
        for start in self.count:
            assert live[start] or start in self.excused | self.doubtful, f"{start} was not resumed"
        for agent in self.homes:
            starts = [start for start in live if start[0] == agent]
            assert len(starts) <= 1, f"{starts} run side by side"
            if not starts:
                assert any(s[0] == agent for s in self.finished | self.dead | self.doubtful), f"no {agent}"

    @property
    def excused(self) -> set[Start]:
        return self.finished | self.superseded | self.dead

    def packet(self, source: str, target: str, content: object) -> Packet:
        link = self.open.get(frozenset((source, target)), 0)
        # A packet is for the life at the other end of the link; without one it is lost.
        known = self.hosts[source].greeted.get(target)
        if isinstance(content, Hello):
            known = self.hosts[target].incarnation
        return Packet(source, target, known or 0, link, content)

    def hello(self, host: SimHost) -> Hello:
        known = host.mobility.known_states() if host.mobility else []
        return Hello("host", host.name, host.incarnation, PROGRAM, PROGRAM, 1 << 20, known)
