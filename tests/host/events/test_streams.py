"""Events are numbered without a gap, and a reader loses none; lost telemetry is counted."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from watched_streams import LIFE, STATUS, append_lines, batch_of, numbers, sample, small, watched

from lfield.clock import ManualClock
from lfield.host.events.event_log import FREQUENT, MAX_FREQUENT_EVENTS, EventLog, EventRing, size_of
from lfield.host.events.event_recorder import EventRecorder
from lfield.host.events.event_subscription import (
    BATCH_BYTES,
    LONGEST_REST,
    MIN_INTERVAL,
    QUIET_INTERVAL,
    READ_TIMEOUT,
)
from lfield.host.events.migration_events import HopStep, MigrationEvents
from lfield.replication.transfer.effects import MarkMigrated
from lfield.wire.codec import encode
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.events import KINDS, TELEMETRY, DeviceLatched, EmergencyStopChanged, LineLogged
from lfield.wire.fields import MAX_TEXT
from lfield.wire.subscription_messages import MAX_EVENTS, WINDOW, Subscribe

# --- the ring -------------------------------------------------------------------------------------------


@given(
    st.lists(st.integers(0, 300), max_size=60),
    st.integers(1, 20),
    st.integers(1, 2000),
)
def test_the_ring_has_the_newest_events_within_its_limits(sizes, most_events, most_bytes):
    stream = small(most_events, most_bytes)
    for size in sizes:
        stream.append(LineLogged("x" * size), 1.0, 2.0)
    events, total = stream.after(0, 10**6, 10**9)
    assert stream.latest == len(sizes)
    assert [event.number for event in events] == list(range(stream.last_dropped + 1, stream.latest + 1))
    assert len(events) <= most_events
    assert total == sum(map(size_of, events))
    assert total <= most_bytes or len(events) == 1


def test_an_event_has_its_cause_and_its_times():
    stream = EventLog()
    first = stream.append(LineLogged("stop"), 1.7e9, 5.0)
    stream.append(LineLogged("latched"), 1.7e9 + 1, 6.0, first)
    _, event = stream.after(0, 9, 999)[0]
    assert (event.number, event.at, event.up, event.cause) == (2, 1.7e9 + 1, 6.0, 1)


def test_frequent_events_do_not_displace_rare_ones():
    stream = small(10)
    stream.append(EmergencyStopChanged("anna", "fire"), 1.0, 1.0)
    append_lines(stream, 50)
    stream.append(DeviceLatched("a.fc", "land", "fire"), 1.0, 1.0)
    append_lines(stream, 50)
    events, _ = stream.after(0, 99, 9999)
    assert [event.number for event in events] == [1, 52, *range(93, 103)]
    assert (stream.latest, stream.last_dropped) == (102, 92)
    # Some of the frequent events can be left out.
    assert [event.number for event in stream.after(1, 99, 9999, 100)[0]] == [52, 101, 102]


def test_safety_events_are_rare_events():
    often = {kind for kind, struct in KINDS.items() if struct in FREQUENT}
    assert often == {
        *("printed", "logged", "skipped", "left", "came", "hopped", "stayed"),
        *("began", "ended", "asked", "answered"),
    }
    seldom = KINDS.keys() - often - TELEMETRY
    assert {"stopped", "paused", "latched", "confirmed", "moving", "released", "unlinked"} <= seldom


# --- where a subscription begins ------------------------------------------------------------------------


def test_a_new_subscription_begins_now_with_a_snapshot():
    stream = EventLog()
    append_lines(stream, 5)
    watcher = watched(stream, Subscribe())
    first = batch_of(watcher, 0.0)
    assert (first.batch, first.after, first.latest, first.events) == (1, 5, 5, [])
    assert first.snapshot is STATUS
    append_lines(stream, 2)
    second = batch_of(watcher, MIN_INTERVAL)
    assert (numbers(second), second.after, second.snapshot) == ([6, 7], 5, None)


def test_a_repeated_subscription_continues_after_the_last_received_event():
    stream = EventLog()
    append_lines(stream, 5)
    first = batch_of(watched(stream, Subscribe(LIFE, 3)), 0.0)
    assert (numbers(first), first.snapshot, first.lost) == ([4, 5], None, {})


def test_a_repeated_subscription_without_new_events_is_answered_at_once():
    stream = EventLog()
    append_lines(stream, 5)
    first = batch_of(watched(stream, Subscribe(LIFE, 5)), 0.0)
    assert (first.batch, first.events, first.after) == (1, [], 5)


def test_a_subscription_of_an_earlier_life_gets_all_events_of_this_one():
    stream = EventLog()
    append_lines(stream, 3)
    watcher = watched(stream, Subscribe(LIFE - 1, 4000))
    first, second = batch_of(watcher, 0.0), batch_of(watcher, MIN_INTERVAL)
    assert (first.snapshot, first.after, first.events) == (STATUS, 0, [])
    assert numbers(second) == [1, 2, 3]


def test_a_subscription_ahead_of_the_log_gets_new_events():
    stream = EventLog()
    append_lines(stream, 3)
    watcher = watched(stream, Subscribe(LIFE, 2**62))
    assert batch_of(watcher, 0.0).after == 3


def test_dropped_events_are_counted_and_replaced_by_a_snapshot():
    stream = small(10)
    append_lines(stream, 100)
    watcher = watched(stream, Subscribe(LIFE, 20))
    first, second = batch_of(watcher, 0.0), batch_of(watcher, MIN_INTERVAL)
    assert (first.lost, first.after, first.latest, first.events) == ({}, 20, 100, [])
    assert first.snapshot is STATUS
    assert (numbers(second), second.after, second.lost) == (list(range(91, 101)), 90, {"state": 70})


# --- time and size --------------------------------------------------------------------------------------


def test_the_interval_of_batches_has_both_limits():
    stream = EventLog()
    watcher = watched(stream)
    assert batch_of(watcher, 0.0) is not None
    assert watcher.due == pytest.approx(QUIET_INTERVAL)
    append_lines(stream, 1)
    assert watcher.due == pytest.approx(MIN_INTERVAL)
    assert batch_of(watcher, MIN_INTERVAL / 2) is None
    assert numbers(batch_of(watcher, MIN_INTERVAL)) == [1]
    watcher.on_ack(2, MIN_INTERVAL)
    assert batch_of(watcher, MIN_INTERVAL + QUIET_INTERVAL / 2) is None
    assert batch_of(watcher, MIN_INTERVAL + QUIET_INTERVAL).events == []


def test_a_batch_is_small_after_many_events():
    stream = EventLog()
    append_lines(stream, 300, "x" * MAX_TEXT)
    watcher, now, received = watched(stream), 0.0, []
    while len(received) < 300:
        batch = batch_of(watcher, now)
        assert len(encode(batch)) < 64 << 10
        received += numbers(batch)
        watcher.on_ack(batch.batch, now)
        now += MIN_INTERVAL
    assert received == list(range(1, 301))


def test_a_batch_has_no_more_events_than_a_message_may():
    stream = small(4 * MAX_EVENTS)
    append_lines(stream, 2 * MAX_EVENTS, "")
    assert 0 < len(batch_of(watched(stream), 0.0).events) <= MAX_EVENTS


def test_a_reader_that_does_not_acknowledge_gets_at_most_the_window():
    stream = EventLog()
    watcher, up, sent = watched(stream), 0.0, 0
    while up < READ_TIMEOUT - 1.0:
        append_lines(stream, 10, "x" * 2000)
        sent += batch_of(watcher, up) is not None
        up += MIN_INTERVAL
    assert sent == WINDOW
    assert not watcher.has_gone(up)
    assert watcher.has_gone(READ_TIMEOUT + 1.0)
    assert watcher.due <= READ_TIMEOUT


def test_a_closed_subscription_gets_the_number_of_its_lost_events():
    stream = EventLog()
    watcher, up, sent = watched(stream, Subscribe(LIFE, 0, 20.0)), 0.0, []
    while not watcher.has_gone(up):
        watcher.on_sample(sample(fc=up), 1.0, up)
        sent += filter(None, [batch_of(watcher, up)])
        up += MIN_INTERVAL
    append_lines(stream, 3)
    last = watcher.final_batch(1.7e9 + up, up)
    assert (last.batch, last.events, last.after, last.latest) == (WINDOW + 1, [], 0, 3)
    # Unsent telemetry is lost as well.
    lost = sum(batch.lost.get("measured", 0) for batch in [*sent, last])
    assert lost + sum(len(b.events) for b in sent) == pytest.approx(up / MIN_INTERVAL, abs=2)


def test_a_reader_that_resumes_gets_no_gap():
    stream = EventLog()
    watcher = watched(stream)
    up, received = 0.0, []
    for _ in range(30):
        append_lines(stream, 1)
        if batch := batch_of(watcher, up):
            received += numbers(batch)
        up += MIN_INTERVAL
    watcher.on_ack(WINDOW, up)
    received += numbers(batch_of(watcher, up))
    assert received == list(range(1, 31))


def test_only_sent_batches_can_be_acknowledged():
    stream = EventLog()
    watcher = watched(stream)
    for n in range(WINDOW):
        append_lines(stream, 1)
        assert batch_of(watcher, n * MIN_INTERVAL)
    watcher.on_ack(WINDOW + 1000, 1.0)
    append_lines(stream, 1)
    assert batch_of(watcher, 1.0) is None
    watcher.on_ack(1, 1.0)
    assert batch_of(watcher, 1.0) is not None


# --- all together ---------------------------------------------------------------------------------------


class OneWatcher(RuleBasedStateMachine):
    """A watcher that reads at any time, of a host with events."""

    def __init__(self):
        super().__init__()
        self.stream = EventLog(EventRing(40, 4000), EventRing(5, 4000))
        self.up, self.sent, self.seen = 0.0, [], 0
        self.received, self.lost, self.sampled = [], {"state": 0, "measured": 0}, 0
        self.watcher = watched(self.stream, Subscribe(LIFE, 0, 20.0))

    @rule(sizes=st.lists(st.integers(0, 1500), max_size=12))
    def happen(self, sizes):
        for size in sizes:
            self.stream.append(LineLogged("x" * size), 1.0, self.up)

    @rule()
    def be_stopped(self):
        self.stream.append(EmergencyStopChanged("anna", "fire"), 1.0, self.up)

    @rule(seconds=st.sampled_from([0.01, MIN_INTERVAL, 0.3, QUIET_INTERVAL]))
    def wait(self, seconds):
        self.up += seconds

    @rule(names=st.sets(st.sampled_from("abc")))
    def measure(self, names):
        if self.watcher.sample_due <= self.up:
            self.sampled += len(names)
            fresh = {name: self.sampled * 10 + n for n, name in enumerate(sorted(names))}
            self.watcher.on_sample(sample(**fresh), 1.0, self.up)

    @rule()
    def turn(self):
        batch = batch_of(self.watcher, self.up)
        if batch is None:
            return
        self.sent.append(batch)
        assert batch.batch == len(self.sent)
        for kind, count in batch.lost.items():
            self.lost[kind] += count
        states = [event.number for event in batch.events if event.kind != "measured"]
        assert states == sorted(set(states))
        assert not states or batch.after == states[0] - 1
        # Every earlier event that it has not received was reported as lost.
        received = sum(event.kind != "measured" for event in [*self.received, *batch.events])
        assert received + self.lost["state"] == max([batch.after, *states])
        assert sum(map(size_of, batch.events)) <= BATCH_BYTES
        self.received += batch.events

    @precondition(lambda self: self.seen < len(self.sent))
    @rule(data=st.data())
    def read(self, data):
        self.seen = data.draw(st.integers(self.seen + 1, len(self.sent)))
        self.watcher.on_ack(self.seen, self.up)

    @invariant()
    def no_more_than_the_window_is_on_its_way(self):
        assert len(self.sent) - self.seen <= WINDOW

    def teardown(self):
        """A reader that reads all has every event that was not reported as lost, and all telemetry is
        counted."""
        for pause in (*[MIN_INTERVAL] * 60, LONGEST_REST):
            self.watcher.on_ack(len(self.sent), self.up)
            self.seen = len(self.sent)
            self.up += pause
            self.turn()
        states = sum(event.kind != "measured" for event in self.received)
        assert states + self.lost["state"] == self.stream.latest
        measured = sum(event.kind == "measured" for event in self.received)
        assert measured + self.lost["measured"] == self.sampled


OneWatcher.TestCase.settings = settings(derandomize=True, deadline=None, max_examples=150)
TestOneWatcher = OneWatcher.TestCase


@settings(derandomize=True, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 3)), max_size=80))
def test_a_reader_that_keeps_up_loses_no_event(steps):
    """The reader reads a batch in each step; a step has no more events than the log of a host may have."""
    stream, up, read = small(400, 64 << 10), 0.0, []
    watcher = watched(stream, Subscribe(LIFE, 0, 20.0))
    for count, devices in steps:
        append_lines(stream, count, "x" * 50)
        watcher.on_sample(sample(**{"abc"[n]: up for n in range(devices)}), 1.0, up)
        if batch := batch_of(watcher, up):
            assert "state" not in batch.lost
            read += [event.number for event in batch.events if event.kind == "logged"]
            watcher.on_ack(batch.batch, up)
        up += MIN_INTERVAL
    assert read == list(range(1, len(read) + 1))
    assert len(read) >= stream.latest - 40


# --- a host with the highest rate of events --------------------------------------------------------------


def flood(recorder, hops, number):
    """One event of each kind, with names and texts as in missions."""
    agent, now = "Patrol:one", recorder.now()
    stamp = recorder.hybrid_clock.tick(now)
    header = Transfer(agent, 3, number, 3, b"p" * 32, 7, 1436, stamp)
    hops.hops.append((HopStep.SENT, now, "charlie", header, "copter7", "surveyField"))
    hops.hops.append((HopStep.CONFIRMED, now, MarkMigrated(agent, 3, number, "charlie"), stamp))
    recorder.on_call_started(number, agent, "copter7", "surveyField")
    recorder.on_device_call("copter7", 3, number, "copter7.fc", "goTo")
    recorder.on_device_answer("copter7", 3, "")
    recorder.on_call_ended(number, "done")
    recorder.on_printed(
        "copter7", f"field {number} of the eastern slope is surveyed, battery 0.75, 12 targets"
    )


@pytest.mark.few(0)
def test_a_flood_of_events_is_delivered_at_a_megabyte_a_second_without_loss():
    """The watcher reads every batch at once, and a batch is sent 20 times a second at most: that is its
    bound."""
    clock = ManualClock()
    recorder = EventRecorder(clock)
    machine = SimpleNamespace(agents={}, itinerary=SimpleNamespace(current_target=lambda agent: None))
    team = SimpleNamespace(hosts=["alpha", "charlie"], coordinators=[SimpleNamespace(id="Patrol:one")])
    hops = MigrationEvents(recorder, machine, "alpha", team)
    recorder.set_detailed(on=True)
    recorder.refill(clock.monotonic())
    watcher, number, received, latched = watched(recorder.event_log), 0, 0, []
    assert BATCH_BYTES / MIN_INTERVAL < 1e6
    for tick in range(int(15 / MIN_INTERVAL)):
        for _ in range(6000 if tick == 0 else 300):
            number += 1
            flood(recorder, hops, number)
        if tick % 20 == 0:
            recorder.on_device_event(DeviceLatched("copter7.fc", "land", f"reason {tick}"))
        clock.advance(MIN_INTERVAL + 1e-6)
        recorder.refill(clock.monotonic())
        batch = batch_of(watcher, recorder.uptime)
        assert "state" not in batch.lost
        watcher.on_ack(batch.batch, recorder.uptime)
        received += len(batch.events)
        latched += [event for event in batch.events if event.kind == "latched"]
    assert received > 150_000
    assert len(latched) >= 12
    # The backlog is well within the kept events.
    assert recorder.event_log.latest - received < MAX_FREQUENT_EVENTS / 2
