"""The rules that make leases and fences safe, each removed: a judge must find the second acting copy."""

from __future__ import annotations

import math
import random
from collections.abc import Collection
from dataclasses import replace
from typing import Any

from planted_bugs import Bug, Patch

from lfield.host.migration.write_ahead import WriteAheadQueue
from lfield.host.team.leases import TeamLeases
from lfield.journal.records import FenceRecord
from lfield.replication.lease.core import Quorum
from lfield.replication.lease.failover import Failover
from lfield.replication.lease.lease import Lease
from lfield.replication.lease.quorum_members import QuorumMembers
from lfield.replication.transfer.coordinator_copies import CoordinatorCopy
from lfield.replication.transfer.effects import Effect, PersistRecord
from lfield.vm.agent import Agent
from lfield.wire.quorum_messages import Heartbeat, HeartbeatAck
from simulation_testing.fault_injection import Fault
from simulation_testing.scenarios.scenario import Scenario, doubted, parted
from simulation_testing.scenarios.scenario_drawing import draw_scenario, split
from simulation_testing.seed_runner import DrawScenario

#: A seed of `parted` that finds `the_fence_is_not_on_disk`: at 6 s the former holder of a coordinator
#: connects to a host that had promised a recovery and was restarted since. Plant that bug to find another
#: seed.
MEETING = 199
#: The breaches that reveal these bugs.
TWO_ACT = frozenset({"I1", "I4", "start"})


def acknowledgements_omit_the_fence(patch: Patch) -> None:
    _answers(patch, lambda self, host, message: [])


def a_fence_is_sent_once_and_lost_with_its_link(patch: Patch) -> None:
    sent_fences: set[tuple[int, str, int]] = set()

    def fences(self: Quorum, host: str, message: Heartbeat) -> list[Any]:
        key = (id(self), host, self.fences.digest)
        known = message.fences == self.fences.digest or key in sent_fences
        sent_fences.add(key)
        return [] if known else self.fences.all

    _answers(patch, fences)


def interrupted(seed: int) -> Scenario:
    """The scenario of `parted` with that meeting; the link of the two hosts is slow at first, and breaks."""
    scenario, met = parted(MEETING), 5.8 + random.Random(f"interrupted {seed}").uniform(0.0, 0.25)
    slow = Fault(met, "slow", "h2", "h0", 0.5, 1.0)
    return replace(scenario, aimed=(slow, replace(slow, at=met + 0.5, kind="reset")))


def a_refusal_counts_before_the_copy_is_loaded(patch: Patch) -> None:
    patch.setattr(CoordinatorCopy, "awaits_answer", CoordinatorCopy.is_unanswered)


def _answers(patch: Patch, fences: Any) -> None:
    """Acknowledge heartbeats with these fences."""
    on_heartbeat = Quorum._on_heartbeat

    def answers(self: Quorum, host: str, message: Heartbeat, now: float) -> list[Any]:
        fence_list = fences(self, host, message)
        effects = on_heartbeat(self, host, message, now)
        return [
            type(e)(e.host, HeartbeatAck(message.incarnation, message.number, fence_list))
            if isinstance(getattr(e, "message", None), HeartbeatAck)
            else e
            for e in effects
        ]

    patch.setattr(Quorum, "_on_heartbeat", answers)


def a_failover_does_not_wait_for_granted_leases(patch: Patch) -> None:
    patch.setattr(QuorumMembers, "grace_period", property(lambda self: 0.0))


def a_failover_waits_less_than_a_lease(patch: Patch) -> None:
    patch.setattr(QuorumMembers, "grace_period", property(lambda self: 0.1 * self.lease))


def the_fence_is_not_on_disk(patch: Patch) -> None:
    """The record counts as durable, but is never written."""
    put = WriteAheadQueue.put

    def forgets(self: WriteAheadQueue, effects: Any, now: float) -> list[Effect]:
        remaining = [
            e for e in effects if not (isinstance(e, PersistRecord) and isinstance(e.record, FenceRecord))
        ]
        return put(self, remaining, now)

    patch.setattr(WriteAheadQueue, "put", forgets)


def a_minority_of_promises_is_enough(patch: Patch) -> None:
    begin = Failover.__init__

    class Few(QuorumMembers):
        def is_majority(self, names: Collection[str]) -> bool:
            return bool(self.names.intersection(names))

    def with_few(self: Failover, members: QuorumMembers, *more: Any) -> None:
        begin(self, Few(members.names, members.own_name, members.lease), *more)

    patch.setattr(Failover, "__init__", with_few)


def one_acknowledgement_renews_a_lease(patch: Patch) -> None:
    """In two groups of a team the lease continues, as long as one other member of the group answers."""

    def count(self: Lease) -> None:
        times = sorted(self._acknowledged.values(), reverse=True)
        if not self._alone and len(times) >= self._members.majority - self._members.is_voter:
            self.valid_until = times[0] + self._members.lease

    patch.setattr(Lease, "_update", count)


def a_coordinator_runs_without_a_lease(patch: Patch) -> None:
    def may_act(self: Quorum, agent: str, generation: int, now: float) -> bool:
        return not self.is_fenced(agent, generation)

    def until(self: TeamLeases, caller: Agent, device: str) -> float:
        return math.inf

    patch.setattr(Quorum, "may_act", may_act)
    patch.setattr(TeamLeases, "actuation_deadline", until)
    patch.setattr(TeamLeases, "_on_lost", lambda self: None)


def _bug(plant: Any, broken: str, seed: int, draws: DrawScenario = doubted) -> Bug:
    return Bug(plant, broken, TWO_ACT, seed, draws)


QUORUM_BUGS = [
    _bug(
        acknowledgements_omit_the_fence,
        "acknowledgements omit the fence: a host keeps its lease although its coordinator is fenced",
        95,
    ),
    _bug(
        a_failover_does_not_wait_for_granted_leases,
        "a failover does not wait for leases that its voters have granted before",
        61,
    ),
    _bug(a_failover_waits_less_than_a_lease, "a failover waits less than a lease", 67),
    _bug(a_minority_of_promises_is_enough, "the promises of a minority are enough for a failover", 116),
    _bug(
        one_acknowledgement_renews_a_lease,
        "one acknowledgement renews a lease, also in a team of more than three members",
        25,
        split,
    ),
    _bug(
        a_coordinator_runs_without_a_lease,
        "a coordinator runs without a lease, beside its recovered copy",
        101,
    ),
    _bug(
        a_fence_is_sent_once_and_lost_with_its_link,
        "a fence is sent only once and is lost with the link",
        0,
        interrupted,
    ),
    # A Hello and acknowledgements would inform a host without its records: the bug is found if such hosts
    # have no link.
    _bug(
        the_fence_is_not_on_disk,
        "a restarted voter forgets its fence and grants a lease to the fenced start",
        40,
        parted,
    ),
    Bug(
        a_refusal_counts_before_the_copy_is_loaded,
        "a restarted host accepts the refusal of a move before the coordinator is in its machine again",
        frozenset({"stuck"}),
        147,
        draw_scenario,
    ),
]
