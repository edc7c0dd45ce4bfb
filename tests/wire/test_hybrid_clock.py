"""Timestamps of events are monotonic, bounded, later than received timestamps, and sent in messages."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import msgpack

from lfield.errors import WireError
from lfield.host.events.event_log import stamped_event
from lfield.hybrid_clock import (
    MAX_AHEAD,
    MAX_TIMESTAMP,
    REPORT_INTERVAL,
    HybridClock,
    counter_of,
    milliseconds_of,
    timestamp_of,
)
from lfield.wire import codec
from lfield.wire.coordinator_messages import Terminated, Transfer, TransferAccepted, TransferRefused
from lfield.wire.events import Event, LinkUp
from lfield.wire.messages import Hello, Ping

YEAR_2024 = 1.7e9


class ReportedClock:
    """A hybrid clock whose wall clock is YEAR_2024 at monotonic time 0, and its reports."""

    def __init__(self) -> None:
        self.ahead: list[tuple[str, float]] = []
        self.jumps: list[float] = []
        self.clock = HybridClock(
            0.0, YEAR_2024, lambda host, seconds: self.ahead.append((host, seconds)), self.jumps.append
        )


def seconds(wall: float) -> int:
    return timestamp_of(int(wall * 1000.0), 0)


def test_a_timestamp_is_the_wall_clock_with_a_counter_within_a_millisecond() -> None:
    clock = HybridClock(0.0, YEAR_2024)
    first, second, third = clock.tick(5.0), clock.tick(5.0), clock.tick(5.25)
    assert (milliseconds_of(first), counter_of(first)) == (int((YEAR_2024 + 5.0) * 1000.0), 0)
    assert (milliseconds_of(second), counter_of(second)) == (milliseconds_of(first), 1)
    assert (milliseconds_of(third) - milliseconds_of(first), counter_of(third)) == (250, 0)


def test_a_full_counter_carries_into_the_milliseconds() -> None:
    clock = HybridClock(0.0, YEAR_2024)
    first = clock.tick(1.0)
    last = [clock.tick(1.0) for _ in range(1 << 16)][-1]
    assert (milliseconds_of(last), counter_of(last)) == (milliseconds_of(first) + 1, 0)


STEP = st.tuples(
    st.sampled_from(["tick", "merge", "set"]),
    st.floats(0.0, 10.0),
    st.integers(0, MAX_TIMESTAMP - 1) | st.integers(-1000, 1000).map(lambda s: seconds(YEAR_2024 + s)),
    st.floats(0.0, 4e9),
)


@settings(max_examples=200, deadline=None)
@given(st.lists(STEP, max_size=30))
def test_timestamps_never_go_back_and_no_host_moves_them_beyond_the_bound(
    steps: list[tuple[str, float, int, float]],
) -> None:
    clock, now, highest = HybridClock(0.0, YEAR_2024), 0.0, YEAR_2024
    for kind, elapsed, stamp, wall in steps:
        before, now = clock.last, now + elapsed
        highest = max(highest + elapsed, clock.wall_time(now))
        match kind:
            case "tick":
                assert clock.tick(now) == clock.last > before
            case "merge":
                clock.merge("a", stamp, now)
                assert clock.last > before
                if stamp <= seconds(clock.wall_time(now) + MAX_AHEAD - 0.002):
                    assert clock.last > stamp
            case _:
                clock.set_wall_time(now, wall)
                highest = max(highest, wall)
        assert milliseconds_of(clock.last) <= (highest + MAX_AHEAD) * 1000.0 + 2.0


def test_a_host_too_far_ahead_is_not_followed_and_reported_once() -> None:
    found = ReportedClock()
    clock = found.clock
    for now in (1.0, 2.0):
        clock.merge("beta", seconds(YEAR_2024 + now + MAX_AHEAD + 30.0), now)
        assert milliseconds_of(clock.last) == int((YEAR_2024 + now) * 1000.0)
    assert found.ahead == [("beta", pytest.approx(MAX_AHEAD + 30.0, abs=0.01))]
    # A clock slightly within the bound is not yet correct: the next excess is not reported again.
    clock.merge("beta", seconds(YEAR_2024 + 3.0 + MAX_AHEAD - 1.0), 3.0)
    clock.merge("beta", seconds(YEAR_2024 + 4.0 + MAX_AHEAD + 30.0), 4.0)
    assert len(found.ahead) == 1
    clock.merge("beta", seconds(YEAR_2024), 5.0)
    clock.merge("beta", seconds(YEAR_2024 + 6.0 + MAX_AHEAD + 30.0), 6.0)
    assert len(found.ahead) == 2


def test_a_host_within_the_bound_is_followed_and_not_reported() -> None:
    found = ReportedClock()
    stamp = seconds(YEAR_2024 + MAX_AHEAD - 1.0)
    found.clock.merge("beta", stamp, 1.0)
    assert found.clock.last > stamp
    assert found.ahead == []


def test_a_wall_clock_set_back_moves_no_timestamp_back_and_is_reported() -> None:
    found = ReportedClock()
    before = found.clock.tick(10.0)
    found.clock.set_wall_time(11.0, YEAR_2024 - 3600.0)
    assert found.clock.tick(12.0) == before + 1
    assert found.jumps == [pytest.approx(-3611.0)]


def test_a_wall_clock_that_jumps_repeatedly_is_reported_once_a_minute() -> None:
    found = ReportedClock()
    for n in range(601):
        now = n / 4.0
        found.clock.set_wall_time(now, YEAR_2024 + now + (500.0 if n % 2 else 0.0))
    assert len(found.jumps) == 601 / 4.0 // REPORT_INTERVAL + 1


@settings(max_examples=100, deadline=None)
@given(st.integers(0, MAX_TIMESTAMP))
def test_every_message_with_a_timestamp_is_restored(stamp: int) -> None:
    for message in (
        Ping(7, stamp),
        TransferAccepted("boss", 1, 2, 0.5, stamp),
        TransferRefused("boss", 1, 2, "Kind", "reason", stamp),
        Terminated("boss", 1, "done", "", "alpha", stamp),
        Hello("host", "alpha", 7, stamp=stamp),
    ):
        frame = codec.encode(message)
        assert codec.decode(frame[4], frame[5:]) == message
    header = Transfer("boss", 1, 2, 3, b"p" * 32, 9, 3, stamp)
    assert codec.decode_transfer((codec.encode_transfer(header, b"xyz") + b"xyz")[5:])[0] == header


@settings(max_examples=100, deadline=None)
@given(st.floats(0.0, 2.5e11), st.integers(0, MAX_TIMESTAMP))
def test_an_event_has_its_given_timestamp(at: float, stamp: int) -> None:
    event = stamped_event(3, at, 5.0, 0, LinkUp("beta"), stamp)
    read = msgpack.decode(msgpack.encode(event), type=Event)
    assert (read, read.stamp) == (event, stamp)


@pytest.mark.parametrize("stamp", [-1, MAX_TIMESTAMP + 1, 2**64 - 1, 1.5, "1", None, [1]])
def test_a_malformed_timestamp_is_refused(stamp: object) -> None:
    frame = codec.encode(Ping(7, stamp))  # type: ignore[arg-type]
    with pytest.raises(WireError) as refused:
        codec.decode(frame[4], frame[5:])
    assert refused.value.code == WireError.code
