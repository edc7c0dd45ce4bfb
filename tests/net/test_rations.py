"""The budget of processing time for the messages of a member, in virtual time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.net.scheduling.cpu_budgets import (
    BURST,
    CPU_SHARE,
    CROWD_WEIGHT,
    LONGEST_HOLD,
    MAX_EXCESS_TIME,
    PROOF_WEIGHT,
    BudgetState,
    CpuBudgets,
)

#: Messages that are processed per read, as from the kernel.
READ = 4096


class Computer:
    """Processes the messages of members within `CpuBudgets`; time is the processing time."""

    def __init__(self) -> None:
        self.rations, self.now = CpuBudgets(), 100.0
        self.taken: dict[str, int] = {}
        self.closed: dict[str, float] = {}
        self.spent: dict[str, float] = {}
        self.reports: list[tuple[str, float]] = []
        #: Weight of each member's messages during the present probe.
        self.weights: dict[str, int] = {}

    def drain(self, member: str, count: int, cost: float, weight: int = 1) -> None:
        """Process `count` messages, each with this cost and weight."""
        for _ in range(count):
            self.now += cost
            self.spent[member] = self.spent.get(member, 0.0) + cost
            self.taken[member] = self.taken.get(member, 0) + 1
            self.probe(member)
            if self.rations.probe_ends(member) is not None:
                self.weights[member] = self.weights.get(member, 0) + weight
            else:
                self.weights[member] = 0
            standing = self.rations.on_work(member, cost, self.now, self.weights[member])
            if standing is not BudgetState.WITHIN and self.rations.may_report(member, self.now):
                self.reports.append((member, self.now))
            if standing is BudgetState.FLOOD:
                self.rations.on_closed(member, self.now)
                self.closed.setdefault(member, self.now)
                return
            if standing is BudgetState.HELD:
                self.now = max(self.now, self.rations.held_until(member))

    def probe(self, member: str) -> None:
        """End a probe whose time is over."""
        ends = self.rations.probe_ends(member)
        if ends is not None and ends < self.now:
            self.rations.on_probe_end(member, ends)

    def answer(self, member: str) -> None:
        """Wait until answers are sent."""
        while (ends := self.rations.probe_ends(member)) is not None:
            self.now = max(self.now, ends)
            self.rations.on_probe_end(member, self.now)


def flood(computer: Computer, member: str, rate: float, cost: float, seconds: float) -> None:
    """A member sends `rate` messages a second, and does not wait for answers."""
    started, sent = computer.now, 0
    while computer.now < started + seconds and member not in computer.closed:
        waiting = int((computer.now - started) * rate) - sent
        if waiting < 1:
            computer.now += 1 / rate
            continue
        count = min(waiting, READ)
        sent += count
        computer.drain(member, count, cost)


def hops(computer: Computer, member: str, agents: int, cost: float, seconds: float, trip: float) -> None:
    """A member has `agents` coordinators; each is sent again after its answer."""
    started = computer.now
    while computer.now < started + seconds and member not in computer.closed:
        computer.drain(member, agents, cost)
        computer.answer(member)
        computer.now += trip


@pytest.mark.parametrize(
    ("rate", "cost"), [(30_000, 8e-6), (100_000, 8e-6), (1_000, 5e-4), (5_000, 1e-4), (100_000, 1e-3)]
)
def test_a_flood_is_limited_and_closed_after_five_seconds_over_budget(rate, cost):
    computer = Computer()
    flood(computer, "bravo", rate, cost, 60.0)
    (member, reported), *rest = computer.reports
    assert (member, rest) == ("bravo", [])
    over = computer.closed["bravo"] - reported
    assert MAX_EXCESS_TIME <= over <= MAX_EXCESS_TIME + 2 * LONGEST_HOLD
    # It has used the burst, then its ration, and at most one probe of a second in full.
    started = 100.0
    assert computer.spent["bravo"] <= BURST + CPU_SHARE * (computer.closed["bravo"] - started) + 1.1


@pytest.mark.few(0)
def test_a_flood_on_the_next_link_has_five_seconds_again():
    computer = Computer()
    flood(computer, "bravo", 30_000, 8e-6, 60.0)
    first = computer.closed.pop("bravo")
    flood(computer, "bravo", 30_000, 8e-6, 60.0)
    assert computer.closed["bravo"] - first >= MAX_EXCESS_TIME


@pytest.mark.few(0)
@pytest.mark.parametrize("agents", [1, 5, 30])
@pytest.mark.parametrize("cost", [2e-4, 8e-4, 5e-3], ids=["fast", "slow", "very slow"])
def test_hops_are_no_flood_on_a_computer_of_any_speed(agents, cost):
    """A thousand a second, or as many as a slow computer can process: they are not closed, and lose
    little."""
    computer = Computer()
    hops(computer, "bravo", agents, cost, 30.0, 1e-4)
    assert not computer.closed
    alone = 30.0 * agents / (agents * cost + 1e-4)
    assert computer.taken["bravo"] >= 0.85 * alone


def test_large_transfers_of_several_coordinators_in_turn_are_closed():
    """The second transfer of each during a probe counts as a crowd: see tests/net/test_members.py."""
    computer, agents, cost = Computer(), 3, 0.02
    started = computer.now
    while computer.now < started + 30.0 and not computer.closed:
        computer.drain("bravo", agents, cost)
        computer.drain("bravo", 1, cost, PROOF_WEIGHT)
    (_, reported), *_ = computer.reports
    assert MAX_EXCESS_TIME <= computer.closed["bravo"] - reported <= MAX_EXCESS_TIME + 2 * LONGEST_HOLD


def test_a_proven_excess_is_not_forgiven_after_a_pause():
    """A member that pauses whenever its answers are withheld, for as long as a probe lasts."""
    computer, cost = Computer(), 0.01
    started = computer.now
    while computer.now < started + 30.0 and not computer.closed:
        computer.drain("bravo", 50, cost)
        computer.drain("bravo", 2, cost, PROOF_WEIGHT)
        computer.answer("bravo")
    assert MAX_EXCESS_TIME <= computer.closed["bravo"] - started <= MAX_EXCESS_TIME + 3.0


def test_a_crowd_is_forgiven_when_the_member_waits_for_answers():
    """As after a partition: the queued messages arrive at once, then hops as before."""
    computer = Computer()
    computer.drain("bravo", 4 * CROWD_WEIGHT, 1.5e-3)
    assert computer.reports
    hops(computer, "bravo", 5, 5e-3, 30.0, 1e-4)
    assert not computer.closed


def test_a_large_block_and_the_start_of_a_team_are_within_the_budget():
    rations = CpuBudgets()
    # A block of 64 MB in pieces of 16 KiB, each of which costs 15 microseconds.
    for number in range(4096):
        assert rations.on_work("bravo", 15e-6, 1.0 + number * 2e-5, 0) is BudgetState.WITHIN
    for number in range(50):
        member = f"host {number}"
        assert rations.on_handshake(member, 0.003, 1.0) is BudgetState.WITHIN
        assert rations.on_work(member, 0.01, 1.0, 40) is BudgetState.WITHIN


def test_a_short_burst_of_costly_messages_is_not_closed():
    computer = Computer()
    computer.drain("bravo", 1600, 5e-4)
    assert not computer.closed
    computer.now += 30.0
    assert computer.rations.on_work("bravo", 1e-5, computer.now, 1) is BudgetState.WITHIN


def test_endless_handshakes_are_closed_after_five_seconds_over_budget():
    rations, now, over = CpuBudgets(), 0.0, None
    while (standing := rations.on_handshake("bravo", 0.0015, now)) is not BudgetState.FLOOD:
        if standing is BudgetState.OVER and over is None:
            over = now
        now += 0.004
    assert over is not None
    assert now - over >= MAX_EXCESS_TIME


def test_twenty_reconnections_a_second_are_no_flood():
    rations = CpuBudgets()
    for number in range(2000):
        assert rations.on_handshake("bravo", 0.002, number * 0.05) is BudgetState.WITHIN


def test_members_have_separate_budgets():
    rations = CpuBudgets()
    while rations.on_work("bravo", 0.01, 1.0, CROWD_WEIGHT) is BudgetState.WITHIN:
        pass
    assert rations.on_work("charlie", 0.01, 1.0, CROWD_WEIGHT) is BudgetState.WITHIN


def test_a_link_is_held_for_less_than_its_heartbeat_time_out():
    rations = CpuBudgets()
    for _ in range(1000):
        rations.on_work("bravo", 10.0, 1.0, CROWD_WEIGHT)
    assert 1.0 < rations.held_until("bravo") <= 1.0 + LONGEST_HOLD


@given(st.lists(st.tuples(st.floats(0.0, 0.02), st.floats(0.0, 0.05), st.integers(0, 200)), max_size=200))
def test_a_member_is_closed_only_after_five_seconds_over_budget(steps):
    rations, now, level, since = CpuBudgets(), 0.0, 0.0, None
    for seconds, pause, weight in steps:
        now += pause
        level = max(0.0, level - CPU_SHARE * pause) + seconds
        since = None if level <= BURST / 2 else now if since is None else since
        if rations.on_work("bravo", seconds, now, weight) is BudgetState.FLOOD:
            assert since is not None
            assert now - since >= MAX_EXCESS_TIME
