"""What a host keeps of calls that were begun on it, and when that goes. Machine and mobility stand in."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from lfield.clock import ManualClock
from lfield.host.context import RecordsDurable, WriteFailed
from lfield.host.migration.write_ahead import WriteAheadQueue
from lfield.host.team.pending_call_store import PendingCallStore
from lfield.journal.records import PendingCallRecord, key_of, pending_call_key
from lfield.replication.transfer.effects import PersistRecord, ResumeCopy
from lfield.vm.pending_call import CallRequest, PendingCall

MISSION = b"m" * 32
LIFT = CallRequest(3, "arm", "lift", has_side_effects=True)
PAGE = PendingCallRecord("w", 1, 3, "arm", "lift", program=MISSION)
DONE = PendingCallRecord("w", 1, 3, "arm", "lift", "done", b"42", MISSION)


@dataclass(eq=False)
class Walker:
    """A coordinator, as far as the host looks at it."""

    id: str = "w"
    generation: int = 1
    is_persisted: bool = False


@dataclass
class Engine:
    """A machine that notes what it is told."""

    running: list[PendingCall] = field(default_factory=list)
    told: list[Any] = field(default_factory=list)
    cancelled: list[Any] = field(default_factory=list)
    forgotten: list[Any] = field(default_factory=list)
    has: list[Any] = field(default_factory=list)

    @property
    def pending_calls(self) -> Engine:
        return self

    def calls(self) -> list[PendingCall]:
        return self.running

    def restore(self, calls: Any) -> None:
        self.running += calls

    def on_persisted(self, key: Any) -> None:
        self.told.append(key)

    def cancel(self, agent: str, below: int, reason: str) -> None:
        self.cancelled.append((agent, below, reason))
        self.running = [c for c in self.running if c.agent != agent or c.generation >= below]

    def forget(self, keys: Any) -> None:
        self.forgotten += keys
        self.running = [c for c in self.running if c.key not in self.forgotten]

    def drain_fetched(self, agent: Walker) -> list[Any]:
        keys, self.has = self.has, []
        return keys


class Team:
    """Coordinators and mobility in one: `end_reason` has the starts that have ended, `sent` those that
    left.
    """

    def __init__(self) -> None:
        self.write_ahead, self.write_trouble, self.mobility = WriteAheadQueue(), "", self
        self.ended: dict[tuple[str, int], str] = {}
        self.sent: set[tuple[str, int]] = set()
        self.saved: list[str] = []
        self.told: set[tuple[str, int]] = set()

    def save(self, agent: Walker) -> bool:
        self.saved.append(agent.id)
        self.write_ahead.put([PersistRecord(agent.id, PAGE), ResumeCopy(agent.id, agent.generation)], 0.0)
        return False

    def end_reason(self, agent: str, generation: int) -> str:
        return self.ended.get((agent, generation), "")

    def was_sent(self, agent: str, generation: int) -> bool:
        return (agent, generation) in self.sent


class Lease:
    """Leases, which all hold unless a start is barred."""

    leased_agents: frozenset[str] = frozenset()

    def __init__(self) -> None:
        self.bars: set[tuple[str, int]] = set()
        self.team: Team

    def may_start_call(self, agent: Walker) -> bool:
        return (agent.id, agent.generation) not in self.bars

    def is_fenced(self, agent: str, generation: int) -> bool:
        return (agent, generation) in self.bars

    def end_reason(self, agent: str, generation: int) -> str:
        why = f"this start of {agent} is fenced"
        return why if self.is_fenced(agent, generation) else self.team.end_reason(agent, generation)


class Bench:
    """The pages of one host, with all that stands around them."""

    def __init__(self, *pages: PendingCallRecord, keeps: bool = True) -> None:
        self.team, self.lease, self.machine = Team(), Lease(), Engine()
        self.lease.team = self.team
        given: Any = self.team, self.lease, self.machine
        context: Any = SimpleNamespace(
            greeting=SimpleNamespace(mission_hash=MISSION),
            clock=ManualClock(),
            records=pages,
            has_journal=keeps,
        )
        self.begun = PendingCallStore(context, *given)
        self.begun.restore()

    def begins(self, walker: Walker) -> bool:
        agent: Any = walker
        return self.begun.may_start_calls(agent, [LIFT])

    def sync(self) -> tuple[list[Any], list[Any]]:
        """What has come to the disk by now, and what is gone from it."""
        batch = self.team.write_ahead.next_batch(1e9)
        assert batch is not None
        number, pages, keys = batch
        self.team.write_ahead.on_durable(number)
        self.begun.observes[RecordsDurable](RecordsDurable(number))
        return pages, keys

    def back(self) -> None:
        self.begun.on_call_completed(PendingCall("w", 1, 3, "arm", "lift", state="done", result=b"42"))


def test_no_call_begins_before_its_page_and_the_block_of_its_coordinator_are_on_the_disk() -> None:
    bench, walker = Bench(), Walker()
    assert not bench.begins(walker)
    assert bench.team.saved == ["w"]
    # Asked again meanwhile, it waits on, and keeps nothing twice.
    assert not bench.begins(walker)
    assert bench.sync() == ([PAGE], [])
    walker.is_persisted = True
    assert bench.begins(walker)
    assert bench.team.saved == ["w"]


def test_a_coordinator_that_has_just_come_has_its_calls_kept_all_the_same() -> None:
    bench, walker = Bench(), Walker(is_persisted=True)
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
    assert bench.team.write_ahead.next_batch(1e9) is None


def test_what_was_fetched_goes_when_a_page_of_the_coordinator_has_it() -> None:
    bench, walker = Bench(DONE), Walker()
    bench.machine.has = [("w", 1, 3)]
    agent: Any = walker
    bench.begun.on_departing(agent)
    bench.begun.on_tick(0.0)
    # It waits for a link: nothing is sent, and no page says anything new.
    assert bench.team.write_ahead.next_batch(1e9) is None
    bench.team.sent.add(("w", 1))
    bench.begun.on_tick(0.0)
    assert bench.sync() == ([], [key_of(DONE)])


def test_what_was_fetched_goes_with_the_block_that_is_kept_for_a_further_call_here() -> None:
    bench = Bench(DONE)
    bench.machine.has = [("w", 1, 3)]
    agent: Any = Walker()
    bench.begun.on_save(agent)
    assert bench.sync()[1] == [key_of(DONE)]


def test_what_a_start_has_begun_that_is_over_is_cancelled_and_its_pages_go() -> None:
    bench = Bench(PAGE)
    bench.begun.on_tick(0.0)
    assert bench.machine.cancelled == []
    bench.team.ended["w", 1] = "w has ended (done)"
    bench.begun.on_tick(0.0)
    assert bench.machine.cancelled == [("w", 2, "w has ended (done)")]
    assert bench.sync() == ([], [key_of(PAGE)])
    bench.begun.on_tick(0.0)
    assert len(bench.machine.cancelled) == 1


def test_what_a_barred_start_has_begun_is_cancelled() -> None:
    bench = Bench(PAGE)
    bench.lease.bars.add(("w", 1))
    bench.begun.on_tick(0.0)
    ((agent, below, reason),) = bench.machine.cancelled
    assert (agent, below) == ("w", 2)
    assert "this start of w is fenced" in reason


def test_of_two_starts_the_calls_of_the_earlier_one_go_on() -> None:
    later = PendingCallRecord("w", 2, 3, "arm", "lift", program=MISSION)
    bench = Bench(PAGE, later)
    bench.team.ended["w", 2] = "the earlier one goes on"
    bench.begun.on_tick(0.0)
    assert bench.machine.cancelled == []
    assert bench.machine.forgotten == [("w", 2, 3)]
    assert [call.key for call in bench.machine.running] == [("w", 1, 3)]
    assert bench.sync() == ([], [key_of(later)])


def test_what_the_disk_did_not_take_does_not_begin_later() -> None:
    bench = Bench()
    bench.begins(Walker())
    bench.begun.observes[WriteFailed](WriteFailed("full"))
    assert key_of(PAGE) in bench.sync()[1]
    assert not bench.begins(Walker(is_persisted=True))


def test_with_a_disk_that_takes_nothing_the_coordinator_is_told_and_nothing_is_noted() -> None:
    bench = Bench()
    bench.team.write_trouble = "its disk fails"
    assert not bench.begins(Walker())
    # `Coordinators.save` tells it.
    assert bench.team.saved == ["w"]
    bench.team.ended["w", 1] = "w has ended (died)"
    bench.begun.on_tick(0.0)
    assert pending_call_key("w", 1, 3) not in bench.sync()[1]


@pytest.mark.parametrize(("page", "state"), [(PAGE, "running"), (DONE, "done")])
def test_what_an_earlier_life_has_begun_is_given_to_the_machine(page: PendingCallRecord, state: str) -> None:
    (call,) = Bench(page).machine.running
    assert (call.key, call.state, call.result) == (("w", 1, 3), state, page.result)


def test_what_belongs_to_another_mission_stays_where_it_is() -> None:
    bench = Bench(PendingCallRecord("w", 1, 3, "arm", "lift", program=b"o" * 32))
    assert bench.machine.running == []
    bench.team.ended["w", 1] = "w has ended (done)"
    bench.begun.on_tick(0.0)
    assert bench.team.write_ahead.next_batch(1e9) is None
