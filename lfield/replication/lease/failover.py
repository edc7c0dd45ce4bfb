"""Failover (thesis, appendix I, with fencing): resumes a coordinator whose holder is unreachable. Sans-IO.

A host with a shadow that has no evidence of a holder for the shadow's interval queries every host. When a
majority has answered, and no host knows a holder or a newer shadow, it collects promises of a majority that
fence all earlier starts, waits until every earlier lease has expired, and resumes the coordinator. Most
suspicions concern slow hosts and end with the query. The suspicions of a host that is itself disconnected
also end with the query, so it raises no fence.
"""

from __future__ import annotations

import random
from collections.abc import Collection
from typing import Literal

from msgspec import Struct, field

from lfield.replication.lease.effects import (
    Checkpoint,
    CheckpointStore,
    Effect,
    LogExplanation,
    PromoteCheckpoint,
    RaiseFence,
    SendQuorumMessage,
)
from lfield.replication.lease.quorum_members import FencingTokens, QuorumMembers
from lfield.replication.lease.termination_log import PROMISE_LIFETIME, TerminationLog
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.wire.coordinator_messages import CheckpointId, LeaseRecord, Locate, Terminated
from lfield.wire.quorum_messages import Promise, Propose

#: An attempt without a majority of promises is abandoned after this many leases, and repeated later.
PHASE_TIMEOUT = 2.0


class FailoverAttempt(Struct):
    """An attempt to resume an agent from `checkpoint`, with its next step at `due` and its end at `deadline`.

    The attempt does not wait for answers after `answer_deadline`. The new start begins before
    `promises_valid_until` or not at all: until that time, members that promised do not store terminations of
    earlier starts.
    """

    checkpoint: CheckpointId
    phase: Literal["asking", "proposing", "waiting"]
    due: float
    answer_deadline: float
    deadline: float
    generation: int = 0
    promises_valid_until: float = 0.0
    answered: set[str] = field(default_factory=set)
    promised: set[str] = field(default_factory=set)


class Failover:
    """The suspicions and failover attempts of one host. `hosts` are the other hosts, `agents` the
    coordinators.
    """

    def __init__(
        self,
        members: QuorumMembers,
        hosts: Collection[str],
        agents: Collection[str],
        copies: CheckpointStore,
        fences: FencingTokens,
        rng: random.Random,
        terminations: TerminationLog,
    ) -> None:
        self._terminations = terminations
        self._members, self._hosts, self._copies, self._fences = members, hosts, copies, fences
        self._agents, self._rng = agents, rng
        self._attempts: dict[str, FailoverAttempt] = {}
        #: The time when a holder was last known, or when the coordinator was here.
        self._last_contact: dict[str, float] = {}
        #: The time before which there is no new suspicion, because the last attempt has just failed.
        self._back_off_until: dict[str, float] = {}
        #: The time when each agent becomes suspected without news of a holder.
        self._suspected: dict[str, float] = {}
        #: The last log line of each agent since its holder was last known, and its time.
        self._explained: dict[str, dict[str, float]] = {agent: {} for agent in agents}
        #: The random addition to each interval.
        self._delays = {agent: self._delay() for agent in agents}

    def _delay(self) -> float:
        """A random delay, so that shadows with equal intervals do not start failover at once."""
        return self._rng.uniform(0.0, self._members.heartbeat_interval / 2.0)

    @property
    def queried_hosts(self) -> Collection[str]:
        """The hosts that are being queried."""
        return self._hosts if any(a.phase == "asking" for a in self._attempts.values()) else ()

    @property
    def due(self) -> float | None:
        """The time when `tick` is next due, as far as known."""
        dues = [attempt.due for attempt in self._attempts.values()]
        suspected = [at for agent, at in self._suspected.items() if agent not in self._attempts]
        return min([*dues, *suspected], default=None)

    def claimed_generation(self, agent: str) -> int:
        """The generation as which this host is about to resume an agent; 0 for none."""
        attempt = self._attempts.get(agent)
        if attempt is None or attempt.generation != self._fences.token_of(agent):
            return 0
        return attempt.generation

    def on_holder(self, agent: str, generation: int, at: float) -> None:
        """Record that a host held a runnable start at the time `at`, or was about to resume the agent."""
        if agent in self._agents and not self._fences.rejects(agent, generation):
            self._last_contact[agent] = max(at, self._last_contact.get(agent, at))
            self._back_off_until.pop(agent, None)
            self._explained[agent] = {
                text: when for text, when in self._explained[agent].items() if when >= at
            }

    def on_stall(self, now: float) -> None:
        """Record a stall of this host: messages that are missing from this period are no evidence."""
        for agent in self._agents:
            attempt = self._attempts.get(agent)
            if attempt is None or attempt.phase != "waiting":
                self._defer_to_better(agent, now)

    def tick(self, now: float) -> list[Effect]:
        """Process the time-outs that are due."""
        return [effect for agent in self._agents for effect in self._check(agent, now)]

    def _is_alive(self, agent: str, saved: Checkpoint) -> bool:
        return saved.is_alive and not self._fences.rejects(agent, saved.position.generation)

    def _clear_suspicion(self, agent: str, now: float) -> None:
        """Forget the suspicion about an agent that is here: its silence counts from now."""
        self._last_contact[agent] = now
        self._explained[agent].clear()
        for known in (self._back_off_until, self._suspected, self._attempts):
            known.pop(agent, None)

    def _check(self, agent: str, now: float) -> list[Effect]:
        saved = self._copies.checkpoint(agent)
        if (
            saved is None
            or not saved.interval
            or self._is_alive(agent, saved)
            or self._terminations.covering_termination(agent, saved.position.generation)
        ):
            self._clear_suspicion(agent, now)
            return []
        at = self._suspected[agent] = self._suspect_at(agent, saved, now)
        attempt = self._attempts.get(agent)
        if attempt is None:
            return self._suspect(agent, saved, now) if now >= at else []
        if attempt.checkpoint != saved.position:
            return self._defer_to_better(agent, now)
        if now < at:
            return self._end(agent)
        return self._advance(agent, attempt, now)

    def _suspect_at(self, agent: str, saved: Checkpoint, now: float) -> float:
        # While the last known holder may still have a lease, a failover is not justified.
        silence = max(saved.interval, self._members.grace_period)
        last_contact = self._last_contact.setdefault(agent, now)
        return (
            max(last_contact + silence, self._back_off_until.get(agent, last_contact)) + self._delays[agent]
        )

    def _advance(self, agent: str, attempt: FailoverAttempt, now: float) -> list[Effect]:
        match attempt.phase:
            case "asking" if self._has_enough_answers(attempt, now):
                return self._send_proposals(agent, attempt, now)
            case "asking" | "proposing" if now >= attempt.deadline:
                return self._back_off(agent, now)
            case "asking" if now >= attempt.due:
                return self._send_queries(agent, attempt, now)
            case "proposing" if now >= attempt.due:
                return self._resend(agent, attempt, now)
            case "waiting" if now >= attempt.due:
                return self._take_over(agent, attempt, now)
        return []

    def _suspect(self, agent: str, saved: Checkpoint, now: float) -> list[Effect]:
        attempt = FailoverAttempt(
            saved.position, "asking", now, now + self._members.heartbeat_interval, now + self._members.lease
        )
        self._attempts[agent] = attempt
        queries = self._send_queries(agent, attempt, now)
        line = log_messages.FAILOVER_SUSPECTED.line(agent=agent, seconds=saved.interval)
        return [*self._explain(agent, line, now), *queries]

    def _explain(self, agent: str, text: LogLine, now: float) -> list[Effect]:
        """Log a reason once per suspicion."""
        if text in self._explained[agent]:
            return []
        self._explained[agent][text] = now
        return [LogExplanation(text)]

    def _send_queries(self, agent: str, attempt: FailoverAttempt, now: float) -> list[Effect]:
        attempt.due = now + self._members.heartbeat_interval / 2.0
        return [
            SendQuorumMessage(host, Locate([agent], leases=True))
            for host in self._hosts
            if host not in attempt.answered
        ]

    def _has_enough_answers(self, attempt: FailoverAttempt, now: float) -> bool:
        answered = {self._members.own_name, *attempt.answered}
        all_said = now >= attempt.answer_deadline or answered.issuperset(self._hosts)
        return all_said and self._members.is_majority(answered)

    # --- answers --------------------------------------------------------------------------------------

    def on_located(self, host: str, answer: LeaseRecord, now: float) -> list[Effect]:
        """A host answers with its record of an agent."""
        if answer.holder:
            self.on_holder(answer.agent, answer.generation, now - answer.age)
        attempt = self._attempts.get(answer.agent)
        if attempt is None:
            return []
        if _newer(answer.checkpoint, attempt.checkpoint):
            line = log_messages.FAILOVER_DEFERRED.line(agent=answer.agent, host=host)
            return [*self._explain(answer.agent, line, now), *self._defer_to_better(answer.agent, now)]
        attempt.answered.add(host)
        return self._check(answer.agent, now)

    def on_termination(self, ended: Terminated, now: float) -> list[Effect]:
        """A host reports a termination: no earlier checkpoint is resumed."""
        attempt = self._attempts.get(ended.agent)
        if attempt is None or ended.generation < attempt.checkpoint.generation:
            return []
        return self._defer_to_better(ended.agent, now)

    def on_promise(self, host: str, answer: Promise, now: float) -> list[Effect]:
        """A member has promised, or reports a later fence."""
        agent = answer.agent
        attempt = self._attempts.get(agent)
        if attempt is None or attempt.phase == "asking" or attempt.generation != answer.generation:
            return []
        if answer.fence > answer.generation or _newer(answer.checkpoint, attempt.checkpoint):
            return self._defer_to_better(agent, now)
        if attempt.phase == "proposing":
            attempt.promised.add(host)
            if self._members.is_majority(attempt.promised):
                attempt.phase, attempt.due = "waiting", now + self._members.grace_period
        return []

    # --- steps ----------------------------------------------------------------------------------------

    def _send_proposals(self, agent: str, attempt: FailoverAttempt, now: float) -> list[Effect]:
        attempt.phase, attempt.deadline = "proposing", now + PHASE_TIMEOUT * self._members.lease
        attempt.promises_valid_until = now + PROMISE_LIFETIME * self._members.lease
        attempt.generation = self._copies.allocate_generation(agent, self._fences.token_of(agent))
        self._fences.advance(agent, attempt.generation)
        reason = f"{self._members.own_name} is about to resume it"
        if self._members.is_voter:
            # Messages to other hosts wait until this fence is on disk: it is a promise like those of the
            # others.
            attempt.promised.add(self._members.own_name)
        if self._members.is_majority(attempt.promised):
            attempt.phase, attempt.due = "waiting", now + self._members.grace_period
        raise_fence = RaiseFence(agent, attempt.generation, reason)
        return [raise_fence, *(self._resend(agent, attempt, now) if attempt.phase == "proposing" else [])]

    def _resend(self, agent: str, attempt: FailoverAttempt, now: float) -> list[Effect]:
        attempt.due = now + self._members.heartbeat_interval
        silent = (host for host in self._members.others if host not in attempt.promised)
        start = attempt.checkpoint.generation
        return [SendQuorumMessage(host, Propose(agent, attempt.generation, start)) for host in silent]

    def _take_over(self, agent: str, attempt: FailoverAttempt, now: float) -> list[Effect]:
        self._defer_to_better(agent, now)
        if self._fences.token_of(agent) != attempt.generation or now >= attempt.promises_valid_until:
            return []
        promised, members = len(attempt.promised), len(self._members.names)
        line = log_messages.FAILOVER_DECIDED.line(agent=agent, promised=promised, members=members)
        return [PromoteCheckpoint(agent, attempt.generation, line)]

    def _defer_to_better(self, agent: str, now: float) -> list[Effect]:
        """Let a host with a better copy resume the agent: suspect again after the interval."""
        self._last_contact[agent] = now
        self._back_off_until.pop(agent, None)
        return self._end(agent)

    def _back_off(self, agent: str, now: float) -> list[Effect]:
        """Without a majority, back off and retry."""
        explanation = self._explain(agent, log_messages.FAILOVER_WAITING.line(agent=agent), now)
        self._back_off_until[agent] = now + self._members.lease
        return [*explanation, *self._end(agent)]

    def _end(self, agent: str) -> list[Effect]:
        self._attempts.pop(agent, None)
        self._suspected.pop(agent, None)
        self._delays[agent] = self._delay()
        return []


def _newer(other: CheckpointId | None, own: CheckpointId) -> bool:
    return other is not None and other.sort_key > own.sort_key
