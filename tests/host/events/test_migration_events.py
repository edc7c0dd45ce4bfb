"""The events of hops, calls and devices, with their causes, one after the other."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from lfield.clock import ManualClock
from lfield.host.events.event_rate_limit import MIGRATIONS_UNOBSERVED
from lfield.host.events.event_recorder import EventRecorder
from lfield.host.events.migration_events import HopStep, MigrationEvents
from lfield.hybrid_clock import HybridClock
from lfield.replication.transfer.effects import DropTerminated, MarkInDoubt, MarkMigrated, TerminateCopy
from lfield.text import log_messages
from lfield.wire import events
from lfield.wire.coordinator_messages import CoordinatorState, Transfer
from lfield.wire.fields import MAX_TEXT

HASH = b"p" * 32


class HopSteps:
    """Appends the steps of hops as the coordinators of a host do; forwards the rest to `MigrationEvents`."""

    def __init__(self, made: MigrationEvents, clock: ManualClock) -> None:
        self._made, self._clock = made, clock
        self._stamps = HybridClock(clock.now, clock.now)
        self.on_effect, self.on_failed = made.on_effect, made.on_failed
        self.restore_in_flight = made.restore_in_flight

    def on_sent(self, to: str, header: Transfer) -> None:
        target = self._made.target_of(header.agent)
        self._made.hops.append((HopStep.SENT, self._clock.now, to, header, *target))

    def on_arriving(self, host: str, header: Transfer) -> None:
        self._made.hops.append((HopStep.ARRIVED, self._clock.now, host, header))

    def on_running(self, name: str, generation: int) -> None:
        agent = self._made._machine.agents.get(name)
        sequence = None if agent is None else agent.sequence
        self._made.hops.append(
            (HopStep.RUNNING, self._clock.now, name, generation, sequence, self._stamps.tick(self._clock.now))
        )

    def on_confirmed(self, effect: MarkMigrated) -> None:
        self._made.hops.append(
            (HopStep.CONFIRMED, self._clock.now, effect, self._stamps.tick(self._clock.now))
        )


class Rig:
    """A host `a` without agents, whose parts record events."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.recorder = EventRecorder(self.clock)
        self.agents: dict[str, SimpleNamespace] = {}
        called = SimpleNamespace(id="gate", host=1)
        machine = SimpleNamespace(
            agents=self.agents, itinerary=SimpleNamespace(current_target=lambda agent: (called, "pass"))
        )
        team = SimpleNamespace(hosts=["a", "b"], coordinators=[SimpleNamespace(id="w")])
        made = MigrationEvents(self.recorder, machine, "a", team)  # type: ignore[arg-type]
        self.made, self.hops = made, HopSteps(made, self.clock)

    def agent(self, sequence: int, *, frozen: bool = True) -> None:
        self.agents["w"] = SimpleNamespace(id="w", generation=1, sequence=sequence, frozen=frozen)

    @property
    def recorded(self) -> list[events.Event]:
        self.recorder.drain()
        return self.recorder.event_log.after(0, 10_000, 10**9)[0]

    @property
    def last(self) -> tuple[int, events.StateEvent | events.TelemetryEvent]:
        return self.recorded[-1].cause, self.recorded[-1].what


@pytest.fixture
def rig() -> Rig:
    return Rig()


def header(sequence: int) -> Transfer:
    return Transfer("w", 1, sequence, 3, HASH, 7, 544)


def test_a_repeated_transfer_is_one_hop_with_its_duration(rig: Rig) -> None:
    rig.agent(4)
    rig.hops.on_sent("b", header(4))
    rig.clock.advance(0.5)
    rig.hops.on_sent("b", header(4))
    rig.clock.advance(0.25)
    rig.hops.on_confirmed(MarkMigrated("w", 1, 4, "b"))
    left, migrated = rig.recorded
    assert left.what == events.MigrationStarted("w", 1, 4, "b", "gate", "pass", 544)
    assert migrated.what == events.MigrationConfirmed("w", 1, 4, "b", 0.75)
    assert migrated.cause == left.number


def test_a_hop_of_an_earlier_life_has_no_duration(rig: Rig) -> None:
    rig.hops.restore_in_flight(CoordinatorState("w", 1, 9, 8, "PREPARED", "b"))
    rig.hops.on_confirmed(MarkMigrated("w", 1, 9, "b"))
    assert rig.last == (0, events.MigrationConfirmed("w", 1, 9, "b", None))


def test_a_return_confirms_an_unconfirmed_hop(rig: Rig) -> None:
    rig.agent(4)
    rig.hops.on_sent("b", header(4))
    rig.clock.advance(0.5)
    rig.hops.on_arriving("b", header(5))
    rig.clock.advance(0.25)
    rig.agent(5)
    rig.hops.on_running("w", 1)
    left, migrated, arrived = rig.recorded
    assert (migrated.cause, migrated.what) == (left.number, events.MigrationConfirmed("w", 1, 4, "b", 0.5))
    assert arrived.what == events.MigrationArrived("w", 1, 5, "b", 544)
    rig.hops.on_confirmed(MarkMigrated("w", 1, 4, "b"))
    assert len(rig.recorded) == 3


def test_an_end_elsewhere_confirms_an_unconfirmed_hop(rig: Rig) -> None:
    rig.agent(4)
    rig.hops.on_sent("b", header(4))
    rig.clock.advance(0.5)
    rig.hops.on_effect(DropTerminated("w", 1, "done", "", "b"))
    assert rig.last == (1, events.MigrationConfirmed("w", 1, 4, "b", 0.5))


@pytest.mark.parametrize("outcome", ["stays", "lost", "superseded"])
def test_a_failed_hop_is_not_confirmed_by_a_later_arrival(rig: Rig, outcome: str) -> None:
    rig.agent(4)
    rig.hops.on_sent("b", header(4))
    if outcome == "stays":
        rig.hops.on_failed(rig.agents["w"], "UnreachableResourceException", "", recovered=False)  # type: ignore[arg-type]
    else:
        rig.hops.on_effect(DropTerminated("w", 1, outcome, "", "b"))  # type: ignore[arg-type]
    rig.hops.on_arriving("b", header(7))
    rig.agent(7)
    rig.hops.on_running("w", 1)
    assert "hopped" not in [event.kind for event in rig.recorded]


def test_a_dropped_hop_has_no_confirmation_event(rig: Rig) -> None:
    most = int(MIGRATIONS_UNOBSERVED.burst)
    for n in range(most + 5):
        rig.hops.on_sent("b", header(n))
        rig.hops.on_confirmed(MarkMigrated("w", 1, n, "b"))
    assert len(rig.recorded) == 2 * most
    rig.clock.advance(1.0)
    rig.recorder.report_dropped()
    assert rig.last == (0, events.EventsDropped("left", 5))


def test_a_refused_transfer_has_no_arrival_event(rig: Rig) -> None:
    rig.hops.on_arriving("b", header(5))
    rig.agent(7)
    rig.hops.on_running("w", 1)
    assert rig.recorded == []
    rig.hops.on_arriving("b", header(7))
    rig.hops.on_running("w", 1)
    assert rig.last == (0, events.MigrationArrived("w", 1, 7, "b", 544))
    rig.hops.on_running("w", 1)
    assert len(rig.recorded) == 1


def test_nothing_is_kept_of_unknown_coordinators(rig: Rig) -> None:
    for n in range(100):
        rig.hops.on_arriving("b", Transfer(f"stranger{n}", 1, 5, 3, HASH, 7, 544))
    rig.agents["stranger1"] = SimpleNamespace(id="stranger1", generation=1, sequence=5, frozen=True)
    rig.hops.on_running("stranger1", 1)
    assert rig.recorded == []


def test_the_end_of_a_call_is_not_recorded_once_calls_are_discarded(rig: Rig) -> None:
    rig.recorder.on_call_started(1, "w", "gate", "pass")
    assert rig.recorder.is_recorded(1)
    rig.recorder.discard_calls()
    rig.recorder.on_call_ended(1, "done")
    assert len(rig.recorded) == 1


def test_the_cause_of_an_action_after_an_arrival_is_the_arrival(rig: Rig) -> None:
    rig.recorder.on_agent_started("w", 1)
    rig.agent(2)
    rig.hops.on_arriving("b", header(2))
    rig.hops.on_running("w", 1)
    rig.recorder.on_printed("w", "here")
    assert [event.cause for event in rig.recorded] == [0, 0, 2]


def test_doubts_ends_and_later_starts_are_recorded_once(rig: Rig) -> None:
    rig.hops.on_effect(MarkInDoubt("w", 1, 2, "b", "no answer"))
    rig.hops.on_effect(TerminateCopy("w", 1, "another start"))
    rig.hops.on_effect(DropTerminated("w", 1, "done", "", "b"))
    assert [event.what for event in rig.recorded] == [events.MigrationInDoubt("w", 1, "b", "no answer")]
    rig.agent(2)
    rig.hops.on_effect(TerminateCopy("w", 1, "another start"))
    rig.hops.on_effect(DropTerminated("w", 1, "lost", "given up", "a"))
    assert [event.what for event in rig.recorded[1:]] == [
        events.CoordinatorSuperseded("w", 1, "another start"),
        events.AgentFinished("w", 1, "lost", "given up"),
    ]


def test_concurrent_calls_of_one_resource_have_separate_causes(rig: Rig) -> None:
    recorder = rig.recorder
    recorder.on_call_started(1, "w", "gate", "pass")
    recorder.on_call_started(2, "v", "gate", "pass")
    recorder.on_device_call("gate", 10, 1, "gate.fc", "goTo")
    recorder.on_device_call("gate", 11, 2, "gate.fc", "land")
    recorder.on_device_answer("gate", 10, "")
    recorder.on_device_answer("gate", 11, "gate.fc: too far")
    recorder.on_call_ended(2, "thrown", "DeviceException")
    recorder.on_call_ended(1, "done")
    causes = [event.cause for event in rig.recorded]
    assert causes == [0, 0, 1, 2, 3, 4, 6, 5]
    assert rig.recorded[5].what == events.DeviceCallEnded(
        2, "gate", "gate.fc", "land", 0.0, "gate.fc: too far"
    )


def test_pending_calls_of_a_dead_resource_are_lost(rig: Rig) -> None:
    rig.recorder.on_call_started(1, "w", "gate", "pass")
    rig.recorder.on_call_started(2, "v", "other", "pass")
    rig.recorder.on_resource_died("gate", "NullException")
    rig.recorder.on_call_ended(1, "done")
    assert rig.last == (1, events.PortalCallEnded(1, "w", "gate", "pass", 0.0, "lost", "NullException"))


def test_the_cause_of_a_safe_state_is_the_event_with_the_same_reason(rig: Rig) -> None:
    recorder = rig.recorder
    recorder.on_log_line(log_messages.JOURNAL_WRITABLE.line())
    recorder.on_emergency_stop("anna", "fire", lifted=False)
    recorder.on_device_event(events.DeviceLatched("g.fc", "land", "fire"))
    recorder.on_device_event(events.SafeStateConfirmed("g.fc", "land", "fire"))
    recorder.on_device_event(events.DeviceLatched("h.fc", "land", "it was lost"))
    assert [event.cause for event in rig.recorded] == [0, 0, 2, 3, 0]


def test_a_moving_device_is_recorded_once_a_second_and_its_rest_at_once(rig: Rig) -> None:
    for _ in range(30):
        rig.recorder.on_device_event(events.DeviceMoving("g.fc", "falls"))
        rig.clock.advance(0.1)
    rig.recorder.on_device_event(events.DeviceMoving("g.fc", ""))
    rig.recorder.on_device_event(events.DeviceMoving("g.fc", ""))
    assert [event.what.moving for event in rig.recorded] == ["falls"] * 3 + [""]  # type: ignore[union-attr]


def test_the_number_of_kept_reasons_is_bounded(rig: Rig) -> None:
    for n in range(200):
        rig.recorder.on_emergency_stop("anna", f"reason {n}", lifted=False)
    rig.recorder.on_device_event(events.DeviceLatched("g.fc", "land", "reason 1"))
    rig.recorder.on_device_event(events.DeviceLatched("h.fc", "land", "reason 199"))
    assert [event.cause for event in rig.recorded[-2:]] == [0, 200]


def test_long_texts_are_cut_to_the_limit_of_a_message(rig: Rig) -> None:
    long = "x" * (2 * MAX_TEXT)
    rig.recorder.on_log_line(log_messages.HOST_FAILED.line(host="alpha", reason=long))
    rig.recorder.on_emergency_stop(long, long, lifted=False)
    rig.recorder.on_device_event(events.DeviceLatched("g.fc", "land", rig.recorded[-1].what.reason))  # type: ignore[union-attr]
    assert all(len(event.what.text) <= MAX_TEXT for event in rig.recorded[:1])  # type: ignore[union-attr]
    assert rig.recorded[-1].cause == 2
