"""One life of a host: the real quorum core, with a small model of mobility and journal.

A coordinator is RUN here, PREPARED to leave, MOVED, or EXITED: it has terminated. A message about a decision
is sent when the earlier records are durable; records that are not durable are lost with the life.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

from quorum_copies import Copy, Ends, Inquire, Transfer, TransferVerdict
from quorum_scenario import LEASE

from lfield.replication.lease.effects import (
    Checkpoint,
    Effect,
    PromoteCheckpoint,
    RaiseFence,
    RecordTermination,
    SendQuorumMessage,
)
from lfield.replication.lease.quorum_members import FencingTokens, QuorumMembers
from lfield.wire.coordinator_messages import (
    CheckpointId,
    LeaseRecord,
    Locate,
    Located,
    Terminated,
    TerminatedAck,
)
from lfield.wire.quorum_messages import Promise, Propose, QuorumMessage

if TYPE_CHECKING:
    from quorum_world import Computer, World

#: The interval between the generations of recoveries.
STRIDE = 65536
#: Ticks in one second above which the core is due without end.
BUSY = 100


class HostLife:
    """One process with its own clock; the judge observes its actions."""

    def __init__(self, world: World, computer: Computer, number: int) -> None:
        self.world, self.computer, self.name = world, computer, computer.name
        self._judge, self._rng = world.judge, random.Random(f"{world.scenario.seed} {number}")
        disk = computer.disk
        self.copies: dict[str, Copy] = {key[1]: page for key, page in disk.items() if key[0] == "copy"}
        self.verdicts = {key[1:]: page for key, page in disk.items() if key[0] == "verdict"}
        fences = {key[1]: page for key, page in disk.items() if key[0] == "fence"}
        others = [name for name in world.hosts if name != self.name]
        members = QuorumMembers(world.scenario.members, self.name, LEASE)
        tokens = FencingTokens({k: v for k, v in fences.items() if k in world.scenario.agents})
        self.core = world.core(members, others, world.scenario.agents, number, self, tokens, self._rng)
        #: Actions that wait for records of each coordinator; None stands for a record that is not durable.
        self._waiting: dict[str, deque[Callable[[], None] | None]] = {
            a: deque() for a in world.scenario.agents
        }
        self._disk_free, self._armed = 0.0, float("inf")
        self._ticks: deque[float] = deque(maxlen=BUSY)
        #: Real times at which the host got the lease, and at which each coordinator arrived.
        self._leased: float | None = None
        self._until = float("-inf")
        self._here: dict[str, float] = {}
        self._asked: dict[str, float] = {}
        self.ends = Ends(self.name, world.scenario.members)

    # --- time -----------------------------------------------------------------------------------------

    @property
    def clock(self) -> float:
        """The time on this host's clock."""
        return self.computer.clock(self.world.now)

    @property
    def is_over(self) -> bool:
        """Whether this life has ended."""
        return self.computer.life is not self

    def join(self) -> None:
        """Join the team after a while."""
        self.later(self._rng.uniform(0.0, 2.0), lambda: self.core.start(self.clock))
        self.later(self._rng.uniform(2.0, 2.5), self._step)

    def later(self, seconds: float, event: Callable[[], None]) -> None:
        """Schedule an event of this life."""
        self.world.at(self.world.now + seconds, lambda: self.enter(event))

    def enter(self, event: Callable[[], None]) -> None:
        """Execute an event unless the life is over; a stopped host executes it when it continues."""
        if self.is_over:
            return
        if self.computer.frozen:
            self.computer.backlog.append(lambda: self.enter(event))
            return
        event()
        self._settle()

    def _settle(self) -> None:
        """After each event: schedule the next tick of the core, and extend the permitted time of actions."""
        self._watch_lease()
        for agent in self.world.scenario.agents:
            if (action := self._judge.action(agent, self.name)) and self._may_act(agent):
                action.until = max(action.until, self.until)
        due = self.core.due
        if due is None:
            return
        at = max(self.world.now, self.computer.real(due)) + 1e-6 + self._rng.uniform(0.0, 0.004)
        if at < self._armed:
            self._armed = at
            self.world.at(at, lambda: self.enter(lambda: self._tick(at)))

    def _watch_lease(self) -> None:
        until = self.core.lease.valid_until
        if until <= self.clock:
            self._leased = None
        elif self._leased is None or self._until < self.clock:
            self._leased = self.world.now
        self._until = until

    def _tick(self, armed: float) -> None:
        if self._armed == armed:
            self._armed = float("inf")
        self._ticks.append(self.world.now)
        if len(self._ticks) == BUSY and self.world.now - self._ticks[0] < 1.0:
            self._judge.breach(f"{self.name} ticks without end")
        self.carry_out(self.core.tick(self.clock))

    # --- the disk -------------------------------------------------------------------------------------

    def write(self, agent: str, pages: dict[tuple, object], then: Callable[[], None] = lambda: None) -> None:
        """Write records of a coordinator, then call `then`."""
        waiting = self._waiting[agent]
        waiting.append(None)
        waiting.append(then)
        self._disk_free = max(self._disk_free, self.world.now) + self.world.commit(self.name)
        self.world.at(self._disk_free, lambda: self._written(agent, pages))

    def _written(self, agent: str, pages: dict[tuple, object]) -> None:
        if not self.is_over:
            self.computer.disk.update(pages)
            for key, page in pages.items():
                if key[0] == "copy" and isinstance(page, Copy) and page.state == "EXITED":
                    self._judge.terminated(agent, page.generation, self.name)
            self.enter(lambda: self._release(agent))

    def _release(self, agent: str) -> None:
        waiting = self._waiting[agent]
        waiting.popleft()
        while waiting and waiting[0] is not None:
            waiting.popleft()()

    def after(self, agent: str, action: Callable[[], None]) -> None:
        """Call `action` when all written records of a coordinator are durable."""
        if self._waiting[agent]:
            self._waiting[agent].append(action)
        else:
            action()

    # --- the core -------------------------------------------------------------------------------------

    def carry_out(self, effects: Iterable[Effect]) -> None:
        """Execute the effects of the core."""
        for effect in effects:
            match effect:
                case RaiseFence():
                    self._bar(effect.agent, effect.generation)
                case SendQuorumMessage():
                    self._send(effect.host, effect.message)
                case PromoteCheckpoint():
                    self._take_over(effect.agent, effect.generation)
                case RecordTermination():
                    self._learn_end(effect.ended)

    def _send(self, host: str, message: QuorumMessage | Locate | Located) -> None:
        for each in message.leases if isinstance(message, Located) else [message]:
            self._send_one(host, each)

    def _send_one(self, host: str, message: object) -> None:
        agent = getattr(message, "agent", None)
        if agent in self._waiting:
            self.after(agent, lambda: self.world.send(self.name, host, message))
        else:
            self.world.send(self.name, host, message)

    def _bar(self, agent: str, generation: int) -> None:
        self._judge.barred(agent, generation, self.name)
        copy = self.copies.get(agent)
        if copy and copy.generation < generation:
            self._judge.stops(agent, self.name)
        self.keep_fence(agent, generation)

    def keep_fence(self, agent: str, generation: int) -> None:
        """Write a fence to the disk."""
        self.write(agent, {("fence", agent): generation})

    def _take_over(self, agent: str, generation: int) -> None:
        knew = {self.name: self.ends.known(agent, self.copies.get(agent))}
        self._judge.recovers(agent, self.copies[agent].generation, generation, knew)
        self._keep(agent, Copy(generation, 0, "RUN"))

    def checkpoint(self, agent: str) -> Checkpoint | None:
        """The newest checkpoint of a coordinator on this host."""
        copy = self.copies.get(agent)
        if copy is None:
            return None
        if copy.state == "EXITED":
            return self.ends.checkpoint(agent, copy)
        place = CheckpointId(copy.generation, copy.sequence, copy.state != "RUN")
        return Checkpoint(place, self.lives(agent), self.world.scenario.interval)

    def allocate_generation(self, agent: str, above: int) -> int:
        """A generation that no other host allocates."""
        copy = self.copies.get(agent)
        newest = max(above, copy.generation if copy else 0)
        return (newest // STRIDE + 1) * STRIDE + self.world.scenario.hosts.index(self.name) + 1

    # --- coordinators ---------------------------------------------------------------------------------

    def start(self, agent: str) -> None:
        """Start a coordinator at its home."""
        self._keep(agent, Copy(1, 0, "RUN"))

    def _keep(self, agent: str, copy: Copy, pages: dict | None = None, then=lambda: None) -> None:
        """Write a copy; it counts as kept when it is durable."""
        self.copies[agent] = copy
        self._here[agent] = self.world.now

        def kept() -> None:
            if self.copies[agent] == copy:
                self.copies[agent] = replace(copy, kept=True)
                if copy.state == "RUN":
                    self._act(agent)
            then()

        self.write(agent, {("copy", agent): replace(copy, kept=True), **(pages or {})}, kept)

    def lives(self, agent: str) -> bool:
        """Whether the coordinator runs here and is not fenced."""
        copy = self.copies.get(agent)
        return copy is not None and copy.state == "RUN" and not self.core.is_fenced(agent, copy.generation)

    def _may_act(self, agent: str) -> bool:
        copy = self.copies.get(agent)
        if copy is None or not copy.kept or not self.lives(agent):
            return False
        return self.core.may_act(agent, copy.generation, self.clock)

    @property
    def until(self) -> float:
        """The real time until which a command of now may move a device."""
        return min(self.computer.real(self.core.lease.valid_until), self.world.now + LEASE)

    def healthy_since(self, agent: str, below: int) -> float | None:
        """The time since which an earlier start has been here under a lease; None if there is none."""
        copy = self.copies.get(agent)
        if copy is None or copy.generation >= below or self._leased is None:
            return None
        if not (self._may_act(agent) or self._has_unsettled_end(agent)):
            return None
        return max(self._leased, self._here.get(agent, 0.0))

    def _has_unsettled_end(self, agent: str) -> bool:
        """Whether the coordinator terminated here, and the lease of this host prevents a recovery."""
        saved = self.checkpoint(agent)
        if saved is None or saved.is_final or self.core.is_fenced(agent, saved.position.generation):
            return False
        return self.core.lease.holds(self.clock)

    def _step(self) -> None:
        self.later(self._rng.uniform(0.05, 0.6), self._step)
        for agent in self.world.scenario.agents:
            copy = self.copies.get(agent)
            if copy is None or not copy.kept or self._judge.action(agent, self.name):
                continue
            if copy.state == "PREPARED" and self.clock >= self._asked.get(agent, 0.0) + 1.0:
                self._ask(agent, copy)
            elif copy.state == "EXITED" and copy.to == self.name:
                self._send_termination(agent, copy)
            elif self.lives(agent):
                self._work(agent, copy)

    def _work(self, agent: str, copy: Copy) -> None:
        others = [name for name in self.world.hosts if name != self.name]
        ends = self.world.scenario.ends
        if ends and self._may_act(agent) and self._rng.random() < ends:
            self._keep(agent, Copy(copy.generation, copy.sequence, "EXITED", self.name))
        elif others and self._rng.random() < 0.3:
            self._leave(agent, copy, self._rng.choice(others))
        else:
            self._act(agent)

    def _act(self, agent: str) -> None:
        copy = self.copies[agent]
        if self._may_act(agent):
            end = self.world.now + self._rng.choice([0.1, 1.0, 5.0])
            token = copy.generation, copy.sequence
            self._judge.on_action_started(agent, self.name, token, end, self.until)
        else:
            self.core.request_lease(self.clock)

    def _leave(self, agent: str, copy: Copy, to: str) -> None:
        transfer = Transfer(agent, copy.generation, copy.sequence + 1)
        self._judge.counts["hops"] += 1
        self._asked[agent] = self.clock
        sent_copy = Copy(transfer.generation, transfer.sequence, "PREPARED", to)
        self._keep(agent, sent_copy, then=lambda: self.world.send(self.name, to, transfer))

    def _ask(self, agent: str, copy: Copy) -> None:
        self._asked[agent] = self.clock
        self.world.send(self.name, copy.to, Inquire(agent, copy.generation, copy.sequence))

    def _send_termination(self, agent: str, copy: Copy) -> None:
        """Repeat a termination to every host that has not confirmed it."""
        for host in self.world.hosts.keys() - self.ends.confirmed_by(agent) - {self.name}:
            self.world.send(self.name, host, copy.ended(agent))

    def _learn_end(self, ended: Terminated) -> None:
        """Write a termination elsewhere to the disk, then confirm it."""
        copy = self.copies.get(ended.agent)
        if copy is None or copy.generation < ended.generation or copy.state in ("PREPARED", "MOVED"):
            if copy is None or copy.generation <= ended.generation:
                self._keep(ended.agent, Copy(ended.generation, 0, "EXITED", ended.host))
        elif copy.state == "RUN" and copy.generation == ended.generation:
            return
        answer = TerminatedAck(ended.agent, ended.generation)
        self.after(ended.agent, lambda: self.world.send(self.name, ended.host, answer))

    def on_message(self, sender: str, message: object) -> None:
        """Handle a message."""
        self.ends.note(message)
        match message:
            case Transfer() | Inquire():
                self._decide(sender, message)
            case TransferVerdict():
                self._learn(message)
            case Terminated():
                if not self.core.is_delayed(message, self.clock):
                    self._learn_end(message)
            case TerminatedAck():
                copy = self.copies.get(message.agent)
                if copy and copy.state == "EXITED" and copy.generation == message.generation:
                    self.ends.confirmed_by(message.agent).add(sender)
            case Propose():
                self._promise(sender, message)
            case Locate():
                for record in self.core.lease_records(message.agents, self.clock):
                    self._send_one(sender, record)
            case LeaseRecord():
                self.carry_out(self.core.on_located(sender, message, self.clock))
            case _:
                self.carry_out(self.core.on_message(sender, message, self.clock))

    def _promise(self, sender: str, message: Propose) -> None:
        """Promise a recovery; the judge records the termination that this member knew before."""
        knew = self.ends.known(message.agent, self.copies.get(message.agent))
        effects = self.core.on_message(sender, message, self.clock)
        sent_messages = [effect.message for effect in effects if isinstance(effect, SendQuorumMessage)]
        promises = [m for m in sent_messages if isinstance(m, Promise) and m.ended is None]
        if any(promise.fence == message.generation for promise in promises):
            self._judge.promises(message.agent, message.generation, self.name, knew)
        self.carry_out(effects)

    def _decide(self, sender: str, asked: Transfer | Inquire) -> None:
        """Decide on a transfer: an old number gets its old verdict, a fenced start is refused."""
        agent, generation, sequence = asked
        sequence_seen, accepted = self.verdicts.get((agent, generation), (-1, False))
        if sequence > sequence_seen:
            sequence_seen, accepted = (
                sequence,
                isinstance(asked, Transfer) and self._accepts(agent, generation),
            )
            self.verdicts[agent, generation] = sequence_seen, accepted
            page = {("verdict", agent, generation): (sequence_seen, accepted)}
            if accepted:
                self._keep(agent, Copy(generation, sequence, "RUN"), page)
            else:
                self.write(agent, page)
        answer = TransferVerdict(agent, generation, sequence, accepted or sequence < sequence_seen)
        self.after(agent, lambda: self.world.send(self.name, sender, answer))

    def _accepts(self, agent: str, generation: int) -> bool:
        copy = self.copies.get(agent)
        if self.core.is_fenced(agent, generation):
            return False
        if copy is not None and copy.state == "EXITED":
            return copy.generation < generation
        return copy is None or copy.generation <= generation

    def _learn(self, verdict: TransferVerdict) -> None:
        copy = self.copies.get(verdict.agent)
        identity = verdict.generation, verdict.sequence
        if copy and copy.state == "PREPARED" and (copy.generation, copy.sequence) == identity:
            state = "MOVED" if verdict.accepted else "RUN"
            self.copies[verdict.agent] = replace(copy, state=state, kept=True)
            self._here[verdict.agent] = self.world.now
            if verdict.accepted:
                self.write(verdict.agent, {("copy", verdict.agent): self.copies[verdict.agent]})
