"""The simulated hosts with disks: hosts crash at any moment, lose what is not durable, and continue.

Work since the last save may be lost with a host; the coordinator continues from the copy on disk.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from mobility_world import PROGRAM, Packet, SimHost, Start, World

from lfield.host.migration.write_ahead import WriteAheadQueue
from lfield.journal.records import CoordinatorRecord, Record, RecordKey, key_of
from lfield.replication.transfer.coordinator_copies import CoordinatorCopy
from lfield.replication.transfer.effects import (
    CoordinatorStarted,
    ResumeCopy,
    ResumeWithException,
    SendTransfer,
    TransferRefusal,
)
from lfield.replication.transfer.generations import is_recovery, next_recovery
from lfield.wire.messages import Hello


@dataclass
class JournaledHost(SimHost):
    """One life of a host with a journal; `waiting` has arrived and saved coordinators."""

    keeping: WriteAheadQueue = field(default_factory=WriteAheadQueue)
    waiting: dict[Start, int] = field(default_factory=dict)

    def drop(self, start: Start) -> None:
        super().drop(start)
        self.waiting.pop(start, None)


class JournaledWorld(World):
    """Hosts with disks; a crash loses all that was not synchronised."""

    def __init__(self, *args) -> None:
        self.disks: dict[str, dict[RecordKey, Record]] = {}
        self.gone: set[str] = set()
        super().__init__(*args)

    def boot(self, name: str) -> None:
        self.lives += 1
        host = JournaledHost(name, self.lives)
        first = name not in self.disks
        disk = self.disks.setdefault(name, {})
        self.enter(host)
        host.mobility.restore(page for page in disk.values() if isinstance(page, CoordinatorRecord))
        self.apply(
            host, host.mobility.resume_restored(lambda copy, runs: self.put(host, copy, runs), self.now)
        )
        for agent, home in self.homes.items():
            if home == name and first:
                self.apply(host, host.mobility.start(agent, 1))
                self.sync(name)

    def come_back(self, name: str) -> None:
        """Start a host that was declared lost; it receives the states of all others first."""
        self.lives += 1
        host = JournaledHost(name, self.lives)
        self.enter(host)
        host.mobility.restore(
            page for page in self.disks[name].values() if isinstance(page, CoordinatorRecord)
        )
        for other in [other for other in self.hosts.values() if other is not host]:
            self.apply(host, host.mobility.on_linked(self.hello(other)))
            host.mobility.on_unlinked(other.name)
        # If it is killed before that is durable, it has to receive it again.
        self.sync(name)
        self.apply(
            host, host.mobility.resume_restored(lambda copy, runs: self.put(host, copy, runs), self.now)
        )
        self.gone.discard(name)

    def put(self, host: JournaledHost, copy: CoordinatorCopy, runs: bool):
        """Put a copy from the disk into the machine."""
        start = copy.agent, copy.generation
        count = int(bytes(copy.block).decode().split()[3]) if copy.block else 0
        (host.running if runs else host.frozen)[start] = self.count[start] = count
        return self.block_maker(start, count)

    def block_maker(self, start: Start, count: int):
        return lambda sequence: f"{start[0]} {start[1]} {sequence} {count}".encode()

    def kill(self, name: str) -> None:
        del self.hosts[name]
        for pair in [pair for pair in self.open if name in pair]:
            del self.open[pair]

    def sync(self, name: str) -> None:
        """Make all records of a host durable."""
        host = self.hosts[name]
        while batch := host.keeping.next_batch(self.now + 60.0):
            number, pages, _ = batch
            self.disks[name].update((key_of(page), page) for page in pages)
            self.carry_out(host, host.keeping.on_durable(number))

    def save(self, host: JournaledHost, start: Start) -> None:
        """A coordinator calls a portal of its host: it is saved first."""
        host.waiting[start] = host.running.pop(start)
        block = self.block_maker(start, host.waiting[start])(0)
        self.apply(host, host.mobility.save(start[0], block))

    def inject(self, host: JournaledHost, header, block: bytes) -> TransferRefusal | None:
        refusal = super().inject(host, header, block)
        start = header.agent, header.generation
        if refusal is None:
            host.waiting[start] = host.running.pop(start)
        return refusal

    def apply(self, host: JournaledHost, effects) -> None:
        self.carry_out(host, host.keeping.put(effects, self.now))

    def carry_out(self, host: JournaledHost, effects) -> None:
        for effect in effects:
            match effect:
                case ResumeCopy(agent, generation):
                    if (agent, generation) in host.waiting:
                        host.running[agent, generation] = host.waiting.pop((agent, generation))
                case CoordinatorStarted(agent, generation):
                    host.running[agent, generation] = self.count[agent, generation] = 0
                case ResumeWithException(agent, generation) if (
                    is_recovery(generation) and (agent, generation) not in self.count
                ):
                    self.count[agent, generation] = host.frozen[agent, generation]
                    self.dead |= {
                        start for start in self.count if start[0] == agent and start[1] < generation
                    }
                    super().apply(host, [effect])
                case _:
                    super().apply(host, [effect])

    def recoverable(self, host: JournaledHost, agent: str) -> bool:
        """Whether this host could recover an agent of whose newest start it has a shadow."""
        left, newest = host.mobility.recoverable_state(agent), max(g for a, g in self.count if a == agent)
        return left is not None and left.generation == newest and left.state in ("MOVED", "IN DOUBT")

    def declare_newer_lost(self, host: JournaledHost, agent: str) -> bool:
        """Declare all hosts with newer copies of an agent lost; returns whether they are."""
        left = host.mobility.recoverable_state(agent)
        here = left.generation, left.sequence
        for name in self.names:
            if name != host.name and name not in self.gone and self._has_more(name, agent, here):
                self.gone.add(name)
                if name in self.hosts:
                    self.kill(name)
        return not any(self._under_way(packet, agent) for packet in self.packets)

    def _has_more(self, name: str, agent: str, here: tuple[int, int]) -> bool:
        if name not in self.hosts:
            pages = [
                page
                for page in self.disks[name].values()
                if isinstance(page, CoordinatorRecord) and page.agent == agent
            ]
            return any(page.state == "RUN" or (page.generation, page.sequence) > here for page in pages)
        known = [known for known in self.hosts[name].mobility.known_states() if known.agent == agent]
        live = any(known.state in ("RUN", "FROZEN", "PREPARED") for known in known)
        return live or any((known.generation, known.sequence) > here for known in known)

    def _under_way(self, packet: Packet, agent: str) -> bool:
        target, sent = self.hosts.get(packet.target), packet.content
        return (
            isinstance(sent, SendTransfer)
            and sent.header.agent == agent
            and target is not None
            and target.incarnation == packet.incarnation
            and not any(
                (known.agent, known.generation) == (agent, sent.header.generation)
                and known.sequence >= sent.header.sequence
                for known in target.mobility.known_states()
            )
        )

    def recover(self, host: JournaledHost, agent: str) -> None:
        newest = max(known.generation for known in host.mobility.known_states() if known.agent == agent)
        number = next_recovery(newest, self.names.index(host.name))

        def put(copy: CoordinatorCopy):
            start = copy.agent, copy.generation
            host.frozen[start] = int(bytes(copy.block).decode().split()[3]) if copy.block else 0
            return self.block_maker(start, host.frozen[start])

        self.apply(host, host.mobility.recover(agent, number, put))

    def heal(self) -> None:
        for name in self.names:
            if name not in self.hosts and name not in self.gone:
                self.boot(name)
        for name in sorted(self.gone):
            self.come_back(name)
        for _ in range(4):
            super().heal()
            for name in self.names:
                self.sync(name)
            while self.packets:
                self.deliver(self.packets.pop(0))
                for name in self.names:
                    self.sync(name)

    def check(self) -> None:
        live = Counter(start for host in self.hosts.values() for start in host.running)
        for start, copies in live.items():
            assert copies == 1, f"{copies} live copies of {start}"
        for agent in self.homes:
            starts = [start for start in live if start[0] == agent]
            assert len(starts) <= 1, f"{starts} run side by side"
        for identity, times in self.injected.items():
            assert times == 1 or self.forgotten(identity), f"{identity} was injected {times} times"
        for start in self.count:
            records = [disk.get(RecordKey("copy", *start)) for disk in self.disks.values()]
            alive = any(page is not None and page.state in ("RUN", "PREPARED") for page in records)
            assert alive or start in self.excused, f"{start} is on no disk"

    def forgotten(self, identity: tuple[str, int, int]) -> bool:
        """True if an accepted copy was not saved: its host crashed before the save and the answer."""
        agent, generation, sequence = identity
        pages = (disk.get(RecordKey("copy", agent, generation)) for disk in self.disks.values())
        return not any(page is not None and page.sequence > sequence for page in pages)

    def hello(self, host: SimHost) -> Hello:
        known = host.mobility.known_states() if host.mobility else []
        memory = 1 + self.names.index(host.name)
        return Hello("host", host.name, host.incarnation, PROGRAM, PROGRAM, 1 << 20, known, journal_id=memory)
