"""The choice between two paths: readings in, decisions out."""

from __future__ import annotations

import pytest

from lfield.net.health.path_choice import (
    BETTER_FOR,
    CAUTION_PERIOD,
    MAX_CAUTION,
    QUIET_FOR,
    STALLED_AFTER,
    PathChoice,
    PathState,
)
from lfield.net.health.traffic import Delivery

#: Seconds between two readings; sums of it are exact.
STEP = 0.0625


def reading(acked: int = 0, round_trip: float = 0.02, *, pending: bool = False, **more: float) -> PathState:
    return PathState(Delivery(acked, pending, round_trip, round_trip / 8), round_trip, **more)


def dead_after(choice: PathChoice, state: PathState, start: float = 0.0) -> float:
    """Seconds until a link with constant readings is dead."""
    steps = next(step for step in range(1000) if choice.decide(start + step * STEP, state, None) == "dead")
    return steps * STEP


def test_data_without_acknowledgement_makes_a_path_dead():
    assert dead_after(PathChoice(), reading(pending=True)) == pytest.approx(STALLED_AFTER, abs=STEP)


@pytest.mark.parametrize("state", [reading(round_trip=1.0, pending=True), reading(pending=True, bound=1.5)])
def test_a_slow_path_is_dead_later(state):
    """By the kernel's round trip, and by that of the heartbeats, which include repetitions."""
    assert dead_after(PathChoice(), state) == pytest.approx(3.0)


def test_a_path_with_acknowledgements_is_alive():
    choice = PathChoice()
    for step in range(100):
        assert choice.decide(step * STEP, reading(step // 2, pending=True), None) == ""


def test_a_path_with_nothing_in_flight_is_alive():
    choice = PathChoice()
    assert all(choice.decide(float(step), reading(), None) == "" for step in range(100))
    assert choice.decide(100.0, reading(pending=True), None) == ""


def test_a_new_connection_restarts_the_time():
    choice = PathChoice()
    choice.decide(0.0, reading(pending=True), None)
    choice.on_link()
    assert choice.decide(10.0, reading(pending=True), None) == ""


def better_at(link: PathState, standby: PathState, seconds: float = 200.0) -> float | None:
    choice = PathChoice()
    for step in range(int(seconds / STEP)):
        if choice.decide(step * STEP, link, standby) == "better":
            return step * STEP
    return None


@pytest.mark.parametrize(
    ("link", "standby", "is_better"),
    [
        (reading(round_trip=0.1), reading(round_trip=0.049), True),
        (reading(round_trip=0.1), reading(round_trip=0.051), False),
        (reading(round_trip=0.01), reading(round_trip=0.1), False),
        # A difference that a busy computer can make.
        (reading(round_trip=0.015), reading(round_trip=0.0001), False),
        # Repetitions cost more than a round trip.
        (reading(round_trip=0.05, loss=0.3), reading(round_trip=0.06), True),
        (reading(round_trip=0.05), reading(round_trip=0.02, loss=0.1), False),
        # A loss of 1 is no division by zero.
        (reading(round_trip=0.05, loss=1.0), reading(round_trip=0.2), True),
        # There is no measurement yet.
        (reading(round_trip=0.1), reading(round_trip=0.0), False),
    ],
)
def test_the_other_path_must_be_better_by_a_factor(link, standby, is_better):
    found = better_at(link, standby)
    assert found == (pytest.approx(BETTER_FOR) if is_better else None)


def test_the_other_path_must_be_better_without_a_break():
    choice = PathChoice()
    slow, fast = reading(round_trip=0.1), reading(round_trip=0.01)
    assert choice.decide(0.0, slow, fast) == ""
    assert choice.decide(BETTER_FOR - 1.0, slow, slow) == ""
    assert choice.decide(BETTER_FOR + 1.0, slow, fast) == ""
    assert choice.decide(2 * BETTER_FOR, slow, None) == ""
    assert choice.decide(2 * BETTER_FOR + 1.0, slow, fast) == ""
    assert choice.decide(3 * BETTER_FOR + 1.0, slow, fast) == "better"


def test_the_link_moves_only_when_nothing_is_in_flight():
    choice, fast = PathChoice(), reading(round_trip=0.01)
    at, work = 0.0, 0
    while at < 2 * BETTER_FOR:
        at, work = at + STEP, work + 1
        assert choice.decide(at, reading(work, 0.1, pending=work % 2 == 0, work=work), fast) == ""
    assert choice.decide(at + QUIET_FOR - STEP, reading(work, 0.1, work=work), fast) == ""
    assert choice.decide(at + QUIET_FOR + STEP, reading(work, 0.1, pending=True, work=work), fast) == ""
    assert choice.decide(at + QUIET_FOR + 2 * STEP, reading(work, 0.1, work=work), fast) == "better"


def test_a_path_that_recovered_quickly_is_dead_later_for_a_while():
    choice, stalled = PathChoice(), reading(pending=True)
    for count in range(1, 6):
        choice.on_left(10.0 * count)
        choice.on_link()
        choice.on_standby(10.0 * count + 1.0)
        assert dead_after(choice, stalled, 10.0 * count + 2.0) == pytest.approx(
            min(MAX_CAUTION, 2.0**count) * STALLED_AFTER, abs=STEP
        )
    choice.on_link()
    assert dead_after(choice, stalled, 60.0 + CAUTION_PERIOD) == pytest.approx(STALLED_AFTER, abs=STEP)


def test_a_path_that_was_dead_gets_no_extra_time():
    choice = PathChoice()
    choice.on_left(0.0)
    choice.on_link()
    choice.on_standby(5.0)
    assert dead_after(choice, reading(pending=True), 6.0) == pytest.approx(STALLED_AFTER, abs=STEP)
