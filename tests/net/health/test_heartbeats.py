"""When heartbeats are due, what their answers measure, and how long a link may be silent."""

import pytest

from lfield.net.health.link_heartbeats import (
    IDLE_LOST_AFTER,
    IDLE_PING_EVERY,
    LOST_AFTER,
    MAX_PENDING,
    MAX_SILENCE,
    PING_EVERY,
    SUSPECT_AFTER,
    Heartbeats,
)


def linked(*, first: bool = True) -> Heartbeats:
    beats = Heartbeats(first=first)
    beats.on_link_made(0.0)
    return beats


def measured(sample: float, count: int = 50) -> Heartbeats:
    """One heartbeat is sent each second, and answered after `sample` seconds."""
    beats = linked()
    for second in range(count):
        beats.on_pong(beats.send(float(second)), second + sample)
    return beats


def test_each_answer_counts_once_for_its_own_heartbeat():
    beats = linked()
    first, second = beats.send(1.0), beats.send(2.0)
    beats.on_pong(second, 2.1)
    assert beats.round_trip.last == pytest.approx(0.1)
    beats.on_pong(first, 2.5)
    assert beats.round_trip.last == pytest.approx(1.5)
    for token in (first, second, 0, 99):
        beats.on_pong(token, 9.0)
    assert beats.round_trip.last == pytest.approx(1.5)


def test_the_number_of_unanswered_heartbeats_kept_is_bounded():
    beats = linked()
    tokens = [beats.send(float(n)) for n in range(1000)]
    beats.on_pong(tokens[-MAX_PENDING - 1], 1000.0)
    assert beats.round_trip.mean is None
    beats.on_pong(tokens[-MAX_PENDING], 1000.0)
    assert beats.round_trip.mean == MAX_PENDING


def test_an_answer_to_a_heartbeat_of_an_earlier_link_is_ignored():
    beats = linked()
    token = beats.send(1.0)
    beats.on_link_made(20.0)
    beats.on_pong(token, 20.1)
    assert beats.round_trip.mean is None


def test_two_ends_send_alternately_and_both_measure():
    """A link without other messages has one heartbeat a second, as when only one end sent."""
    here, there = linked(), linked(first=False)
    received_at, sent = {here: 0.0, there: 0.0}, {here: 0, there: 0}
    for tick in range(1, 601):
        now = tick / 10
        # Each end checks once a second, the second end 0.3 s after the first.
        for end, other, phase in ((here, there, 0), (there, here, 3)):
            if tick % 10 == phase and end.is_due(now, now - received_at[end]):
                token = end.send(now)
                other.on_ping()
                received_at[other] = now
                end.on_pong(token, now + 0.05)
                received_at[end] = now + 0.05
                sent[end] += 1
    assert sum(sent.values()) <= 66
    assert min(sent.values()) >= 25
    assert [end.round_trip.mean for end in (here, there)] == pytest.approx([0.05, 0.05])


def test_a_link_with_other_messages_is_measured_every_five_seconds():
    beats = linked()
    assert not beats.is_due(4.9, 0.1)
    assert beats.is_due(5.0, 0.1)
    beats.send(5.0)
    assert not beats.is_due(9.9, 0.1)


@pytest.mark.parametrize("beats", [measured(0.001), measured(0.2)], ids=["LAN", "radio"])
def test_on_a_calm_path_a_link_is_lost_after_three_seconds(beats):
    assert (beats.suspect_after(50.0), beats.lost_after(50.0)) == (SUSPECT_AFTER, LOST_AFTER)


def test_late_answers_extend_the_permitted_silence():
    beats = measured(0.05)
    beats.on_pong(beats.send(50.0), 51.5)
    for second in range(52, 100):
        beats.on_pong(beats.send(float(second)), second + 0.05)
    assert 2.5 < beats.suspect_after(100.0) <= 3.0
    assert 6.5 < beats.lost_after(100.0) <= 7.5
    assert beats.lost_after(100.0 + 7200.0) == LOST_AFTER


def test_the_permitted_silence_has_an_upper_limit():
    beats = measured(30.0)
    assert beats.suspect_after(80.0) == beats.lost_after(80.0) == MAX_SILENCE


def test_an_idle_link_with_early_answers_has_rare_heartbeats():
    calm, late = measured(0.05), measured(1.5)
    assert calm.interval(50.0, is_idle=True) == IDLE_PING_EVERY
    assert late.interval(50.0, is_idle=True) == pytest.approx(5.0, abs=0.01)
    assert not calm.is_due(56.0, IDLE_PING_EVERY - 0.6, is_idle=True)
    assert calm.is_due(59.0, IDLE_PING_EVERY + 0.5, is_idle=True)
    for beats in (calm, late):
        assert beats.lost_after(50.0, is_idle=True) == IDLE_LOST_AFTER
        answered_by = beats.interval(50.0, is_idle=True) + 0.5 + beats.round_trip.longest(50.0)
        assert beats.suspect_after(50.0, is_idle=True) == pytest.approx(answered_by)
        assert answered_by < IDLE_LOST_AFTER


def test_an_idle_link_with_live_values_has_the_heartbeats_of_a_busy_one():
    beats = Heartbeats(first=True, idle_interval=PING_EVERY)
    assert beats.interval(50.0, is_idle=True) == PING_EVERY
    assert beats.lost_after(50.0, is_idle=True) == beats.lost_after(50.0)
