"""Round trips of TIMESYNC: offset and delay, with unrelated messages between."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.clock import ManualClock
from lfield_mavlink.contact.link_health import MAX_OFFSETS, TimeSync
from lfield_mavlink.link.dialect import dialect


class Wall(ManualClock):
    """A wall clock that is 500 s ahead of the monotonic one."""

    def time(self) -> float:
        return self.now + 500.0


def make_sync():
    clock, sent = Wall(), []
    return TimeSync(clock, sent.append), clock, sent


def answer(question, vehicle):
    return dialect.MAVLink_timesync_message(int(vehicle * 1e9), question.ts1)


def test_round_trip_gives_offset_and_delay():
    sync, clock, sent = make_sync()
    sync.start_round_trip()
    clock.advance(0.1)
    # The vehicle's clock was at 20 s in the middle of the round trip.
    measured = sync.on_message(answer(sent[0], 20.0))
    assert measured.round_trip == pytest.approx(0.1)
    assert measured.offset == pytest.approx(20.0 - (1500.0 + 0.05), abs=1e-6)


def test_offset_is_that_of_the_shortest_recent_round_trip():
    sync, clock, sent = make_sync()
    measured = None
    for delay, skew in ((0.01, 0.0), (0.4, 0.2), (0.3, 0.1)):
        sync.start_round_trip()
        clock.advance(delay)
        measured = sync.on_message(answer(sent[-1], clock.now - delay / 2 + skew))
    assert measured.round_trip == pytest.approx(0.3)
    assert measured.offset == pytest.approx(-500.0, abs=1e-6)
    for _ in range(MAX_OFFSETS):
        sync.start_round_trip()
        clock.advance(0.3)
        measured = sync.on_message(answer(sent[-1], clock.now - 0.15 + 0.1))
    assert measured.offset == pytest.approx(-499.9, abs=1e-6)


def test_timesync_request_of_the_vehicle_is_answered():
    sync, clock, sent = make_sync()
    assert sync.on_message(dialect.MAVLink_timesync_message(0, 77)) is None
    assert (sent[0].tc1, sent[0].ts1) == (round(clock.now * 1e9), 77)


def test_foreign_late_and_repeated_timesync_answers_are_ignored():
    sync, clock, sent = make_sync()
    assert sync.on_message(dialect.MAVLink_timesync_message(5, 77)) is None
    sync.start_round_trip()
    clock.advance(0.1)
    assert sync.on_message(answer(sent[0], 1.0)) is not None
    assert sync.on_message(answer(sent[0], 1.0)) is None
    sync.start_round_trip()
    clock.advance(4.0)
    assert sync.on_message(answer(sent[1], 1.0)) is None


whole = st.integers(-(2**63), 2**63 - 1)


@given(st.lists(st.tuples(whole, whole), max_size=20))
def test_any_timesync_values_are_survived(messages):
    sync, _, sent = make_sync()
    sync.start_round_trip()
    for tc1, ts1 in messages:
        sync.on_message(dialect.MAVLink_timesync_message(tc1, ts1))
    assert len(sent) <= 1 + len(messages)
