"""The rules of leases and fences, removed one by one: the judge must find each."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from msgspec import structs
from quorum_copies import Copy, Ends
from quorum_host import HostLife

from lfield.replication.lease.core import Quorum
from lfield.replication.lease.effects import Effect, SendQuorumMessage
from lfield.replication.lease.failover import Failover, FailoverAttempt
from lfield.replication.lease.lease import Lease
from lfield.replication.lease.quorum_members import QuorumMembers
from lfield.replication.lease.termination_log import TerminationLog
from lfield.wire.coordinator_messages import LeaseRecord
from lfield.wire.quorum_messages import Heartbeat, HeartbeatAck, Propose

Patch = pytest.MonkeyPatch


def resumes_after_sending(patch: Patch) -> None:
    """A sender that gets no answer resumes the coordinator that it has sent."""

    def ask(self: HostLife, agent: str, copy: Copy) -> None:
        self.copies[agent] = replace(copy, state="RUN")

    patch.setattr(HostLife, "_ask", ask)


def acknowledges_without_the_fence(patch: Patch) -> None:
    """The acknowledgement of a heartbeat does not carry the fence."""
    heartbeat = Quorum._on_heartbeat

    def bare(self: Quorum, host: str, message: Heartbeat, now: float) -> list[Effect]:
        heartbeat(self, host, message, now)
        return [SendQuorumMessage(host, HeartbeatAck(message.incarnation, message.number, []))]

    patch.setattr(Quorum, "_on_heartbeat", bare)


def does_not_wait(patch: Patch) -> None:
    """A failover does not wait until the lease of the old holder has expired."""
    patch.setattr(QuorumMembers, "grace_period", 0.0)


def waits_less_than_a_lease(patch: Patch) -> None:
    """A failover waits 0.7 of a lease."""
    patch.setattr(QuorumMembers, "grace_period", property(lambda self: 0.7 * self.lease))


def has_no_fence_on_disk(patch: Patch) -> None:
    """A host that restarts has lost its fences."""
    patch.setattr(HostLife, "keep_fence", lambda self, agent, generation: None)


def continues_with_a_minority_of_promises(patch: Patch) -> None:
    """A failover continues with the promises of a minority."""
    propose = Failover._send_proposals

    def hasty(self: Failover, agent: str, attempt: FailoverAttempt, now: float) -> list[Effect]:
        effects = propose(self, agent, attempt, now)
        attempt.phase, attempt.due = "waiting", now + self._members.grace_period
        return effects

    patch.setattr(Failover, "_send_proposals", hasty)
    patch.setattr(Failover, "_has_enough_answers", lambda self, attempt, now: now >= attempt.answer_deadline)


def runs_without_a_lease(patch: Patch) -> None:
    """A coordinator runs although its lease has expired."""
    patch.setattr(Lease, "holds", lambda self, now: True)
    patch.setattr(HostLife, "until", math.inf)


def sends_fences_once(patch: Patch) -> None:
    """A fence is sent once and is lost with its message."""
    heartbeat = Quorum._on_heartbeat

    def once(self: Quorum, host: str, message: Heartbeat, now: float) -> list[Effect]:
        sent = self.__dict__.setdefault("sent", {}).setdefault((host, message.incarnation), set())
        heartbeat(self, host, message, now)
        unsent = [fence for fence in self.fences.all if fence not in sent]
        sent.update(unsent)
        return [SendQuorumMessage(host, HeartbeatAck(message.incarnation, message.number, unsent))]

    patch.setattr(Quorum, "_on_heartbeat", once)


def does_not_query_first(patch: Patch) -> None:
    """A failover does not wait for the answers about the last record."""
    patch.setattr(Failover, "_has_enough_answers", lambda self, attempt, now: True)


def promises_despite_a_known_termination(patch: Patch) -> None:
    """A host that knows a termination promises a recovery."""
    on_propose, sought = Quorum._on_propose, Quorum._locate

    def promises(self: Quorum, host: str, message: Propose, now: float) -> list[Effect]:
        return on_propose(self, host, structs.replace(message, start=2**62), now)

    def silent(self: Quorum, agent: str, now: float) -> LeaseRecord:
        return structs.replace(sought(self, agent, now), ended=None)

    patch.setattr(Quorum, "_on_propose", promises)
    patch.setattr(Quorum, "_locate", silent)
    patch.setattr(TerminationLog, "all", property(lambda self: []))


def does_not_record_a_termination(patch: Patch) -> None:
    """A host does not record a termination."""
    patch.setattr(Ends, "checkpoint", lambda self, agent, copy: None)
