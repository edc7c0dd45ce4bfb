"""The round-trip time of a link, and when its heartbeats are due."""

import pytest

from lfield.net.health.round_trip import MOST_OPEN, Heartbeats, RoundTrip


def test_the_first_sample_is_the_mean_and_twice_the_variation():
    """RFC 6298, section 2.2."""
    measured = RoundTrip()
    assert (measured.mean, measured.bound) == (None, None)
    measured.add(0.2)
    assert (measured.mean, measured.variation) == (0.2, 0.1)
    assert measured.bound == pytest.approx(0.6)


def test_later_samples_have_the_weights_of_rfc_6298():
    measured = RoundTrip()
    measured.add(0.2)
    measured.add(0.6)
    assert measured.variation == pytest.approx(0.75 * 0.1 + 0.25 * 0.4)
    assert measured.mean == pytest.approx(7 / 8 * 0.2 + 1 / 8 * 0.6)
    assert measured.last == 0.6


def test_the_bound_approaches_a_round_trip_that_stays_the_same():
    measured = RoundTrip()
    for _ in range(100):
        measured.add(0.2)
    assert measured.bound == pytest.approx(0.2, abs=1e-6)


def test_a_clock_that_was_set_back_measures_nothing():
    measured = RoundTrip()
    measured.add(-1.0)
    assert measured.mean is None


def test_an_answer_counts_once_and_for_its_own_heartbeat():
    beats = Heartbeats(0.0, first=True)
    first, second = beats.send(1.0), beats.send(2.0)
    beats.answered(second, 2.1)
    assert beats.round_trip.last == pytest.approx(0.1)
    beats.answered(first, 2.5)
    assert beats.round_trip.last == pytest.approx(1.5)
    for token in (first, second, 0, 99):
        beats.answered(token, 9.0)
    assert beats.round_trip.last == pytest.approx(1.5)


def test_an_end_whose_heartbeats_are_not_answered_remembers_few():
    beats = Heartbeats(0.0, first=True)
    tokens = [beats.send(float(n)) for n in range(1000)]
    beats.answered(tokens[-MOST_OPEN - 1], 1000.0)
    assert beats.round_trip.mean is None
    beats.answered(tokens[-MOST_OPEN], 1000.0)
    assert beats.round_trip.mean == MOST_OPEN


def test_two_ends_send_in_turns_and_both_measure():
    """A link without other messages has one heartbeat a second, as when only one end sent."""
    here, there = Heartbeats(0.0, first=True), Heartbeats(0.0, first=False)
    heard, sent = {here: 0.0, there: 0.0}, {here: 0, there: 0}
    for tick in range(1, 601):
        now = tick / 10
        # Each looks once a second, the second one 0.3 s after the first.
        for end, other, phase in ((here, there, 0), (there, here, 3)):
            if tick % 10 == phase and end.is_due(now, now - heard[end], 1.0):
                token = end.send(now)
                other.received()
                heard[other] = now
                end.answered(token, now + 0.05)
                heard[end] = now + 0.05
                sent[end] += 1
    assert sum(sent.values()) <= 66
    assert min(sent.values()) >= 25
    assert [end.round_trip.mean for end in (here, there)] == pytest.approx([0.05, 0.05])


def test_a_link_with_other_messages_is_measured_now_and_then():
    beats = Heartbeats(0.0, first=True)
    assert not beats.is_due(4.9, 0.1, 1.0)
    assert beats.is_due(5.0, 0.1, 1.0)
    beats.send(5.0)
    assert not beats.is_due(9.9, 0.1, 1.0)
