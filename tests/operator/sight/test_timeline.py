"""One time line from hosts whose clocks differ: what led to something comes before it."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.operator.sight.timeline.clocks import DRIFT, Clocks, Life
from lfield.operator.sight.timeline.timeline import MOST_WAITING, Cause, Dated, Timeline, hop_of
from lfield.wire.events import Came, Event, Hopped, Left, Linked

YEAR_2024 = 1.7e9


@dataclass
class Computer:
    """A host's clocks: what they show at a true time, and what happened there with those times."""

    up: float
    wall: float
    rate: float = 1.0
    life: int = 5
    stream: list[Event] = field(default_factory=list)
    truth: list[float] = field(default_factory=list)

    def happens(self, when: float, what: object) -> None:
        shown = self.up + self.rate * when
        event = Event(len(self.stream) + 1, max(0.0, shown + self.wall), shown, 0, what)  # type: ignore[arg-type]
        self.stream.append(event)
        self.truth.append(when)


def journey(computers: list[Computer], seed: int, hops: int, *, confirmed: float = 1.0) -> None:
    """A coordinator hops about for a while; some hops are never confirmed. Each part takes its time."""
    dice = random.Random(seed)
    at, now = 0, 0.0
    queue: list[tuple[float, int, object]] = []
    for sequence in range(1, hops + 1):
        to = dice.choice([n for n in range(len(computers)) if n != at])
        now += dice.expovariate(2.0)
        queue.append((now, at, Left("boss", 1, sequence, str(to), "", "", 9)))
        there = now + dice.uniform(0.001, 0.2)
        queue.append((there, to, Came("boss", 1, sequence, str(at), 9)))
        back = there + dice.uniform(0.001, 0.2)
        if dice.random() < confirmed:
            queue.append((back, at, Hopped("boss", 1, sequence, str(to), back - now)))
        queue.append((there + 1e-4, dice.randrange(len(computers)), Linked("x")))
        at, now = to, there
    for when, host, what in sorted(queue, key=lambda each: each[:2]):
        computers[host].happens(when, what)


def merged(computers: list[Computer], seed: int) -> list[Dated]:
    """All streams, in whatever order they are read."""
    dice, timeline = random.Random(seed), Timeline()
    places = [0] * len(computers)
    while left := [n for n, computer in enumerate(computers) if places[n] < len(computer.stream)]:
        n = dice.choice(left)
        for event in computers[n].stream[places[n] : places[n] + dice.randint(1, 9)]:
            timeline.add(str(n), computers[n].life, event)
            places[n] += 1
    return timeline.given()


clock = st.builds(Computer, up=st.floats(0.0, 1e6), wall=st.floats(0.0, 2 * YEAR_2024))
drifting = st.builds(
    Computer, up=st.floats(0.0, 1e6), wall=st.floats(0.0, 2 * YEAR_2024), rate=st.floats(0.99, 1.01)
)


def insist_on_causes_first(told: list[Dated], computers: list[Computer]) -> None:
    assert len(told) == sum(len(computer.stream) for computer in computers)
    places: dict[Cause, int] = {}
    for place, dated in enumerate(told):
        here = Cause(dated.host, dated.incarnation, dated.event.number)
        before = here._replace(number=here.number - 1)
        assert here.number == 1 or told[places[before]].time <= dated.time
        if dated.cause is not None:
            assert told[places[dated.cause]].time <= dated.time
        places[here] = place


@settings(max_examples=100, deadline=None)
@given(st.lists(drifting, min_size=2, max_size=5), st.integers(0, 10**6), st.floats(0.0, 1.0))
def test_causes_come_before_effects_whatever_clocks_show(
    computers: list[Computer], seed: int, confirmed: float
) -> None:
    journey(computers, seed, 30, confirmed=confirmed)
    insist_on_causes_first(merged(computers, seed), computers)


@settings(max_examples=100, deadline=None)
@given(clock, clock, st.integers(0, 10**6))
def test_times_of_two_hosts_are_true_within_what_they_say(one: Computer, two: Computer, seed: int) -> None:
    computers = [one, two]
    for computer in computers:
        computer.stream, computer.truth = [], []
    journey(computers, seed, 40)
    told = merged(computers, seed)
    known = [dated for dated in told if dated.within is not None]
    assert len(known) == len(told)
    # Time is by the clock of one of the two.
    errors = [
        max(
            abs(d.time - (base.up + base.wall + computers[int(d.host)].truth[d.event.number - 1]))
            - (d.within or 0.0)
            for d in told
        )
        for base in computers
    ]
    assert min(errors) < 1e-5
    # A hop takes 0.2 s there and back on average, and the best of them are much quicker.
    assert max(d.within or 0.0 for d in told) < 0.3


@settings(max_examples=30, deadline=None)
@given(st.lists(clock, min_size=3, max_size=3), st.integers(0, 10**6))
def test_whom_only_others_know_is_dated_through_them(computers: list[Computer], seed: int) -> None:
    for sequence, (of, to) in enumerate([(0, 1), (1, 2)], 1):
        now = float(sequence)
        computers[of].happens(now, Left("boss", 1, sequence, str(to), "", "", 9))
        computers[to].happens(now + 0.01, Came("boss", 1, sequence, str(of), 9))
        computers[of].happens(now + 0.02, Hopped("boss", 1, sequence, str(to), 0.02))
    told = merged(computers, seed)
    insist_on_causes_first(told, computers)
    assert all(dated.within is not None and dated.within < 0.05 for dated in told)
    true = [computers[int(d.host)].truth[d.event.number - 1] for d in told]
    assert true == sorted(true)


def test_hosts_that_nothing_joins_are_told_by_their_own_clocks() -> None:
    timeline = Timeline()
    timeline.add("a", 1, Event(1, YEAR_2024 + 60.0, 5.0, 0, Linked("x")))
    timeline.add("b", 1, Event(1, YEAR_2024, 9.0, 0, Linked("x")))
    told = timeline.given()
    assert [(d.host, d.time, d.within) for d in told] == [("b", YEAR_2024, None), ("a", YEAR_2024 + 60, None)]


def test_a_watcher_that_hears_hosts_dates_them_by_its_own_clock() -> None:
    timeline = Timeline()
    timeline.clocks.wall(Life(""), 100.0, YEAR_2024)
    timeline.heard("a", 1, 5.0, 100.2, 100.0)
    timeline.add("a", 1, Event(1, 77.0, 6.0, 0, Linked("x")))
    (told,) = timeline.given()
    assert told.time == pytest.approx(YEAR_2024 + 1.1)
    assert told.within == pytest.approx(0.1 + DRIFT, rel=0.01)


def test_a_batch_later_on_bounds_a_clock_that_was_asked_once() -> None:
    clocks, a, us = Clocks(), Life("a", 1), Life("")
    clocks.wall(us, 100.0, YEAR_2024)
    clocks.before((us, 100.0), (a, 5.0))
    clocks.before((a, 5.0), (us, 104.0))
    assert clocks.time(a, 5.0).within == pytest.approx(2.0, abs=5 * DRIFT)
    # Sent at 6.0, it was here no later than 101.1: the answer had been slow on its way.
    clocks.before((a, 6.0), (us, 101.1))
    assert clocks.time(a, 6.0).within == pytest.approx(0.05, abs=2 * DRIFT)


def test_a_clock_that_was_set_is_believed_as_it_is_now() -> None:
    clocks, a, b = Clocks(), Life("a", 1), Life("b", 1)
    clocks.wall(a, 0.0, 0.0)
    clocks.wall(b, 0.0, 0.0)
    for start, ahead in ((10.0, 100.0), (1000.0, 300.0)):
        for _ in range(2):
            clocks.before((a, start), (b, start + ahead + 0.1))
            clocks.before((b, start + ahead + 0.1), (a, start + 0.2))
    assert clocks.time(b, 1300.1).time == pytest.approx(1000.1, abs=0.05)
    assert clocks.time(b, 110.1).time == pytest.approx(10.1, abs=0.05)


def test_what_happened_lately_waits_for_what_may_have_led_to_it() -> None:
    timeline = Timeline()
    came = Event(1, YEAR_2024 + 2.0, 2.0, 0, Came("boss", 1, 3, "a", 9))
    left = Event(1, YEAR_2024 + 1.0, 1.0, 0, Left("boss", 1, 3, "b", "", "", 9))
    timeline.add("b", 1, came)
    assert timeline.given(YEAR_2024 + 1.5) == []
    timeline.add("a", 1, left)
    assert [hop_of(d.event) and d.event.kind for d in timeline.given(YEAR_2024 + 5.0)] == ["left", "came"]


def test_the_lives_of_a_host_follow_one_another_though_its_clock_was_set_back() -> None:
    timeline = Timeline()
    timeline.add("a", 1, Event(1, YEAR_2024, 900.0, 0, Linked("x")))
    timeline.add("a", 2, Event(1, 5.0, 1.0, 0, Linked("y")))
    assert [dated.incarnation for dated in timeline.given()] == [1, 2]


def test_hosts_that_contradict_one_another_are_told_all_the_same() -> None:
    timeline = Timeline()
    for host, first, then in (("a", 1, 2), ("b", 2, 1)):
        timeline.add(host, 1, Event(1, YEAR_2024, 1.0, 0, Came("boss", 1, first, "x", 9)))
        timeline.add(host, 1, Event(2, YEAR_2024, 2.0, 0, Left("boss", 1, then, "x", "", "", 9)))
    assert len(timeline.given()) == 4


def test_a_host_whose_times_never_come_fills_no_memory() -> None:
    timeline = Timeline()
    for number in range(1, MOST_WAITING + 3):
        timeline.add("a", 1, Event(number, 2e11, 5.0, 0, Linked("x")))
    assert len(timeline.given(YEAR_2024)) == MOST_WAITING + 2


def test_lives_that_are_over_are_forgotten_once_they_are_told() -> None:
    timeline = Timeline()
    for life in range(1, 50):
        timeline.add("a", life, Event(1, YEAR_2024, 1.0, 0, Linked("x")))
        if life % 2:
            timeline.given()
    assert [dated.incarnation for dated in timeline.given()] == []
    timeline.add("a", 51, Event(1, YEAR_2024, 1.0, 0, Linked("x")))
    timeline.add("a", 52, Event(1, YEAR_2024, 1.0, 0, Linked("x")))
    assert [dated.incarnation for dated in timeline.given()] == [51, 52]
