"""Former and plausible bugs as patches of the real code: the judge must find them all."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import pytest
from msgspec import structs

from lfield.errors import DeviceError
from lfield.host.context import HostContext
from lfield.host.core import HostCore
from lfield.host.host import Host
from lfield.host.migration.write_ahead import WriteAheadQueue
from lfield.host.team.startup import Startup
from lfield.journal.records import CoordinatorRecord
from lfield.replication.locate.outcomes import UnavailableHosts
from lfield.replication.membership.membership import Membership
from lfield.replication.transfer.coordinator_copies import CoordinatorCopy
from lfield.replication.transfer.core import Mobility
from lfield.replication.transfer.effects import Effect, PersistRecord, Send
from lfield.replication.transfer.query_relay import QueryRelay
from lfield.replication.transfer.start_gate import StartGate
from lfield.replication.transfer.transfer_receiver import TransferReceiver
from lfield.replication.transfer.transfer_sender import TransferSender
from lfield.vm.machine import Machine
from lfield.wire.coordinator_messages import NEVER_ARRIVED, TransferAccepted, TransferQuery, TransferRefused
from lfield.wire.messages import Hello
from simulation_testing.scenarios.scenario import FOR_EVER, Scenario, forgetful, plain
from simulation_testing.scenarios.scenario_drawing import apart
from simulation_testing.seed_runner import DrawScenario

Patch = pytest.MonkeyPatch


@dataclass(frozen=True)
class Bug:
    """A bug: its planting function, its description, the breaches that reveal it, and a seed that finds it.

    `draws` draws the kind of scenarios that find the bug fastest. If `seed` no longer finds it after a
    change, the `within` scenarios from `first` on are searched; a thousand find every bug.
    """

    plant: Callable[[Patch], None]
    broken: str
    breaches: frozenset[str]
    seed: int
    draws: DrawScenario = plain
    first: int = 0
    within: int = 150

    @property
    def name(self) -> str:
        return self.plant.__name__


def forgotten(seed: int) -> Scenario:
    """A scenario of a small team without journals, in which a home often restarts coordinators that it cannot
    reach."""
    rng = random.Random(f"forgotten {seed}")
    means = {kind: rng.uniform(1.5, 4.0) for kind in ("kill", "restart", "island", "cut")}
    scenario = replace(forgetful(seed), cast=3, hosts=3, walkers=1, arms=0, calls=FOR_EVER, stay=0.04)
    return replace(scenario, lost_after=None, weather=14.0, seconds=14.0, stays=2, means=means)


def forgotten_walkers(seed: int) -> Scenario:
    """`forgotten`, longer and with more walkers: one of them arrives on a host with a later start of it."""
    return replace(forgotten(seed), walkers=4, stay=0.2, weather=28.0, seconds=28.0)


def no_answer_counts_as_a_loss(patch: Patch) -> None:
    def absent(
        self: Membership, answered: Any, now: float, lost_after: float, unmet: float
    ) -> UnavailableHosts:
        return UnavailableHosts(ended=[host for host in self._others if host not in answered])

    patch.setattr(Membership, "unavailable_hosts", absent)


def two_starts_on_one_host(patch: Patch) -> None:
    admit = Machine.inject

    def admit_beside(self: Machine, member: Any, *more: Any) -> Any:
        other = self.agents.get(member.id)
        ended = other.ended if other else ""
        agent = admit(self, member, *more)
        if other:
            other.ended = ended
        return agent

    patch.setattr(Machine, "inject", admit_beside)


def guards_get_heartbeats_from_a_failed_host(patch: Patch) -> None:
    enter, unlinked = Host.dispatch, HostCore.on_unlinked

    def breaks(self: HostCore, host: str) -> None:
        self.breaks = getattr(self, "breaks", 0) + 1  # type: ignore[attr-defined]
        if self.breaks == 3:
            raise ValueError("an unknown bug")
        unlinked(self, host)

    def enter_if_alive(self: Host, *entry: Any) -> None:
        if not hasattr(self, "pump_died"):
            enter(self, *entry)

    patch.setattr(HostCore, "on_unlinked", breaks)
    patch.setattr(Host, "dispatch", enter_if_alive)
    patch.setattr(Host, "fail", lambda self, error: setattr(self, "pump_died", error))
    patch.setattr(Host, "step", lambda self: self.dispatch() or True)


def a_reply_with_an_exception_is_dropped(patch: Patch) -> None:
    answered = HostCore.on_device_answer

    def lost(self: HostCore, number: int, value: Any) -> None:
        if not isinstance(value, DeviceError):
            answered(self, number, value)

    patch.setattr(HostCore, "on_device_answer", lost)


def a_sender_resumes_after_sending(patch: Patch) -> None:
    def overdue(self: TransferSender, copy: CoordinatorCopy, now: float) -> list[Effect]:
        return self._resume(copy, "UnreachableResourceException", "it took too long")

    patch.setattr(TransferSender, "on_deadline", overdue)
    patch.setattr("lfield.replication.transfer.transfer_sender.MIN_DOUBT_TIME", 0.0)


def a_receiver_forgets_its_answers(patch: Patch) -> None:
    def inquire(self: TransferReceiver, host: str, asked: TransferQuery) -> list[Effect]:
        refused = TransferRefused(asked.agent, asked.generation, asked.sequence, NEVER_ARRIVED, "who?")
        return [Send(host, refused)]

    patch.setattr(TransferReceiver, "on_query", inquire)


def a_restart_counts_as_proof_of_absence(patch: Patch) -> None:
    retry = TransferSender._retry

    def retry_without_query(self: TransferSender, copy: CoordinatorCopy, peer: Hello) -> list[Effect]:
        restarted = copy.state == "PREPARED" and peer.state_id != copy.receiver_memory
        return self._send(copy) if restarted else retry(self, copy, peer)

    patch.setattr(TransferSender, "_retry", retry_without_query)


def _drops(patch: Patch, cls: type, name: str, states: str) -> None:
    """Records of these states that this method decides are not written to disk."""
    go = getattr(cls, name)

    def forgets(self: Any, *given: Any, **named: Any) -> list[Effect]:
        effects: list[Effect] = go(self, *given, **named)
        return [e for e in effects if not (isinstance(e, PersistRecord) and e.record.state in states.split())]  # type: ignore[union-attr]

    patch.setattr(cls, name, forgets)


def a_sent_transfer_is_not_on_disk(patch: Patch) -> None:
    _drops(patch, TransferSender, "_send", "PREPARED")


def admissions_are_not_on_disk(patch: Patch) -> None:
    _drops(patch, TransferReceiver, "on_transfer", "RUN ABSENT")
    _drops(patch, TransferReceiver, "on_query", "RUN ABSENT MOVED")


def an_admission_is_acknowledged_before_it_is_on_disk(patch: Patch) -> None:
    put = WriteAheadQueue.put

    def hasty(self: WriteAheadQueue, effects: Iterable[Effect], now: float) -> list[Effect]:
        effects = list(effects)
        answers = [
            e
            for e in effects
            if isinstance(e, Send) and isinstance(e.message, TransferAccepted | TransferRefused)
        ]
        return [*answers, *put(self, [e for e in effects if e not in answers], now)]

    patch.setattr(WriteAheadQueue, "put", hasty)


def a_call_starts_before_its_checkpoint_is_on_disk(patch: Patch) -> None:
    save = Mobility.save
    patch.setattr(Mobility, "save", lambda *given: list(reversed(save(*given))))


def a_restarted_host_runs_a_shadow(patch: Patch) -> None:
    restore = CoordinatorCopy.restore

    def returns(self: CoordinatorCopy, page: CoordinatorRecord) -> None:
        left = page.state in ("PREPARED", "MOVED") and page.block
        restore(self, structs.replace(page, state="RUN") if left else page)

    patch.setattr(CoordinatorCopy, "restore", returns)


def answers_from_the_journal_are_not_accepted(patch: Patch) -> None:
    patch.setattr(Hello, "state_id", property(lambda self: self.incarnation))


def start_numbers_come_from_the_wall_clock(patch: Patch) -> None:
    begin = Startup.__init__

    def with_clock(self: Startup, context: HostContext, *more: Any) -> None:
        begin(self, context, *more)
        self._gate.clock = context.clock  # type: ignore[attr-defined]

    patch.setattr(Startup, "__init__", with_clock)
    patch.setattr(StartGate, "next_generation", property(lambda self: int(self.clock.time())))


def queries_are_not_relayed(patch: Patch) -> None:
    patch.setattr(QueryRelay, "arm", lambda self: None)


BUGS = [
    Bug(
        no_answer_counts_as_a_loss,
        "a host without an answer counts as lost: one cut link makes a live coordinator 'lost'",
        frozenset({"lost", "stuck"}),
        775,
    ),
    Bug(
        two_starts_on_one_host,
        "an earlier start is admitted on a host that runs a later one: two copies run",
        frozenset({"I1", "I4"}),
        618,
        draws=forgotten_walkers,
    ),
    Bug(
        guards_get_heartbeats_from_a_failed_host,
        "the host's event loop ends with an exception, and heartbeats to the guards continue",
        frozenset({"stuck", "device", "doubt"}),
        2,
    ),
    Bug(
        a_reply_with_an_exception_is_dropped,
        "a reply that is an exception is dropped: its thread waits without end",
        frozenset({"stuck"}),
        2,
    ),
    Bug(
        a_sender_resumes_after_sending,
        "appendix I as printed: a sender resumes after sending, although the copy may have arrived",
        frozenset({"I1", "I4"}),
        3,
    ),
    Bug(
        a_receiver_forgets_its_answers,
        "a receiver forgets its answers and reports an admitted transfer as not arrived",
        frozenset({"I1", "I4"}),
        12,
    ),
    Bug(
        a_restart_counts_as_proof_of_absence,
        "the restart of a receiver counts as proof that the coordinator did not run there before",
        frozenset({"I1", "I4"}),
        652,
    ),
    Bug(
        a_sent_transfer_is_not_on_disk,
        "the sender's record of a transfer is not on disk: after a restart it resumes the sent copy",
        frozenset({"I1", "I4", "start"}),
        12,
    ),
    Bug(
        admissions_are_not_on_disk,
        "the receiver's record of an admission is not on disk: after a restart the coordinator is missing",
        frozenset({"I5", "I1", "I4", "I2", "stuck"}),
        2,
    ),
    Bug(
        an_admission_is_acknowledged_before_it_is_on_disk,
        "an admission is acknowledged before its record is on disk",
        frozenset({"I5", "I1", "I4", "I2", "stuck"}),
        7,
    ),
    Bug(
        a_call_starts_before_its_checkpoint_is_on_disk,
        "a call starts before the checkpoint of its caller is on disk",
        frozenset({"I4", "I5"}),
        566,
    ),
    Bug(
        a_restarted_host_runs_a_shadow,
        "a restarted host runs the shadow of a coordinator that has migrated",
        frozenset({"I1", "I4"}),
        2,
    ),
    Bug(
        answers_from_the_journal_are_not_accepted,
        "senders do not accept answers from the journal of a restarted receiver",
        frozenset({"stuck"}),
        19,
    ),
    Bug(
        start_numbers_come_from_the_wall_clock,
        "start numbers come from the wall clock: after it is set back, a later start has a smaller number",
        frozenset({"start", "I1", "I2"}),
        50,
        draws=forgetful,
    ),
    Bug(
        queries_are_not_relayed,
        "queries are not relayed: two hosts with a common neighbour leave a coordinator in doubt",
        frozenset({"doubt"}),
        4,
        draws=apart,
    ),
]
