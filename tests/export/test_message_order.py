"""Live messages are recorded in the order of their log times; the reader of the package `mcap` checks it."""

from __future__ import annotations

import io
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from sample_flight import FRAMED, START, Team

from lfield.cli.event_recording import EventRecording
from lfield.clock import ManualClock
from lfield.export.channels import ChannelMessage
from lfield.export.message_order import MAX_WAITING, WINDOW, MessageOrder
from lfield.export.message_stream import LINES
from lfield.hybrid_clock import MAX_AHEAD
from lfield.wire import events


def message(time: float) -> ChannelMessage:
    return ChannelMessage(LINES, time, {})


def log_times(order: MessageOrder, *, everything: bool = True) -> list[float]:
    return [at for _, at in order.drain(everything=everything)]


@given(st.lists(st.tuples(st.floats(0.0, WINDOW / 4.0), st.floats(0.0, WINDOW)), max_size=60))
def test_messages_late_within_the_window_are_ordered_by_time(steps) -> None:
    clock, drained = ManualClock(START), []
    order = MessageOrder(clock)
    for pause, late in steps:
        clock.advance(pause)
        order.add(message(clock.now - late))
        drained += list(order.drain())
    drained += list(order.drain(everything=True))
    assert len(drained) == len(steps)
    assert [at for _, at in drained] == sorted(each.time for each, _ in drained)
    assert all(at == each.time for each, at in drained)


@given(st.lists(st.tuples(st.floats(0.0, 5.0), st.floats(-1e9, 1e9)), max_size=60))
def test_log_times_never_decrease_for_any_host_clocks(steps) -> None:
    clock, drained = ManualClock(START), []
    order = MessageOrder(clock)
    for pause, ahead in steps:
        clock.advance(pause)
        order.add(message(clock.now + ahead))
        drained += log_times(order, everything=False)
    drained += log_times(order)
    assert len(drained) == len(steps)
    assert all(before <= after for before, after in pairwise(drained))


def test_message_waits_at_most_the_window_for_earlier_messages() -> None:
    clock = ManualClock(START)
    order = MessageOrder(clock)
    order.add(message(START + 0.2))
    clock.advance(WINDOW / 2.0)
    order.add(message(START + 0.1))
    assert log_times(order, everything=False) == []
    clock.advance(WINDOW / 2.0)
    assert log_times(order, everything=False) == [START + 0.1, START + 0.2]


def test_message_of_a_wrong_clock_does_not_delay_later_messages() -> None:
    clock = ManualClock(START)
    order = MessageOrder(clock)
    order.add(message(START))
    order.add(message(START + 1e8))
    order.add(message(START + 0.5))
    assert log_times(order) == [START, START, START + 0.5]


@pytest.mark.parametrize("wall", [0.0, START + 1e8])
def test_wrong_wall_clock_of_the_operator_does_not_change_log_times(
    wall: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = ManualClock(START)
    monkeypatch.setattr(clock, "time", lambda: wall)
    order = MessageOrder(clock)
    times = [START, START + 2.0 * MAX_AHEAD, START + 2.0 * MAX_AHEAD + 1.0]
    for time in times:
        clock.advance(max(0.0, time - clock.now))
        order.add(message(time))
    assert log_times(order) == times


def test_message_buffer_is_bounded() -> None:
    order = MessageOrder(ManualClock(START))
    for number in range(MAX_WAITING):
        order.add(message(START + number))
    assert not order.is_full
    assert log_times(order, everything=False) == []
    order.add(message(START))
    assert order.is_full
    assert log_times(order, everything=False)[:3] == [START, START, START + 1.0]
    assert not order.is_full


def test_live_recording_orders_events_of_several_hosts(tmp_path) -> None:
    clock, team = ManualClock(START), Team()
    recording = EventRecording(tmp_path / "flight.mcap", FRAMED, clock)
    times = [0.0, 0.5, 0.25, 0.375, 1.75, 1.5, 5.0, 2.0, 5.125, 8.0, 4.0]
    for number, time in enumerate(times):
        clock.now = max(clock.now, START + time)
        recording.add(team.event(time, "ab"[number % 2], events.LinkUp("c")))
        recording.flush()
    recording.finish()
    recording.close()
    reader = make_reader(io.BytesIO((tmp_path / "flight.mcap").read_bytes()), validate_crcs=True)
    found = [each for _, _, each in reader.iter_messages("/events", log_time_order=False)]
    published = [round(each.publish_time / 1e9 - START, 3) for each in found]
    assert published == [0.0, 0.25, 0.375, 0.5, 1.5, 1.75, 2.0, 5.0, 5.125, 4.0, 8.0]
    # The last event but one arrived after the window, so its log time is later than its time.
    assert [round(each.log_time / 1e9 - START, 3) for each in found] == [*published[:-2], 5.125, 8.0]
