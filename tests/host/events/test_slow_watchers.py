"""Watchers that read slowly or seldom, and telemetry of devices."""

from __future__ import annotations

import pytest
from watched_streams import LIFE, append_lines, batch_of, sample, small, states, watched

from lfield.host.events.event_log import EventLog, size_of
from lfield.host.events.event_subscription import BATCH_BYTES, FIRST_BATCH_BYTES, MIN_INTERVAL, READ_TIMEOUT
from lfield.wire.events import DeviceLatched, EmergencyStopChanged, LineLogged
from lfield.wire.subscription_messages import WINDOW, Subscribe

# --- slow readers ---------------------------------------------------------------------------------------


class FastPrinter:
    """A host that keeps 1000 lines, and prints 20 between two batches."""

    def __init__(self):
        self.stream, self.up = small(1000), 0.0
        append_lines(self.stream, 2000)

    def ask(self, watch):
        self.watcher = watched(self.stream, watch, self.up)

    def run(self, seconds, *, reads=True, lines=20):
        """Run, and return the sent batches."""
        sent = []
        for _ in range(round(seconds / MIN_INTERVAL)):
            append_lines(self.stream, lines)
            if batch := batch_of(self.watcher, self.up):
                sent.append(batch)
                if reads:
                    self.watcher.on_ack(batch.batch, self.up)
            self.up += MIN_INTERVAL + 1e-6
        return sent


def losses(batches):
    return [batch.lost["state"] for batch in batches if "state" in batch.lost]


def test_a_reader_that_was_away_gets_one_loss_and_then_all_events():
    host = FastPrinter()
    host.ask(Subscribe(LIFE, 3))
    sent = host.run(5.0)
    (lost,) = losses(sent)
    assert [batch.batch for batch in sent if batch.snapshot] == [1]
    assert states(sent) == list(range(3 + lost + 1, host.stream.latest + 1))


def test_a_reader_that_paused_gets_one_loss_and_then_new_events():
    host = FastPrinter()
    host.ask(Subscribe())
    assert losses(host.run(1.0)) == []
    unread = host.run(READ_TIMEOUT - 1.0, reads=False)
    assert len(unread) == WINDOW
    stopped = host.stream.latest
    host.watcher.on_ack(unread[-1].batch, host.up)
    sent = host.run(5.0)
    assert len(losses(sent)) == 1
    assert sum(batch.snapshot is not None for batch in sent) == 1
    # Immediate: the watcher does not wait for its unread events.
    received = states(sent)
    assert stopped < received[0] <= stopped + 3 * 20
    assert received == list(range(received[0], host.stream.latest + 1))
    assert losses(sent) == [received[0] - 1 - states(unread)[-1]]


def test_a_reader_that_paused_misses_no_rare_event():
    host = FastPrinter()
    host.ask(Subscribe())
    unread = host.run(10.0, reads=False)
    seldom = [
        EmergencyStopChanged("anna", "fire"),
        DeviceLatched("a.fc", "land", "fire"),
        EmergencyStopChanged("anna", "", True),
    ]
    for what in seldom:
        host.stream.append(what, 1.7e9, host.up)
        unread += host.run(20.0, reads=False)
    host.watcher.on_ack(unread[-1].batch, host.up)
    sent = host.run(2.0)
    received = [event.what for batch in sent for event in batch.events]
    assert [what for what in received if not isinstance(what, LineLogged)] == seldom
    # The number of missing events is exact.
    missing = set(range(states(unread)[-1] + 1, host.stream.latest + 1)) - set(states(sent))
    assert sum(losses(sent)) == len(missing)
    assert states(sent) == sorted(states(sent))


@pytest.mark.few(0)
@pytest.mark.parametrize("lines", [15, 60, 200])
def test_a_slow_reader_loses_many_events_at_once_and_gets_new_ones(lines):
    """The watcher reads one batch per second; in the last case, more events are dropped than a batch has."""
    host = FastPrinter()
    host.ask(Subscribe())
    sent = []
    for second in range(50):
        sent += host.run(1.0, reads=False, lines=lines)
        host.watcher.on_ack(second + 1, host.up)
        host.stream.append(EmergencyStopChanged("anna", "fire"), 1.7e9, host.up)
    lost = losses(sent)
    received = [event for batch in sent for event in batch.events]
    assert (lost == []) == (lines == 15)
    # One of two batches has events, and each of the losses is large.
    assert len(lost) <= len(sent) // 2
    assert all(missing > 100 for missing in lost)
    assert sum(isinstance(event.what, LineLogged) for event in received) > 5000
    assert sum(isinstance(event.what, EmergencyStopChanged) for event in received) >= 38


# --- telemetry ------------------------------------------------------------------------------------------


def test_telemetry_is_sent_at_the_requested_rate_and_only_if_it_changes():
    watcher = watched(EventLog(), Subscribe(LIFE, 0, 5.0))
    received = []
    for step in range(101):
        up = step * 0.01
        if watcher.sample_due <= up + 1e-9:
            watcher.on_sample(sample(fc=min(step, 50)), 1.0, up)
        if batch := batch_of(watcher, up):
            received += [event.what.values["v"] for event in batch.events]
            watcher.on_ack(batch.batch, up)
    assert received == [0, 20, 40, 50]


def test_a_subscription_without_telemetry_gets_none():
    watcher = watched(EventLog())
    assert watcher.sample_due is None
    watcher.on_sample(sample(fc=1), 1.0, 0.0)
    assert batch_of(watcher, 0.0).events == []


def test_only_the_newest_telemetry_is_sent_and_the_rest_is_counted():
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
    """Rate of telemetry that changes all the time, for a watcher that acknowledges a batch after
    `trip(batch)` s."""
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


def test_telemetry_has_its_rate_on_a_fast_path_and_a_share_of_a_slow_one():
    assert telemetry_of(lambda batch: 0.001) == pytest.approx(20.0, rel=0.15)
    # One batch at a time is in flight, and is acknowledged a step of 0.01 s late.
    assert telemetry_of(lambda batch: 0.2) == pytest.approx(1 / (0.2 + 8 * 0.01), rel=0.2)
    # On a slow radio a batch with telemetry takes 0.2 s more than one without: an eighth of the time.
    slow = telemetry_of(lambda batch: 0.3 if batch.events else 0.1)
    assert slow == pytest.approx(1 / (0.3 + 8 * 0.2), rel=0.2)


def test_events_precede_telemetry():
    stream = EventLog()
    watcher = watched(stream, Subscribe(LIFE, 0, 20.0))
    append_lines(stream, 60, "x" * 2000)
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


def test_batches_start_small_and_grow_with_acknowledgements():
    stream, up, sizes = EventLog(), 0.0, []
    append_lines(stream, 400, "x" * 500)
    watcher = watched(stream, Subscribe(LIFE, 0))
    for _ in range(8):
        batch = batch_of(watcher, up)
        sizes.append(sum(map(size_of, batch.events)))
        watcher.on_ack(batch.batch, up + 0.001)
        up += MIN_INTERVAL
    assert sizes[0] <= FIRST_BATCH_BYTES
    assert 0.8 * BATCH_BYTES <= max(sizes) <= BATCH_BYTES
