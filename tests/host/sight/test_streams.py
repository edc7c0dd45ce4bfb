"""States are numbered without a gap and none is lost to whoever reads; telemetry is, and that is counted."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from lfield.clock import ManualClock
from lfield.host.events.event_log import FREQUENT, MAX_FREQUENT_EVENTS, EventLog, EventRing, size_of
from lfield.host.events.event_rate_limit import EventRateLimiter, RateLimit
from lfield.host.events.event_recorder import EventRecorder
from lfield.host.events.event_subscription import (
    BATCH_BYTES,
    FIRST_BATCH_BYTES,
    LONGEST_REST,
    MIN_INTERVAL,
    QUIET_INTERVAL,
    READ_TIMEOUT,
    EventSubscription,
)
from lfield.host.events.migration_events import HopStep, MigrationEvents
from lfield.replication.transfer.effects import MarkMigrated
from lfield.wire.codec import encode
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.events import (
    KINDS,
    TELEMETRY,
    DeviceLatched,
    DeviceTelemetry,
    EmergencyStopChanged,
    EventsDropped,
    LineLogged,
)
from lfield.wire.fields import MAX_TEXT
from lfield.wire.observer_messages import Status
from lfield.wire.subscription_messages import MAX_EVENTS, WINDOW, Subscribe

LIFE = 77
STATUS = Status("a", "a:1", 0.5, b"h" * 32, b"h" * 32, [], [], [], [], [])


def told(stream, count, text="x"):
    for _ in range(count):
        stream.append(LineLogged(text), 1.7e9, 1.0)


def small(most_events, most_bytes=4 << 20):
    """A stream that forgets soon what happens often."""
    return EventLog(EventRing(most_events, most_bytes))


def watched(stream, watch=None, up=0.0):
    return EventSubscription(stream, LIFE, watch or Subscribe(LIFE), up)


def batch_of(watcher, up):
    return watcher.next_batch(1.7e9 + up, up, lambda: STATUS)


def sample(**values):
    """Telemetry of devices, each a number."""
    return {name: (value, DeviceTelemetry(name, {"v": value}, 0.1)) for name, value in values.items()}


def numbers(batch):
    return [event.number for event in batch.events]


# --- the ring -------------------------------------------------------------------------------------------


@given(
    st.lists(st.integers(0, 300), max_size=60),
    st.integers(1, 20),
    st.integers(1, 2000),
)
def test_the_ring_has_the_newest_states_and_no_more_than_it_may(sizes, most_events, most_bytes):
    stream = small(most_events, most_bytes)
    for size in sizes:
        stream.append(LineLogged("x" * size), 1.0, 2.0)
    kept, total = stream.after(0, 10**6, 10**9)
    assert stream.latest == len(sizes)
    assert [event.number for event in kept] == list(range(stream.last_dropped + 1, stream.latest + 1))
    assert len(kept) <= most_events
    assert total == sum(map(size_of, kept))
    assert total <= most_bytes or len(kept) == 1


def test_what_is_told_has_its_cause_and_its_times():
    stream = EventLog()
    first = stream.append(LineLogged("stop"), 1.7e9, 5.0)
    stream.append(LineLogged("latched"), 1.7e9 + 1, 6.0, first)
    _, event = stream.after(0, 9, 999)[0]
    assert (event.number, event.at, event.up, event.cause) == (2, 1.7e9 + 1, 6.0, 1)


def test_what_happens_often_pushes_out_nothing_that_happens_seldom():
    stream = small(10)
    stream.append(EmergencyStopChanged("anna", "fire"), 1.0, 1.0)
    told(stream, 50)
    stream.append(DeviceLatched("a.fc", "land", "fire"), 1.0, 1.0)
    told(stream, 50)
    kept, _ = stream.after(0, 99, 9999)
    assert [event.number for event in kept] == [1, 52, *range(93, 103)]
    assert (stream.latest, stream.last_dropped) == (102, 92)
    # Of what happens often some can be left out.
    assert [event.number for event in stream.after(1, 99, 9999, 100)[0]] == [52, 101, 102]


def test_what_is_a_matter_of_safety_happens_seldom():
    often = {kind for kind, struct in KINDS.items() if struct in FREQUENT}
    assert often == {
        *("printed", "logged", "skipped", "left", "came", "hopped", "stayed"),
        *("began", "ended", "asked", "answered"),
    }
    seldom = KINDS.keys() - often - TELEMETRY
    assert {"stopped", "paused", "latched", "confirmed", "moving", "released", "unlinked"} <= seldom


# --- where a watcher begins -----------------------------------------------------------------------------


def test_who_knows_nothing_begins_now_with_a_snapshot():
    stream = EventLog()
    told(stream, 5)
    watcher = watched(stream, Subscribe())
    first = batch_of(watcher, 0.0)
    assert (first.batch, first.after, first.latest, first.events) == (1, 5, 5, [])
    assert first.snapshot is STATUS
    told(stream, 2)
    second = batch_of(watcher, MIN_INTERVAL)
    assert (numbers(second), second.after, second.snapshot) == ([6, 7], 5, None)


def test_who_was_here_goes_on_behind_what_it_has_heard():
    stream = EventLog()
    told(stream, 5)
    first = batch_of(watched(stream, Subscribe(LIFE, 3)), 0.0)
    assert (numbers(first), first.snapshot, first.lost) == ([4, 5], None, {})


def test_who_was_here_and_missed_nothing_is_answered_at_once():
    stream = EventLog()
    told(stream, 5)
    first = batch_of(watched(stream, Subscribe(LIFE, 5)), 0.0)
    assert (first.batch, first.events, first.after) == (1, [], 5)


def test_who_was_with_an_earlier_life_hears_all_of_this_one():
    stream = EventLog()
    told(stream, 3)
    watcher = watched(stream, Subscribe(LIFE - 1, 4000))
    first, second = batch_of(watcher, 0.0), batch_of(watcher, MIN_INTERVAL)
    assert (first.snapshot, first.after, first.events) == (STATUS, 0, [])
    assert numbers(second) == [1, 2, 3]


def test_who_has_heard_more_than_was_ever_told_hears_what_comes():
    stream = EventLog()
    told(stream, 3)
    watcher = watched(stream, Subscribe(LIFE, 2**62))
    assert batch_of(watcher, 0.0).after == 3


def test_what_fell_out_of_the_ring_is_counted_and_made_up_by_a_snapshot():
    stream = small(10)
    told(stream, 100)
    watcher = watched(stream, Subscribe(LIFE, 20))
    first, second = batch_of(watcher, 0.0), batch_of(watcher, MIN_INTERVAL)
    assert (first.lost, first.after, first.latest, first.events) == ({}, 20, 100, [])
    assert first.snapshot is STATUS
    assert (numbers(second), second.after, second.lost) == (list(range(91, 101)), 90, {"state": 70})


# --- when, and how much ---------------------------------------------------------------------------------


def test_batches_are_not_too_often_and_not_too_seldom():
    stream = EventLog()
    watcher = watched(stream)
    assert batch_of(watcher, 0.0) is not None
    assert watcher.due == pytest.approx(QUIET_INTERVAL)
    told(stream, 1)
    assert watcher.due == pytest.approx(MIN_INTERVAL)
    assert batch_of(watcher, MIN_INTERVAL / 2) is None
    assert numbers(batch_of(watcher, MIN_INTERVAL)) == [1]
    watcher.on_ack(2, MIN_INTERVAL)
    assert batch_of(watcher, MIN_INTERVAL + QUIET_INTERVAL / 2) is None
    assert batch_of(watcher, MIN_INTERVAL + QUIET_INTERVAL).events == []


def test_a_batch_is_small_however_much_has_happened():
    stream = EventLog()
    told(stream, 300, "x" * MAX_TEXT)
    watcher, seen, heard = watched(stream), 0.0, []
    while len(heard) < 300:
        batch = batch_of(watcher, seen)
        assert len(encode(batch)) < 64 << 10
        heard += numbers(batch)
        watcher.on_ack(batch.batch, seen)
        seen += MIN_INTERVAL
    assert heard == list(range(1, 301))


def test_a_batch_has_no_more_events_than_a_message_may():
    stream = small(4 * MAX_EVENTS)
    told(stream, 2 * MAX_EVENTS, "")
    assert 0 < len(batch_of(watched(stream), 0.0).events) <= MAX_EVENTS


def test_who_does_not_read_gets_no_more_than_the_window():
    stream = EventLog()
    watcher, up, sent = watched(stream), 0.0, 0
    while up < READ_TIMEOUT - 1.0:
        told(stream, 10, "x" * 2000)
        sent += batch_of(watcher, up) is not None
        up += MIN_INTERVAL
    assert sent == WINDOW
    assert not watcher.has_gone(up)
    assert watcher.has_gone(READ_TIMEOUT + 1.0)
    assert watcher.due <= READ_TIMEOUT


def test_who_is_let_go_is_told_what_it_has_lost_until_then():
    stream = EventLog()
    watcher, up, sent = watched(stream, Subscribe(LIFE, 0, 20.0)), 0.0, []
    while not watcher.has_gone(up):
        watcher.on_sample(sample(fc=up), 1.0, up)
        sent += filter(None, [batch_of(watcher, up)])
        up += MIN_INTERVAL
    told(stream, 3)
    last = watcher.final_batch(1.7e9 + up, up)
    assert (last.batch, last.events, last.after, last.latest) == (WINDOW + 1, [], 0, 3)
    # What is owed still is lost as well.
    lost = sum(batch.lost.get("measured", 0) for batch in [*sent, last])
    assert lost + sum(len(b.events) for b in sent) == pytest.approx(up / MIN_INTERVAL, abs=2)


def test_who_reads_again_goes_on_without_a_gap():
    stream = EventLog()
    watcher = watched(stream)
    up, heard = 0.0, []
    for _ in range(30):
        told(stream, 1)
        if batch := batch_of(watcher, up):
            heard += numbers(batch)
        up += MIN_INTERVAL
    watcher.on_ack(WINDOW, up)
    heard += numbers(batch_of(watcher, up))
    assert heard == list(range(1, 31))


def test_only_what_was_sent_can_be_seen():
    stream = EventLog()
    watcher = watched(stream)
    for n in range(WINDOW):
        told(stream, 1)
        assert batch_of(watcher, n * MIN_INTERVAL)
    watcher.on_ack(WINDOW + 1000, 1.0)
    told(stream, 1)
    assert batch_of(watcher, 1.0) is None
    watcher.on_ack(1, 1.0)
    assert batch_of(watcher, 1.0) is not None


# --- who falls behind -----------------------------------------------------------------------------------


class Chatty:
    """A host that keeps 1000 lines, and on which 20 are printed from one batch to the next."""

    def __init__(self):
        self.stream, self.up = small(1000), 0.0
        told(self.stream, 2000)

    def ask(self, watch):
        self.watcher = watched(self.stream, watch, self.up)

    def go_on(self, seconds, *, reads=True, lines=20):
        """What is sent meanwhile."""
        sent = []
        for _ in range(round(seconds / MIN_INTERVAL)):
            told(self.stream, lines)
            if batch := batch_of(self.watcher, self.up):
                sent.append(batch)
                if reads:
                    self.watcher.on_ack(batch.batch, self.up)
            self.up += MIN_INTERVAL + 1e-6
        return sent


def losses(batches):
    return [batch.lost["state"] for batch in batches if "state" in batch.lost]


def states(batches):
    return [number for batch in batches for number in numbers(batch)]


def test_who_was_away_too_long_hears_of_one_loss_and_then_what_there_is_without_another():
    host = Chatty()
    host.ask(Subscribe(LIFE, 3))
    sent = host.go_on(5.0)
    (lost,) = losses(sent)
    assert [batch.batch for batch in sent if batch.snapshot] == [1]
    assert states(sent) == list(range(3 + lost + 1, host.stream.latest + 1))


def test_who_stops_reading_hears_of_one_loss_and_then_what_is_live():
    host = Chatty()
    host.ask(Subscribe())
    assert losses(host.go_on(1.0)) == []
    unread = host.go_on(READ_TIMEOUT - 1.0, reads=False)
    assert len(unread) == WINDOW
    stopped = host.stream.latest
    host.watcher.on_ack(unread[-1].batch, host.up)
    sent = host.go_on(5.0)
    assert len(losses(sent)) == 1
    assert sum(batch.snapshot is not None for batch in sent) == 1
    # At once: what was told while it did not read it does not wait for.
    heard = states(sent)
    assert stopped < heard[0] <= stopped + 3 * 20
    assert heard == list(range(heard[0], host.stream.latest + 1))
    assert losses(sent) == [heard[0] - 1 - states(unread)[-1]]


def test_who_stops_reading_misses_nothing_that_happens_seldom():
    host = Chatty()
    host.ask(Subscribe())
    unread = host.go_on(10.0, reads=False)
    seldom = [
        EmergencyStopChanged("anna", "fire"),
        DeviceLatched("a.fc", "land", "fire"),
        EmergencyStopChanged("anna", "", True),
    ]
    for what in seldom:
        host.stream.append(what, 1.7e9, host.up)
        unread += host.go_on(20.0, reads=False)
    host.watcher.on_ack(unread[-1].batch, host.up)
    sent = host.go_on(2.0)
    heard = [event.what for batch in sent for event in batch.events]
    assert [what for what in heard if not isinstance(what, LineLogged)] == seldom
    # Which numbers are missing is told as exactly as by their absence.
    missing = set(range(states(unread)[-1] + 1, host.stream.latest + 1)) - set(states(sent))
    assert sum(losses(sent)) == len(missing)
    assert states(sent) == sorted(states(sent))


@pytest.mark.parametrize("lines", [15, 60, 200])
def test_who_reads_too_slowly_loses_much_at_once_and_hears_what_is_new(lines):
    """It reads a batch in a second; in the last case more is forgotten meanwhile than a batch has."""
    host = Chatty()
    host.ask(Subscribe())
    sent = []
    for second in range(50):
        sent += host.go_on(1.0, reads=False, lines=lines)
        host.watcher.on_ack(second + 1, host.up)
        host.stream.append(EmergencyStopChanged("anna", "fire"), 1.7e9, host.up)
    lost = losses(sent)
    heard = [event for batch in sent for event in batch.events]
    assert (lost == []) == (lines == 15)
    # Of two batches one has states, and each of the losses is large.
    assert len(lost) <= len(sent) // 2
    assert all(missing > 100 for missing in lost)
    assert sum(isinstance(event.what, LineLogged) for event in heard) > 5000
    assert sum(isinstance(event.what, EmergencyStopChanged) for event in heard) >= 38


# --- telemetry ------------------------------------------------------------------------------------------


def test_telemetry_comes_at_the_rate_that_was_asked_for_and_only_when_it_changes():
    watcher = watched(EventLog(), Subscribe(LIFE, 0, 5.0))
    heard = []
    for step in range(101):
        up = step * 0.01
        if watcher.sample_due <= up + 1e-9:
            watcher.on_sample(sample(fc=min(step, 50)), 1.0, up)
        if batch := batch_of(watcher, up):
            heard += [event.what.values["v"] for event in batch.events]
            watcher.on_ack(batch.batch, up)
    assert heard == [0, 20, 40, 50]


def test_who_wants_no_telemetry_gets_none():
    watcher = watched(EventLog())
    assert watcher.sample_due is None
    watcher.on_sample(sample(fc=1), 1.0, 0.0)
    assert batch_of(watcher, 0.0).events == []


def test_of_telemetry_only_the_newest_is_sent_and_the_rest_is_counted():
    watcher = watched(EventLog(), Subscribe(LIFE, 0, 20.0))
    up = 0.0
    for n in range(4):
        watcher.on_sample(sample(fc=n, gps=0), 1.0, up)
        if n == 0:
            batch_of(watcher, up)
            watcher.on_ack(1, up + 0.01)
        up += 0.05
    batch = batch_of(watcher, up)
    assert [event.what.values["v"] for event in batch.events] == [3]
    assert batch.lost == {"measured": 2}


def telemetry_of(trip, seconds=60.0):
    """How often a watcher is sent telemetry that changes all the time: it sees a batch `trip(batch)` seconds
    after that was sent."""
    watcher, up, sent, under_way = watched(EventLog(), Subscribe(LIFE, 0, 20.0)), 0.0, 0, []
    while up < seconds:
        watcher.on_sample(sample(fc=up), 1.0, up)
        if batch := batch_of(watcher, up):
            sent += bool(batch.events)
            under_way.append((up + trip(batch), batch.batch))
        up += 0.01
        for at, number in under_way:
            if at <= up:
                watcher.on_ack(number, up)
        under_way = [(at, number) for at, number in under_way if at > up]
    return sent / seconds


def test_telemetry_has_its_rate_where_a_path_is_fast_and_a_small_part_of_one_that_is_slow():
    assert telemetry_of(lambda batch: 0.001) == pytest.approx(20.0, rel=0.15)
    # One batch at a time is under way, and is seen a step of 0.01 s late.
    assert telemetry_of(lambda batch: 0.2) == pytest.approx(1 / (0.2 + 8 * 0.01), rel=0.2)
    # On a slow radio one with telemetry takes 0.2 s more than one without: an eighth of the time.
    slow = telemetry_of(lambda batch: 0.3 if batch.events else 0.1)
    assert slow == pytest.approx(1 / (0.3 + 8 * 0.2), rel=0.2)


def test_states_go_before_telemetry():
    stream = EventLog()
    watcher = watched(stream, Subscribe(LIFE, 0, 20.0))
    told(stream, 60, "x" * 2000)
    watcher.on_sample(sample(fc=1), 1.0, 0.0)
    first, up = batch_of(watcher, 0.0), 0.0
    assert {event.kind for event in first.events} == {"logged"}
    kinds, batch = [], first
    while "measured" not in kinds:
        watcher.on_ack(batch.batch, up + 0.001)
        up += MIN_INTERVAL
        batch = batch_of(watcher, up)
        kinds += [event.kind for event in batch.events]
    assert kinds.count("logged") == 60 - len(first.events)


def test_the_first_batches_are_small_and_grow_with_the_acknowledgements_of_a_path_that_is_not_slow():
    stream, up, sizes = EventLog(), 0.0, []
    told(stream, 400, "x" * 500)
    watcher = watched(stream, Subscribe(LIFE, 0))
    for _ in range(8):
        batch = batch_of(watcher, up)
        sizes.append(sum(map(size_of, batch.events)))
        watcher.on_ack(batch.batch, up + 0.001)
        up += MIN_INTERVAL
    assert sizes[0] <= FIRST_BATCH_BYTES
    assert 0.8 * BATCH_BYTES <= max(sizes) <= BATCH_BYTES


# --- all of it ------------------------------------------------------------------------------------------


class OneWatcher(RuleBasedStateMachine):
    """A watcher that reads as it likes, of a host on which things happen."""

    def __init__(self):
        super().__init__()
        self.stream = EventLog(EventRing(40, 4000), EventRing(5, 4000))
        self.up, self.sent, self.seen = 0.0, [], 0
        self.heard, self.lost, self.sampled = [], {"state": 0, "measured": 0}, 0
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
        # Whatever it has not heard up to there it was told to be lost.
        heard = sum(event.kind != "measured" for event in [*self.heard, *batch.events])
        assert heard + self.lost["state"] == max([batch.after, *states])
        assert sum(map(size_of, batch.events)) <= BATCH_BYTES
        self.heard += batch.events

    @precondition(lambda self: self.seen < len(self.sent))
    @rule(data=st.data())
    def read(self, data):
        self.seen = data.draw(st.integers(self.seen + 1, len(self.sent)))
        self.watcher.on_ack(self.seen, self.up)

    @invariant()
    def no_more_than_the_window_is_on_its_way(self):
        assert len(self.sent) - self.seen <= WINDOW

    def teardown(self):
        """Whoever reads at last has every state that was not told to be lost, and all that was measured."""
        for pause in (*[MIN_INTERVAL] * 60, LONGEST_REST):
            self.watcher.on_ack(len(self.sent), self.up)
            self.seen = len(self.sent)
            self.up += pause
            self.turn()
        states = sum(event.kind != "measured" for event in self.heard)
        assert states + self.lost["state"] == self.stream.latest
        measured = sum(event.kind == "measured" for event in self.heard)
        assert measured + self.lost["measured"] == self.sampled


OneWatcher.TestCase.settings = settings(derandomize=True, deadline=None, max_examples=150)
TestOneWatcher = OneWatcher.TestCase


@settings(derandomize=True, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 3)), max_size=80))
def test_who_reads_all_the_time_loses_no_state(steps):
    """It reads one batch in each step, and no more happens in one than the ring of a host may have."""
    stream, up, read = small(400, 64 << 10), 0.0, []
    watcher = watched(stream, Subscribe(LIFE, 0, 20.0))
    for count, devices in steps:
        told(stream, count, "x" * 50)
        watcher.on_sample(sample(**{"abc"[n]: up for n in range(devices)}), 1.0, up)
        if batch := batch_of(watcher, up):
            assert "state" not in batch.lost
            read += [event.number for event in batch.events if event.kind == "logged"]
            watcher.on_ack(batch.batch, up)
        up += MIN_INTERVAL
    assert read == list(range(1, len(read) + 1))
    assert len(read) >= stream.latest - 40


# --- what may happen too often --------------------------------------------------------------------------


def budget_of(burst, rate, unwatched=None):
    """A budget, and what it tells."""
    said = []
    return EventRateLimiter(said.append, RateLimit(burst, rate), unwatched), said


def test_a_budget_tells_all_that_happens_at_a_usual_rate():
    budget, said = budget_of(20.0, 10.0)
    for n in range(1000):
        budget.refill(n * 0.1)
        assert budget.try_acquire("left")
    budget.report_dropped(1000.0)
    assert said == []


def test_beyond_its_rate_it_counts():
    (budget, said), taken = budget_of(20.0, 10.0), 0
    for n in range(10_000):
        budget.refill(n * 0.001)
        taken += budget.try_acquire("left")
    assert taken == pytest.approx(20 + 100, abs=1)
    budget.report_dropped(10.0)
    assert sum(skipped.count for skipped in said) == 10_000 - taken
    count = len(said)
    budget.report_dropped(12.0)
    assert len(said) == count


def test_what_was_skipped_is_said_before_the_next_that_is_told():
    budget, said = budget_of(2.0, 10.0)
    assert [budget.try_acquire("printed") for _ in range(5)] == [True, True, False, False, False]
    assert said == []
    budget.refill(1.0)
    assert budget.try_acquire("printed")
    assert said == [EventsDropped("printed", 3)]


def test_whoever_asks_at_once_is_told_at_once_and_else_once_a_second():
    budget, said = budget_of(1.0, 10.0)
    for _ in range(2):
        budget.try_acquire("left")
        budget.try_acquire("left")
        budget.report_dropped(5.0)
    assert [skipped.count for skipped in said] == [1]
    budget.report_dropped(5.0, at_once=True)
    assert [skipped.count for skipped in said] == [1, 2]


def test_more_is_told_while_somebody_watches():
    budget, _ = budget_of(9.0, 90.0, RateLimit(2.0, 20.0))
    assert sum(budget.try_acquire("left") for _ in range(20)) == 2
    budget.set_observed(on=True)
    assert sum(budget.try_acquire("left") for _ in range(20)) == 9
    # Whoever comes again while it is watched has no second burst of it.
    budget.set_observed(on=True)
    assert not budget.try_acquire("left")
    budget.set_observed(on=False)
    assert sum(budget.try_acquire("left") for _ in range(20)) == 2


def test_what_is_long_counts_for_more():
    budget, _ = budget_of(10.0, 0.0)
    assert [budget.try_acquire("printed", 6.0) for _ in range(3)] == [True, True, False]


@settings(derandomize=True, deadline=None)
@given(
    st.lists(st.tuples(st.sampled_from(["left", "came"]), st.floats(0.0, 3.0)), max_size=60),
    st.floats(0.1, 30.0),
)
def test_whatever_was_not_told_is_counted_once(asked, rate):
    (budget, said), now = budget_of(2.0, rate), 0.0
    taken = 0
    for kind, pause in asked:
        now += pause
        budget.refill(now)
        taken += budget.try_acquire(kind)
        budget.report_dropped(now)
    budget.report_dropped(now, at_once=True)
    assert taken + sum(skipped.count for skipped in said) == len(asked)
    assert taken <= 2.0 + rate * now + 1e-6


def test_a_clock_that_stands_still_fills_nothing():
    budget, _ = budget_of(2.0, 10.0)
    budget.refill(5.0)
    assert [budget.try_acquire("left") for _ in range(3)] == [True, True, False]
    budget.refill(5.0)
    assert not budget.try_acquire("left")


# --- a host on which everything happens as often as it can ------------------------------------------------


def flood(teller, hops, number):
    """One of each, with names and texts as missions have them."""
    agent, now = "Patrol:one", teller.now()
    stamp = teller.hybrid_clock.tick(now)
    header = Transfer(agent, 3, number, 3, b"p" * 32, 7, 1436, stamp)
    hops.hops.append((HopStep.SENT, now, "charlie", header, "copter7", "surveyField"))
    hops.hops.append((HopStep.CONFIRMED, now, MarkMigrated(agent, 3, number, "charlie"), stamp))
    teller.on_call_started(number, agent, "copter7", "surveyField")
    teller.on_device_call("copter7", 3, number, "copter7.fc", "goTo")
    teller.on_device_answer("copter7", 3, "")
    teller.on_call_ended(number, "done")
    teller.on_printed("copter7", f"field {number} of the eastern slope is surveyed, battery 0.75, 12 targets")


def test_a_flood_of_everything_pushes_nothing_out_before_a_watcher_has_it_at_a_megabyte_a_second():
    """It reads every batch at once, and a batch comes 20 times a second at most: that is its bound."""
    clock = ManualClock()
    teller = EventRecorder(clock)
    machine = SimpleNamespace(agents={}, itinerary=SimpleNamespace(current_target=lambda agent: None))
    team = SimpleNamespace(hosts=["alpha", "charlie"], coordinators=[SimpleNamespace(id="Patrol:one")])
    hops = MigrationEvents(teller, machine, "alpha", team)
    teller.set_detailed(on=True)
    teller.refill(clock.monotonic())
    watcher, number, heard, latched = watched(teller.event_log), 0, 0, []
    assert BATCH_BYTES / MIN_INTERVAL < 1e6
    for tick in range(int(15 / MIN_INTERVAL)):
        for _ in range(6000 if tick == 0 else 300):
            number += 1
            flood(teller, hops, number)
        if tick % 20 == 0:
            teller.on_device_event(DeviceLatched("copter7.fc", "land", f"reason {tick}"))
        clock.advance(MIN_INTERVAL + 1e-6)
        teller.refill(clock.monotonic())
        batch = batch_of(watcher, teller.up)
        assert "state" not in batch.lost
        watcher.on_ack(batch.batch, teller.up)
        heard += len(batch.events)
        latched += [event for event in batch.events if event.kind == "latched"]
    assert heard > 150_000
    assert len(latched) >= 12
    # What it is behind is well within what is kept.
    assert teller.event_log.latest - heard < MAX_FREQUENT_EVENTS / 2
