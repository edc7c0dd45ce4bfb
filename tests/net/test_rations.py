"""How much processing time the messages of a member may take, on a virtual clock."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.net.waiting.rations import (
    ALLOWANCE,
    CROWD,
    LONGEST_HOLD,
    OVER_FOR,
    PROBE,
    RATION,
    Rations,
    Standing,
)

#: Messages that are taken at a time, as the kernel gives them.
READ = 4096


class Computer:
    """Takes the messages of members as `Rations` says; time is what taking them costs."""

    def __init__(self) -> None:
        self.rations, self.now = Rations(), 100.0
        self.taken: dict[str, int] = {}
        self.closed: dict[str, float] = {}
        self.spent: dict[str, float] = {}
        self.reports: list[tuple[str, float]] = []

    def drain(self, member: str, count: int, cost: float) -> int:
        """A read of so many messages, each of which costs so much; how many were not taken."""
        self.rations.on_read(member, self.now)
        for number in range(1, count + 1):
            self.now += cost
            self.spent[member] = self.spent.get(member, 0.0) + cost
            self.taken[member] = self.taken.get(member, 0) + 1
            standing = self.rations.on_work(member, cost, self.now, number)
            if standing is not Standing.WITHIN and self.rations.may_report(member, self.now):
                self.reports.append((member, self.now))
            if standing is Standing.FLOOD:
                self.rations.on_closed(member, self.now)
                self.closed.setdefault(member, self.now)
                return 0
            if standing is Standing.HELD:
                if number == count:
                    self.rations.on_drained(member, number, self.now)
                self.now = max(self.now, self.rations.held_until(member))
                if number == count:
                    return 0
        self.rations.on_drained(member, count, self.now)
        return 0


def floods(computer: Computer, member: str, rate: float, cost: float, seconds: float) -> None:
    """A member sends so many messages a second, and waits for nothing."""
    began, sent = computer.now, 0
    while computer.now < began + seconds and member not in computer.closed:
        waiting = int((computer.now - began) * rate) - sent
        if waiting < 1:
            computer.now += 1 / rate
            continue
        count = min(waiting, READ)
        sent += count
        computer.drain(member, count, cost)


def hops(computer: Computer, member: str, agents: int, cost: float, seconds: float, trip: float) -> None:
    """A member has so many coordinators, each of which is sent again when its answer has come."""
    began = computer.now
    while computer.now < began + seconds and member not in computer.closed:
        computer.drain(member, agents, cost)
        computer.now += trip


@pytest.mark.parametrize(
    ("rate", "cost"), [(30_000, 8e-6), (100_000, 8e-6), (1_000, 5e-4), (5_000, 1e-4), (100_000, 1e-3)]
)
def test_a_flood_is_held_to_its_ration_and_closed_after_five_seconds_over_budget(rate, cost):
    computer = Computer()
    floods(computer, "bravo", rate, cost, 60.0)
    (member, reported), *rest = computer.reports
    assert (member, rest) == ("bravo", [])
    over = computer.closed["bravo"] - reported
    assert OVER_FOR <= over <= OVER_FOR + 2 * LONGEST_HOLD
    # It has had what it may have at once, then its ration; and one probe of a second at most in full.
    began = 100.0
    assert computer.spent["bravo"] <= ALLOWANCE + RATION * (computer.closed["bravo"] - began) + 1.1


def test_a_flood_at_the_next_link_has_five_seconds_again():
    computer = Computer()
    floods(computer, "bravo", 30_000, 8e-6, 60.0)
    first = computer.closed.pop("bravo")
    floods(computer, "bravo", 30_000, 8e-6, 60.0)
    assert computer.closed["bravo"] - first >= OVER_FOR


@pytest.mark.parametrize("agents", [1, 5, 30])
@pytest.mark.parametrize("cost", [2e-4, 8e-4, 5e-3], ids=["fast", "slow", "very slow"])
def test_hops_are_no_flood_on_any_computer(agents, cost):
    """A thousand a second, or as many as a slow computer can take: they are not closed, and lose little."""
    computer = Computer()
    hops(computer, "bravo", agents, cost, 30.0, 1e-4)
    assert not computer.closed
    alone = 30.0 * agents / (agents * cost + 1e-4)
    assert computer.taken["bravo"] >= 0.85 * alone


def test_a_read_of_a_flood_that_ends_with_a_message_by_chance_shows_nothing():
    """As one in forty reads of large transfers does."""
    rations, now = Rations(), 0.0
    while rations.on_work("bravo", 0.01, now, CROWD) is not Standing.FLOOD:
        now = max(now + 0.01, rations.held_until("bravo"))
        for is_amid in (True, False):
            rations.on_read("bravo", now)
            rations.on_drained("bravo", CROWD * is_amid, now, is_amid=is_amid)
        assert now < 2 * OVER_FOR


def test_a_big_block_and_the_start_of_a_team_are_within_the_budget():
    rations = Rations()
    # A block of 64 MB in pieces of 16 KiB, each of which costs 15 microseconds.
    for number in range(4096):
        assert rations.on_work("bravo", 15e-6, 1.0 + number * 2e-5, 0) is Standing.WITHIN
    for number in range(50):
        member = f"host {number}"
        assert rations.on_handshake(member, 0.003, 1.0) is Standing.WITHIN
        assert rations.on_work(member, 0.01, 1.0, 40) is Standing.WITHIN


def test_a_burst_of_costly_messages_is_over_soon_and_not_closed():
    computer = Computer()
    computer.drain("bravo", 1600, 5e-4)
    assert not computer.closed
    computer.now += 30.0
    assert computer.rations.on_work("bravo", 1e-5, computer.now, 1) is Standing.WITHIN


def test_who_makes_links_without_end_is_closed_after_five_seconds_over_budget():
    rations, now, over = Rations(), 0.0, None
    while (standing := rations.on_handshake("bravo", 0.0015, now)) is not Standing.FLOOD:
        if standing is Standing.OVER and over is None:
            over = now
        now += 0.004
    assert over is not None
    assert now - over >= OVER_FOR


def test_who_reconnects_twenty_times_a_second_makes_no_flood():
    rations = Rations()
    for number in range(2000):
        assert rations.on_handshake("bravo", 0.002, number * 0.05) is Standing.WITHIN


def test_one_member_pays_nothing_for_another():
    rations = Rations()
    while rations.on_work("bravo", 0.01, 1.0, CROWD) is Standing.WITHIN:
        pass
    assert rations.on_work("charlie", 0.01, 1.0, CROWD) is Standing.WITHIN


def test_nobody_is_held_so_long_that_its_link_seems_dead():
    rations = Rations()
    for _ in range(1000):
        rations.on_work("bravo", 10.0, 1.0, CROWD)
    assert 1.0 < rations.held_until("bravo") <= 1.0 + max(LONGEST_HOLD, PROBE)


@given(st.lists(st.tuples(st.floats(0.0, 0.02), st.floats(0.0, 0.05), st.integers(0, 200)), max_size=200))
def test_nobody_is_closed_who_was_not_over_budget_for_five_seconds(steps):
    rations, now, level, since = Rations(), 0.0, 0.0, None
    for seconds, pause, weight in steps:
        now += pause
        level = max(0.0, level - RATION * pause) + seconds
        since = None if level <= ALLOWANCE / 2 else now if since is None else since
        if rations.on_work("bravo", seconds, now, weight) is Standing.FLOOD:
            assert since is not None
            assert now - since >= OVER_FOR
