"""The round-trip time of a path."""

import pytest

from lfield.net.health.link_heartbeats import HALF_LIFE, INITIAL_RTT, RoundTrip


def test_the_first_sample_is_the_mean_and_twice_the_variation():
    """RFC 6298, section 2.2."""
    measured = RoundTrip()
    assert (measured.mean, measured.bound, measured.longest(0.0)) == (None, None, INITIAL_RTT)
    measured.add(0.2, 0.0)
    assert (measured.mean, measured.variation) == (0.2, 0.1)
    assert measured.bound == pytest.approx(0.6)


def test_later_samples_have_the_weights_of_rfc_6298():
    measured = RoundTrip()
    measured.add(0.2, 0.0)
    measured.add(0.6, 1.0)
    assert measured.variation == pytest.approx(0.75 * 0.1 + 0.25 * 0.4)
    assert measured.mean == pytest.approx(7 / 8 * 0.2 + 1 / 8 * 0.6)
    assert measured.last == 0.6


def test_the_bound_approaches_a_round_trip_that_stays_the_same():
    measured = RoundTrip()
    for second in range(100):
        measured.add(0.2, second)
    assert measured.bound == pytest.approx(0.2, abs=1e-6)


def test_a_negative_sample_is_ignored():
    measured = RoundTrip()
    measured.add(-1.0, 0.0)
    assert measured.mean is None


def test_a_late_answer_raises_the_longest_round_trip_for_minutes():
    measured = RoundTrip()
    measured.add(2.0, 0.0)
    for second in range(1, 100):
        measured.add(0.05, second)
    assert measured.longest(HALF_LIFE) == pytest.approx(1.0)
    assert measured.longest(4 * HALF_LIFE) == pytest.approx(0.125)
    assert measured.longest(100 * HALF_LIFE) == measured.bound == pytest.approx(0.05, abs=0.001)
    measured.add(9.0, 101.0)
    assert measured.longest(101.0) >= 9.0
