"""Majority leases, fencing and failover of one host: events in, effects out. Sans-IO.

Two copies of a coordinator never act at once: a majority that granted a lease and a majority that promised a
failover share a member. If this member acknowledged a heartbeat after its promise, the answer carried the
fence. If it did so before, the heartbeat predates the promise, and the member's part of the lease expires one
lease later. The new holder waits longer than this. See decision 45.
"""

from __future__ import annotations

import random
from collections.abc import Collection

from lfield.replication.lease.effects import (
    CheckpointStore,
    Effect,
    RaiseFence,
    RecordTermination,
    SendQuorumMessage,
)
from lfield.replication.lease.failover import Failover
from lfield.replication.lease.lease import Lease
from lfield.replication.lease.quorum_members import FencingTokens, QuorumMembers
from lfield.replication.lease.termination_log import TerminationLog
from lfield.wire.coordinator_messages import TERMINAL, CheckpointId, LeaseRecord, Located, Terminated
from lfield.wire.fields import bounded_duration
from lfield.wire.quorum_messages import (
    MAX_RECORDS,
    Heartbeat,
    HeartbeatAck,
    HeldRecord,
    Promise,
    Propose,
    QuorumMessage,
)


class Quorum:
    """The leases and fences of one host in this `incarnation`.

    `hosts` are the other hosts of the team, `agents` the coordinators under leases, `fences` their tokens
    from the journal. A host that does not know its promises (`members`) has lost them with its journal. Times
    are in seconds on the host's clock.
    """

    def __init__(
        self,
        members: QuorumMembers,
        hosts: Collection[str],
        agents: Collection[str],
        incarnation: int,
        copies: CheckpointStore,
        fences: FencingTokens,
        rng: random.Random,
    ) -> None:
        self.members, self._agents, self._incarnation, self._copies = (
            members,
            frozenset(agents),
            incarnation,
            copies,
        )
        self.fences = fences
        self.lease = Lease(members)
        self.terminations = TerminationLog(members, self._agents, copies, self.fences)
        self._failover = Failover(
            members, sorted(hosts), sorted(agents), copies, self.fences, rng, self.terminations
        )
        #: The last known or promised holder of each agent: host, generation and time.
        self._holders: dict[str, tuple[str, int, float]] = {}
        self._next_heartbeat: float | None = None
        #: Members whose fences must arrive before this host grants a lease or a promise.
        self._unreachable = set() if members.knows_promises else set(members.others)
        self._needed_members = False
        self._confirm_promises()

    # --- time -----------------------------------------------------------------------------------------

    def start(self, now: float, *, first: bool = False) -> None:
        """Take part from now on; before this call, the host only answers.

        `first`: the operator asserts that this host never made a promise.
        """
        self._next_heartbeat = now
        if first:
            self._unreachable.clear()
            self._confirm_promises()

    @property
    def knows_promises(self) -> bool:
        """Whether this host knows all promises that it may have made."""
        return self.members.knows_promises

    @property
    def unreachable_members(self) -> list[str]:
        """Members whose fences must arrive before this host's vote counts."""
        return sorted(self._unreachable)

    def _confirm_promises(self) -> None:
        """Record that this host knows its own promises, when the fences of all other members are known."""
        self.members.confirm_promises(known=not self._unreachable)

    @property
    def due(self) -> float | None:
        """The time when `tick` is due; None before `start`."""
        if self._next_heartbeat is None:
            return None
        other = self._failover.due
        return self._next_heartbeat if other is None else min(self._next_heartbeat, other)

    @property
    def needed_hosts(self) -> set[str]:
        """The hosts to which links are needed now."""
        return {*self.members.others, *self._failover.queried_hosts}

    def tick(self, now: float) -> list[Effect]:
        """Process the time-outs that are due."""
        if self._next_heartbeat is None:
            return []
        self._detect_stall(now)
        effects = (
            [*self.terminations.tick(now), *self._send_heartbeats(now)] if now >= self._next_heartbeat else []
        )
        return effects + self._failover.tick(now)

    def request_lease(self, now: float) -> None:
        """Request the lease for a waiting coordinator, unless it was requested just before.

        At a home that is no member, the coordinator may not have started yet; requests repeat until the lease
        is held.
        """
        self._needed_members = not self.lease.holds(now)
        is_requested = self.lease.holds(now) or self.lease.is_requested_since(
            now - self.members.heartbeat_interval
        )
        if self._next_heartbeat is not None and not is_requested:
            self._next_heartbeat = min(self._next_heartbeat, now)

    def _detect_stall(self, now: float) -> None:
        """Detect a stall of this host: a host that was stalled suspects itself before it suspects others."""
        if self._next_heartbeat is not None and now > self._next_heartbeat + self.members.heartbeat_interval:
            self._failover.on_stall(now)

    def _send_heartbeats(self, now: float) -> list[Effect]:
        self._next_heartbeat = now + self.members.heartbeat_interval
        held = self._live_coordinators()
        self._needed_members = self._needed_members and not self.lease.holds(now)
        if not (held or self._needed_members or self._is_member):
            return []
        # A host without a lease cannot act, even if it is reachable: other hosts may have to take over.
        leased = held if self.lease.holds(now) else []
        beat = Heartbeat(self._incarnation, self.lease.next_heartbeat(now), self.terminations.digest, leased)
        return [SendQuorumMessage(host, beat) for host in self.members.others]

    @property
    def _is_member(self) -> bool:
        return self.members.own_name in self.members.names

    def _live_coordinators(self) -> list[HeldRecord]:
        found = ((agent, self._live_checkpoint(agent)) for agent in sorted(self._agents))
        held = [
            HeldRecord(agent, place.generation, place.sequence) for agent, place in found if place is not None
        ]
        return held[:MAX_RECORDS]

    def _live_checkpoint(self, agent: str) -> CheckpointId | None:
        """The progress of an agent that is here and not fenced.

        A terminated agent counts until the termination is final, so that no host recovers it before.
        """
        saved = self._copies.checkpoint(agent)
        if saved is None or self.is_fenced(agent, saved.position.generation):
            return None
        return saved.position if saved.is_alive or not saved.is_final else None

    # --- permissions of coordinators ------------------------------------------------------------------

    def is_fenced(self, agent: str, generation: int) -> bool:
        """Whether this start is fenced, on any host."""
        return self.fences.rejects(agent, generation)

    def may_act(self, agent: str, generation: int, now: float) -> bool:
        """Whether a coordinator on this host may start a portal call now."""
        return self.lease.holds(now) and not self.is_fenced(agent, generation)

    # --- messages -------------------------------------------------------------------------------------

    def on_message(self, host: str, message: QuorumMessage, now: float) -> list[Effect]:
        """Process a query, an answer or a heartbeat of a host."""
        self._detect_stall(now)
        match message:
            case Heartbeat():
                return self._on_heartbeat(host, message, now)
            case HeartbeatAck():
                return self._on_ack(host, message, now)
            case Propose():
                return self._on_propose(host, message, now)
            case Promise():
                return self._on_promise(host, message, now)

    def lease_records(self, agents: Collection[str], now: float) -> list[LeaseRecord]:
        """The answer to a host that asks for these coordinators, with no `agents` for all."""
        self._detect_stall(now)
        return [self._locate(agent, now) for agent in agents or sorted(self._agents)]

    def on_located(self, host: str, record: LeaseRecord, now: float) -> list[Effect]:
        """Process a host's record of an agent."""
        self._detect_stall(now)
        ends = self._on_termination(host, record.agent, record.ended, now)
        return [*ends, *self._failover.on_located(host, record, now)]

    def _on_heartbeat(self, host: str, message: Heartbeat, now: float) -> list[Effect]:
        for held in message.held:
            self._note_holder(host, held.agent, held.generation, now)
        known = message.fences == self.terminations.digest
        fences, ended = ([], []) if known else (self.fences.all, self.terminations.all)
        # Number 0 is no heartbeat: the message carries fences and grants no lease.
        number = message.number if self.knows_promises else 0
        # An incomplete set of fences would be useless: no lease is granted then.
        is_complete = len(fences) <= MAX_RECORDS and len(ended) <= MAX_RECORDS
        return (
            [SendQuorumMessage(host, HeartbeatAck(message.incarnation, number, fences, ended))]
            if is_complete
            else []
        )

    def _note_holder(self, host: str, agent: str, generation: int, now: float) -> None:
        """Record that a host holds an agent, or is about to hold it."""
        if agent in self._agents and not self.is_fenced(agent, generation):
            self._holders[agent] = host, generation, now
            self._failover.on_holder(agent, generation, now)

    def _on_ack(self, host: str, message: HeartbeatAck, now: float) -> list[Effect]:
        """Process an acknowledgement, which the lease counts only together with its fences."""
        if message.incarnation != self._incarnation:
            return []
        effects: list[Effect] = []
        for ended in message.ended:
            effects += self._on_termination(host, ended.agent, ended, now)
        for fence in message.fences:
            effects += self._raise_fence(fence.agent, fence.generation, f"{host} reported it")
        self._unreachable.discard(host)
        self._confirm_promises()
        self.lease.on_ack(host, message.number)
        return effects

    def _on_propose(self, host: str, message: Propose, now: float) -> list[Effect]:
        agent, generation = message.agent, message.generation
        if agent not in self._agents or not self.knows_promises:
            return []
        if self._live_checkpoint(agent) and self.lease.holds(now):
            # The query predates the arrival of the coordinator.
            return [_correction(host, self._locate(agent, now))]
        if ended := self.terminations.covering_termination(agent, message.start):
            return [SendQuorumMessage(host, self.terminations.refusing_promise(ended, generation))]
        risen = self._raise_fence(agent, generation, f"{host} is about to resume it")
        if generation == self.fences.token_of(agent):
            self.terminations.on_promise_given(agent, generation, host, now)
        self._note_holder(host, agent, generation, now)
        saved = self._copies.checkpoint(agent)
        place = saved.position if saved is not None and saved.ended is None else None
        return [
            *risen,
            SendQuorumMessage(host, Promise(agent, generation, self.fences.token_of(agent), place)),
        ]

    def _on_promise(self, host: str, message: Promise, now: float) -> list[Effect]:
        risen = self._raise_fence(message.agent, message.fence, f"{host} promised its recovery")
        ends = self._on_termination(host, message.agent, message.ended, now)
        if message.ended is not None:
            # The promise made here waits until no recovery can start with it.
            known = self.terminations.covering_termination(message.agent, message.ended.generation)
            ended = known or message.ended
            claimed = self._failover.claimed_generation(message.agent)
            answer = [] if claimed else [_correction(host, LeaseRecord(message.agent, None, ended=ended))]
            return [*risen, *ends, *answer]
        return [*risen, *self._failover.on_promise(host, message, now)]

    def _on_termination(self, host: str, agent: str, ended: Terminated | None, now: float) -> list[Effect]:
        """A host reports the termination of a coordinator."""
        if ended is None or ended.agent != agent or agent not in self._agents:
            return []
        if ended.outcome not in TERMINAL:
            return []
        effects = self.terminations.on_acknowledged(host, ended)
        if self.terminations.covering_termination(agent, ended.generation):
            return effects
        effects += self._failover.on_termination(ended, now)
        if self._is_member and self.terminations.is_delayed(ended, now):
            return [*effects, *self.terminations.tick(now)]
        saved = self._copies.checkpoint(agent)
        if saved is None or saved.position.generation <= ended.generation:
            effects.append(RecordTermination(ended))
        return effects

    def is_delayed(self, ended: Terminated, now: float) -> bool:
        """Whether a remote termination must neither be stored nor confirmed yet."""
        if not self._is_member or not self.terminations.is_delayed(ended, now):
            return False
        self._next_heartbeat = None if self._next_heartbeat is None else min(self._next_heartbeat, now)
        return True

    def _raise_fence(self, agent: str, generation: int, reason: str) -> list[Effect]:
        if agent not in self._agents or not self.fences.advance(agent, generation):
            return []
        return [RaiseFence(agent, generation, reason)]

    def _locate(self, agent: str, now: float) -> LeaseRecord:
        """This host's record of an agent."""
        if agent not in self._agents:
            return LeaseRecord(agent, None)
        saved, ended = self._copies.checkpoint(agent), self.terminations.termination_of(agent)
        place = saved.position if saved is not None and saved.ended is None else None
        if alive := self._live_checkpoint(agent):
            return LeaseRecord(agent, place, self.members.own_name, alive.generation, ended=ended)
        if claimed := self._failover.claimed_generation(agent):
            return LeaseRecord(agent, place, self.members.own_name, claimed, ended=ended)
        host, generation, last_contact = self._holders.get(agent, ("", 0, now))
        return LeaseRecord(agent, place, host, generation, bounded_duration(now - last_contact), ended)


def _correction(host: str, record: LeaseRecord) -> SendQuorumMessage:
    """An answer without a query, for a proposer that does not know this record."""
    return SendQuorumMessage(host, Located([record.agent], [], [record]))
