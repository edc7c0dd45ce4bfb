"""The rate limits of the events of a host."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.host.events.event_rate_limit import EventRateLimiter, RateLimit
from lfield.wire.events import EventsDropped


def budget_of(burst, rate, unwatched=None):
    """A rate limiter, and its reports."""
    reports = []
    return EventRateLimiter(reports.append, RateLimit(burst, rate), unwatched), reports


def test_a_normal_rate_is_not_limited():
    budget, reports = budget_of(20.0, 10.0)
    for n in range(1000):
        budget.refill(n * 0.1)
        assert budget.try_acquire("left")
    budget.report_dropped(1000.0)
    assert reports == []


def test_events_over_the_rate_are_counted():
    (budget, reports), accepted = budget_of(20.0, 10.0), 0
    for n in range(10_000):
        budget.refill(n * 0.001)
        accepted += budget.try_acquire("left")
    assert accepted == pytest.approx(20 + 100, abs=1)
    budget.report_dropped(10.0)
    assert sum(skipped.count for skipped in reports) == 10_000 - accepted
    count = len(reports)
    budget.report_dropped(12.0)
    assert len(reports) == count


def test_the_dropped_count_is_reported_before_the_next_event():
    budget, reports = budget_of(2.0, 10.0)
    assert [budget.try_acquire("printed") for _ in range(5)] == [True, True, False, False, False]
    assert reports == []
    budget.refill(1.0)
    assert budget.try_acquire("printed")
    assert reports == [EventsDropped("printed", 3)]


def test_the_dropped_count_is_reported_on_request_or_once_a_second():
    budget, reports = budget_of(1.0, 10.0)
    for _ in range(2):
        budget.try_acquire("left")
        budget.try_acquire("left")
        budget.report_dropped(5.0)
    assert [skipped.count for skipped in reports] == [1]
    budget.report_dropped(5.0, at_once=True)
    assert [skipped.count for skipped in reports] == [1, 2]


def test_an_observed_limiter_permits_more():
    budget, _ = budget_of(9.0, 90.0, RateLimit(2.0, 20.0))
    assert sum(budget.try_acquire("left") for _ in range(20)) == 2
    budget.set_observed(on=True)
    assert sum(budget.try_acquire("left") for _ in range(20)) == 9
    # A second observer gets no second burst.
    budget.set_observed(on=True)
    assert not budget.try_acquire("left")
    budget.set_observed(on=False)
    assert sum(budget.try_acquire("left") for _ in range(20)) == 2


def test_a_long_event_costs_more():
    budget, _ = budget_of(10.0, 0.0)
    assert [budget.try_acquire("printed", 6.0) for _ in range(3)] == [True, True, False]


@settings(derandomize=True, deadline=None)
@given(
    st.lists(st.tuples(st.sampled_from(["left", "came"]), st.floats(0.0, 3.0)), max_size=60),
    st.floats(0.1, 30.0),
)
def test_every_dropped_event_is_counted_once(asked, rate):
    (budget, reports), now = budget_of(2.0, rate), 0.0
    accepted = 0
    for kind, pause in asked:
        now += pause
        budget.refill(now)
        accepted += budget.try_acquire(kind)
        budget.report_dropped(now)
    budget.report_dropped(now, at_once=True)
    assert accepted + sum(skipped.count for skipped in reports) == len(asked)
    assert accepted <= 2.0 + rate * now + 1e-6


def test_a_clock_that_stands_still_fills_nothing():
    budget, _ = budget_of(2.0, 10.0)
    budget.refill(5.0)
    assert [budget.try_acquire("left") for _ in range(3)] == [True, True, False]
    budget.refill(5.0)
    assert not budget.try_acquire("left")
