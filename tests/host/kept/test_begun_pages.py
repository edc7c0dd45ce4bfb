"""What a host keeps of calls that were begun on it, and when that goes. Machine and mobility stand in."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import pytest

from lfield.clock import ManualClock
from lfield.host.team.begun import BegunPages
from lfield.host.team.keeping import Keeping
from lfield.journal.pages import BegunPage, begun_key, key_of
from lfield.mobility.effects import Go, Persist
from lfield.vm.begun import Beginning, Begun

MISSION = b"m" * 32
LIFT = Beginning(3, "arm", "lift", acts=True)
PAGE = BegunPage("w", 1, 3, "arm", "lift", program=MISSION)
DONE = BegunPage("w", 1, 3, "arm", "lift", "done", b"42", MISSION)


@dataclass(eq=False)
class Walker:
    """A coordinator, as far as the host looks at it."""

    id: str = "w"
    generation: int = 1
    kept: bool = False


@dataclass
class Engine:
    """A machine that notes what it is told."""

    running: list[Begun] = field(default_factory=list)
    told: list[Any] = field(default_factory=list)
    cancelled: list[Any] = field(default_factory=list)
    forgotten: list[Any] = field(default_factory=list)
    has: list[Any] = field(default_factory=list)

    def begun_calls(self) -> list[Begun]:
        return self.running

    def restore_begun(self, calls: Any) -> None:
        self.running += calls

    def kept_result(self, key: Any) -> None:
        self.told.append(key)

    def cancel_begun(self, agent: str, below: int, reason: str) -> None:
        self.cancelled.append((agent, below, reason))
        self.running = [c for c in self.running if c.agent != agent or c.generation >= below]

    def forget_begun(self, keys: Any) -> None:
        self.forgotten += keys
        self.running = [c for c in self.running if c.key not in self.forgotten]

    def fetched(self, agent: Walker) -> list[Any]:
        keys, self.has = self.has, []
        return keys


class Team:
    """Coordinators and mobility in one: `over` has the starts that have ended, `sent` those that left."""

    def __init__(self) -> None:
        self.keeping, self.trouble, self.mobility = Keeping(), "", self
        self.ended: dict[tuple[str, int], str] = {}
        self.sent: set[tuple[str, int]] = set()
        self.saved: list[str] = []
        self.told: set[tuple[str, int]] = set()

    def save(self, agent: Walker) -> bool:
        self.saved.append(agent.id)
        self.keeping.put([Persist(agent.id, PAGE), Go(agent.id, agent.generation)], 0.0)
        return False

    def over(self, agent: str, generation: int) -> str:
        return self.ended.get((agent, generation), "")

    def is_sent(self, agent: str, generation: int) -> bool:
        return (agent, generation) in self.sent


class Lease:
    """Leases, which all hold unless a start is barred."""

    fenced: frozenset[str] = frozenset()

    def __init__(self) -> None:
        self.bars: set[tuple[str, int]] = set()
        self.team: Team

    def may_begin(self, agent: Walker) -> bool:
        return (agent.id, agent.generation) not in self.bars

    def barred(self, agent: str, generation: int) -> bool:
        return (agent, generation) in self.bars

    def over(self, agent: str, generation: int) -> str:
        why = f"no start of {agent} as early as this one may run any more"
        return why if self.barred(agent, generation) else self.team.over(agent, generation)


class Bench:
    """The pages of one host, with all that stands around them."""

    def __init__(self, *pages: BegunPage, keeps: bool = True) -> None:
        self.team, self.lease, self.machine = Team(), Lease(), Engine()
        self.lease.team = self.team
        given: Any = self.team, self.lease, self.machine
        self.begun = BegunPages(MISSION, *given, ManualClock(), pages, keeps=keeps)
        self.begun.restore()

    def begins(self, walker: Walker) -> bool:
        agent: Any = walker
        return self.begun.begins(agent, [LIFT])

    def sync(self) -> tuple[list[Any], list[Any]]:
        """What has come to the disk by now, and what is gone from it."""
        batch = self.team.keeping.take(1e9)
        assert batch is not None
        number, pages, keys = batch
        self.team.keeping.kept(number)
        self.begun.kept(number)
        return pages, keys

    def back(self) -> None:
        self.begun.came_back(Begun("w", 1, 3, "arm", "lift", state="done", parcel=b"42"))


def test_no_call_begins_before_its_page_and_the_block_of_its_coordinator_are_on_the_disk() -> None:
    bench, walker = Bench(), Walker()
    assert not bench.begins(walker)
    assert bench.team.saved == ["w"]
    # Asked again meanwhile, it waits on, and keeps nothing twice.
    assert not bench.begins(walker)
    assert bench.sync() == ([PAGE], [])
    walker.kept = True
    assert bench.begins(walker)
    assert bench.team.saved == ["w"]


def test_a_coordinator_that_has_just_come_has_its_calls_kept_all_the_same() -> None:
    bench, walker = Bench(), Walker(kept=True)
    assert not bench.begins(walker)
    bench.sync()
    assert bench.begins(walker)


def test_a_result_is_told_when_it_is_on_the_disk_and_not_before() -> None:
    bench = Bench()
    bench.begins(Walker())
    bench.sync()
    bench.back()
    assert bench.machine.told == []
    assert bench.sync() == ([DONE], [])
    assert bench.machine.told == [("w", 1, 3)]


def test_a_host_that_keeps_nothing_waits_for_nothing() -> None:
    bench = Bench(keeps=False)
    assert bench.begins(Walker())
    bench.back()
    assert bench.machine.told == [("w", 1, 3)]
    assert bench.team.keeping.take(1e9) is None


def test_what_was_fetched_goes_when_a_page_of_the_coordinator_has_it() -> None:
    bench, walker = Bench(DONE), Walker()
    bench.machine.has = [("w", 1, 3)]
    agent: Any = walker
    bench.begun.leaves(agent)
    bench.begun.look()
    # It waits for a link: nothing is sent, and no page says anything new.
    assert bench.team.keeping.take(1e9) is None
    bench.team.sent.add(("w", 1))
    bench.begun.look()
    assert bench.sync() == ([], [key_of(DONE)])


def test_what_was_fetched_goes_with_the_block_that_is_kept_for_a_further_call_here() -> None:
    bench = Bench(DONE)
    bench.machine.has = [("w", 1, 3)]
    agent: Any = Walker()
    bench.begun.save(agent)
    assert bench.sync()[1] == [key_of(DONE)]


def test_what_a_start_has_begun_that_is_over_is_cancelled_and_its_pages_go() -> None:
    bench = Bench(PAGE)
    bench.begun.look()
    assert bench.machine.cancelled == []
    bench.team.ended["w", 1] = "w has ended (done)"
    bench.begun.look()
    assert bench.machine.cancelled == [("w", 2, "w has ended (done)")]
    assert bench.sync() == ([], [key_of(PAGE)])
    bench.begun.look()
    assert len(bench.machine.cancelled) == 1


def test_what_a_barred_start_has_begun_is_cancelled() -> None:
    bench = Bench(PAGE)
    bench.lease.bars.add(("w", 1))
    bench.begun.look()
    ((agent, below, reason),) = bench.machine.cancelled
    assert (agent, below) == ("w", 2)
    assert "no start of w as early as this one may run any more" in reason


def test_of_two_starts_the_calls_of_the_earlier_one_go_on() -> None:
    later = BegunPage("w", 2, 3, "arm", "lift", program=MISSION)
    bench = Bench(PAGE, later)
    bench.team.ended["w", 2] = "the earlier one goes on"
    bench.begun.look()
    assert bench.machine.cancelled == []
    assert bench.machine.forgotten == [("w", 2, 3)]
    assert [call.key for call in bench.machine.running] == [("w", 1, 3)]
    assert bench.sync() == ([], [key_of(later)])


def test_what_the_disk_did_not_take_does_not_begin_later() -> None:
    bench = Bench()
    bench.begins(Walker())
    bench.begun.not_kept()
    assert key_of(PAGE) in bench.sync()[1]
    assert not bench.begins(Walker(kept=True))


def test_with_a_disk_that_takes_nothing_the_coordinator_is_told_and_nothing_is_noted() -> None:
    bench = Bench()
    bench.team.trouble = "its disk fails"
    assert not bench.begins(Walker())
    # `Coordinators.save` tells it.
    assert bench.team.saved == ["w"]
    bench.team.ended["w", 1] = "w has ended (died)"
    bench.begun.look()
    assert begun_key("w", 1, 3) not in bench.sync()[1]


@pytest.mark.parametrize(("page", "state"), [(PAGE, "running"), (DONE, "done")])
def test_what_an_earlier_life_has_begun_is_given_to_the_machine(page: BegunPage, state: str) -> None:
    (call,) = Bench(page).machine.running
    assert (call.key, call.state, call.parcel) == (("w", 1, 3), state, page.parcel)


def test_what_belongs_to_another_mission_stays_where_it_is() -> None:
    bench = Bench(BegunPage("w", 1, 3, "arm", "lift", program=b"o" * 32))
    assert bench.machine.running == []
    bench.team.ended["w", 1] = "w has ended (done)"
    bench.begun.look()
    assert bench.team.keeping.take(1e9) is None
