"""Events of hosts with different clocks in one order: by timestamp, host and number, causes first."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.host.events.event_log import stamped_event
from lfield.hybrid_clock import MAX_AHEAD, HybridClock, timestamp_of
from lfield.operator.dashboard.timeline.event_timeline import Cause, DatedEvent, EventTimeline
from lfield.wire.events import (
    Event,
    LinkUp,
    MigrationArrived,
    MigrationConfirmed,
    MigrationStarted,
    StateEvent,
)

YEAR_2024 = 1.7e9


@dataclass
class Computer:
    """A host: its clocks at true time 0, and its events."""

    up: float
    wall: float
    stream: list[Event] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.clock = HybridClock(self.up, self.wall)

    def happens(self, now: float, what: StateEvent) -> int:
        """An event; returns its timestamp, as a message would carry it."""
        stamp = self.clock.tick(self.up + now)
        event = stamped_event(len(self.stream) + 1, max(0.0, self.wall + now), self.up + now, 0, what, stamp)
        self.stream.append(event)
        return stamp

    def hears(self, host: str, stamp: int, now: float) -> None:
        """Receive a message of another host."""
        self.clock.merge(host, stamp, self.up + now)


def journey(computers: list[Computer], seed: int, hops: int) -> None:
    """A coordinator migrates; some hops are never confirmed, and other events happen in between."""
    rng = random.Random(seed)
    at, now = 0, 0.0
    for sequence in range(1, hops + 1):
        to = rng.choice([n for n in range(len(computers)) if n != at])
        now += rng.expovariate(2.0)
        left = computers[at].happens(now, MigrationStarted("boss", 1, sequence, str(to), "", "", 9))
        now += rng.uniform(0.001, 0.2)
        computers[to].hears(str(at), left, now)
        arrived = computers[to].happens(now, MigrationArrived("boss", 1, sequence, str(at), 9))
        computers[rng.randrange(len(computers))].happens(now, LinkUp("x"))
        if rng.random() < 0.7:
            computers[at].hears(str(to), arrived, now + 0.001)
            computers[at].happens(now + 0.001, MigrationConfirmed("boss", 1, sequence, str(to), 0.1))
        at = to


def merged(computers: list[Computer], seed: int) -> list[DatedEvent]:
    """All streams, read in any order."""
    rng, timeline = random.Random(seed), EventTimeline()
    places = [0] * len(computers)
    while left := [n for n, computer in enumerate(computers) if places[n] < len(computer.stream)]:
        n = rng.choice(left)
        for event in computers[n].stream[places[n] : places[n] + rng.randint(1, 9)]:
            timeline.add(str(n), 5, event)
            places[n] += 1
    return timeline.drain_events()


def require_causes_first(told: list[DatedEvent], computers: list[Computer]) -> None:
    assert len(told) == sum(len(computer.stream) for computer in computers)
    places: dict[Cause, int] = {}
    for place, dated in enumerate(told):
        here = Cause(dated.host, dated.incarnation, dated.event.number)
        assert here.number == 1 or here._replace(number=here.number - 1) in places
        assert dated.cause is None or dated.cause in places
        if isinstance(dated.event.what, MigrationArrived | MigrationConfirmed):
            assert dated.cause is not None
        places[here] = place


def computers_apart(most: float) -> st.SearchStrategy[list[Computer]]:
    one = st.builds(Computer, up=st.floats(0.0, 1e6), wall=st.floats(YEAR_2024, YEAR_2024 + most))
    return st.lists(one, min_size=2, max_size=5)


@settings(max_examples=100, deadline=None)
@given(computers_apart(MAX_AHEAD), st.integers(0, 10**6))
def test_clocks_minutes_apart_do_not_change_the_order(computers: list[Computer], seed: int) -> None:
    journey(computers, seed, 30)
    events = merged(computers, seed)
    require_causes_first(events, computers)
    assert events == sorted(events, key=lambda dated: (dated.event.stamp, dated.host, dated.event.number))
    times = {Cause(d.host, d.incarnation, d.event.number): d.event.stamp for d in events}
    assert all(times[dated.cause] < dated.event.stamp for dated in events if dated.cause is not None)


@settings(max_examples=100, deadline=None)
@given(computers_apart(2 * YEAR_2024), st.integers(0, 10**6))
def test_causes_come_first_with_any_clocks(computers: list[Computer], seed: int) -> None:
    journey(computers, seed, 30)
    require_causes_first(merged(computers, seed), computers)


def event(number: int, at: float, what: StateEvent | None = None, count: int = 0, ahead: int = 0) -> Event:
    return stamped_event(number, at, 5.0, 0, what or LinkUp("x"), timestamp_of(int(at * 1000) + ahead, count))


def test_events_of_one_timestamp_are_ordered_by_host_and_number() -> None:
    timeline = EventTimeline()
    for host, number, count in (("b", 1, 7), ("b", 2, 7), ("a", 1, 7), ("c", 1, 6)):
        timeline.add(host, 1, event(number, YEAR_2024, count=count))
    events = [(dated.host, dated.event.number) for dated in timeline.drain_events()]
    assert events == [("c", 1), ("a", 1), ("b", 1), ("b", 2)]


def test_time_is_the_timestamp_and_within_is_the_lag_of_the_host() -> None:
    timeline = EventTimeline()
    timeline.add("a", 1, event(1, YEAR_2024))
    timeline.add("b", 1, event(1, YEAR_2024, ahead=90_250))
    events = [(dated.host, dated.time, dated.within) for dated in timeline.drain_events()]
    assert events == [("a", YEAR_2024, None), ("b", YEAR_2024 + 90.25, 90.25)]


def test_an_event_waits_for_earlier_events_of_other_hosts() -> None:
    timeline = EventTimeline()
    timeline.add("b", 1, event(1, YEAR_2024 + 2.0), received=10.0)
    assert timeline.drain_events(9.9) == []
    timeline.add("a", 1, event(1, YEAR_2024 + 1.0), received=10.4)
    assert [dated.host for dated in timeline.drain_events(10.0)] == ["a", "b"]


def test_a_busy_host_with_an_earlier_clock_delays_no_other_host() -> None:
    timeline = EventTimeline()
    timeline.add("b", 1, event(1, YEAR_2024 + 500.0), received=10.0)
    for number in range(1, 50):
        now = 10.0 + 0.1 * number
        timeline.add("a", 1, event(number, YEAR_2024 + 0.1 * number), received=now)
        if "b" in [dated.host for dated in timeline.drain_events(now - 0.5)]:
            break
    assert now < 10.7


def test_incarnations_are_in_order_also_after_the_clock_was_set_back() -> None:
    timeline = EventTimeline()
    timeline.add("a", 1, event(1, YEAR_2024))
    timeline.add("a", 2, event(1, 5.0))
    assert [dated.incarnation for dated in timeline.drain_events()] == [1, 2]


def test_contradictory_streams_are_merged() -> None:
    timeline = EventTimeline()
    for host, first, then in (("a", 1, 2), ("b", 2, 1)):
        timeline.add(host, 1, event(1, YEAR_2024, MigrationArrived("boss", 1, first, "x", 9)))
        timeline.add(host, 1, event(2, YEAR_2024, MigrationStarted("boss", 1, then, "x", "", "", 9)))
    assert len(timeline.drain_events()) == 4


def test_an_incarnation_is_dropped_after_its_last_event() -> None:
    timeline = EventTimeline()
    for incarnation in range(1, 51):
        timeline.add("a", incarnation, event(1, YEAR_2024))
        if incarnation % 2:
            timeline.drain_events()
    assert [dated.incarnation for dated in timeline.drain_events()] == [50]
    assert len(timeline._streams) <= 1  # white box: bounded memory
