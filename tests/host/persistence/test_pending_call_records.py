"""The records of pending calls of a host, and when they are deleted. Machine and mobility are fakes."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from lfield.clock import ManualClock
from lfield.host.context import WriteFailed
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
    """A coordinator, with the attributes that the store reads."""

    id: str = "w"
    generation: int = 1
    is_persisted: bool = False


@dataclass
class Engine:
    """A machine that records the calls of its methods."""

    running: list[PendingCall] = field(default_factory=list)
    persisted: list[Any] = field(default_factory=list)
    cancelled: list[Any] = field(default_factory=list)
    forgotten: list[Any] = field(default_factory=list)
    fetched: list[Any] = field(default_factory=list)

    @property
    def pending_calls(self) -> Engine:
        return self

    def calls(self) -> list[PendingCall]:
        return self.running

    def restore(self, calls: Any) -> None:
        self.running += calls

    def on_persisted(self, key: Any) -> None:
        self.persisted.append(key)

    def cancel(self, agent: str, below: int, reason: str) -> None:
        self.cancelled.append((agent, below, reason))
        self.running = [c for c in self.running if c.agent != agent or c.generation >= below]

    def forget(self, keys: Any) -> None:
        self.forgotten += keys
        self.running = [c for c in self.running if c.key not in self.forgotten]

    def drain_fetched(self, agent: Walker) -> list[Any]:
        keys, self.fetched = self.fetched, []
        return keys


class Team:
    """Coordinators and mobility in one: `end_reason` has the ended starts, `sent` those that left."""

    def __init__(self) -> None:
        self.write_ahead, self.write_problem, self.mobility = WriteAheadQueue(), "", self
        self.ended: dict[tuple[str, int], str] = {}
        self.sent: set[tuple[str, int]] = set()
        self.saved: list[str] = []
        self.persisted: set[tuple[str, int]] = set()

    def save(self, agent: Walker) -> bool:
        self.saved.append(agent.id)
        self.write_ahead.put([PersistRecord(agent.id, PAGE), ResumeCopy(agent.id, agent.generation)], 0.0)
        return False

    def end_reason(self, agent: str, generation: int) -> str:
        return self.ended.get((agent, generation), "")

    def was_sent(self, agent: str, generation: int) -> bool:
        return (agent, generation) in self.sent


class Lease:
    """Leases that all hold unless a start is barred."""

    leased_agents: frozenset[str] = frozenset()

    def __init__(self) -> None:
        self.bars: set[tuple[str, int]] = set()
        self.team: Team

    def may_start_call(self, agent: Walker) -> bool:
        return (agent.id, agent.generation) not in self.bars

    def is_fenced(self, agent: str, generation: int) -> bool:
        return (agent, generation) in self.bars

    def end_reason(self, agent: str, generation: int) -> str:
        reason = f"this start of {agent} is fenced"
        return reason if self.is_fenced(agent, generation) else self.team.end_reason(agent, generation)


class Bench:
    """The pending call records of one host, with fakes around them."""

    def __init__(self, *pages: PendingCallRecord, keeps: bool = True) -> None:
        self.team, self.lease, self.machine = Team(), Lease(), Engine()
        self.lease.team = self.team
        arguments: Any = self.team, self.lease, self.machine
        context: Any = SimpleNamespace(
            greeting=SimpleNamespace(mission_hash=MISSION),
            clock=ManualClock(),
            records=pages,
            has_journal=keeps,
        )
        self.store = PendingCallStore(context, *arguments)
        self.store.restore()

    def begins(self, walker: Walker) -> bool:
        agent: Any = walker
        return self.store.may_start_calls(agent, [LIFT])

    def sync(self) -> tuple[list[Any], list[Any]]:
        """Records that are durable now, and keys that are deleted."""
        batch = self.team.write_ahead.next_batch(1e9)
        assert batch is not None
        number, pages, keys = batch
        self.team.write_ahead.on_durable(number)
        self.team.write_ahead.run_actions()
        return pages, keys

    def back(self) -> None:
        self.store.on_call_completed(PendingCall("w", 1, 3, "arm", "lift", state="done", result=b"42"))


def test_no_call_begins_before_its_record_and_block_are_durable() -> None:
    bench, walker = Bench(), Walker()
    assert not bench.begins(walker)
    assert bench.team.saved == ["w"]
    # Another attempt meanwhile waits and stores nothing twice.
    assert not bench.begins(walker)
    assert bench.sync() == ([PAGE], [])
    walker.is_persisted = True
    assert bench.begins(walker)
    assert bench.team.saved == ["w"]


def test_the_first_call_of_an_arrived_coordinator_is_recorded() -> None:
    bench, walker = Bench(), Walker(is_persisted=True)
    assert not bench.begins(walker)
    bench.sync()
    assert bench.begins(walker)


def test_a_result_is_delivered_only_after_it_is_durable() -> None:
    bench = Bench()
    bench.begins(Walker())
    bench.sync()
    bench.back()
    assert bench.machine.persisted == []
    assert bench.sync() == ([DONE], [])
    assert bench.machine.persisted == [("w", 1, 3)]


def test_a_host_without_a_journal_does_not_wait() -> None:
    bench = Bench(keeps=False)
    assert bench.begins(Walker())
    bench.back()
    assert bench.machine.persisted == [("w", 1, 3)]
    assert bench.team.write_ahead.next_batch(1e9) is None


def test_a_fetched_result_is_deleted_after_the_coordinator_has_left() -> None:
    bench, walker = Bench(DONE), Walker()
    bench.machine.fetched = [("w", 1, 3)]
    agent: Any = walker
    bench.store.on_departing(agent)
    bench.store.on_tick(0.0)
    # It waits for a link: nothing is sent, and no record has changed.
    assert bench.team.write_ahead.next_batch(1e9) is None
    bench.team.sent.add(("w", 1))
    bench.store.on_tick(0.0)
    assert bench.sync() == ([], [key_of(DONE)])


def test_a_fetched_result_is_deleted_with_the_next_block_kept_here() -> None:
    bench = Bench(DONE)
    bench.machine.fetched = [("w", 1, 3)]
    agent: Any = Walker()
    bench.store.on_save(agent)
    assert bench.sync()[1] == [key_of(DONE)]


def test_calls_of_an_ended_start_are_cancelled_and_their_records_deleted() -> None:
    bench = Bench(PAGE)
    bench.store.on_tick(0.0)
    assert bench.machine.cancelled == []
    bench.team.ended["w", 1] = "w has ended (done)"
    bench.store.on_tick(0.0)
    assert bench.machine.cancelled == [("w", 2, "w has ended (done)")]
    assert bench.sync() == ([], [key_of(PAGE)])
    bench.store.on_tick(0.0)
    assert len(bench.machine.cancelled) == 1


def test_calls_of_a_fenced_start_are_cancelled() -> None:
    bench = Bench(PAGE)
    bench.lease.bars.add(("w", 1))
    bench.store.on_tick(0.0)
    ((agent, below, reason),) = bench.machine.cancelled
    assert (agent, below) == ("w", 2)
    assert "this start of w is fenced" in reason


def test_calls_of_an_earlier_start_continue_when_the_later_one_ended() -> None:
    later = PendingCallRecord("w", 2, 3, "arm", "lift", program=MISSION)
    bench = Bench(PAGE, later)
    bench.team.ended["w", 2] = "the earlier one continues"
    bench.store.on_tick(0.0)
    assert bench.machine.cancelled == []
    assert bench.machine.forgotten == [("w", 2, 3)]
    assert [call.key for call in bench.machine.running] == [("w", 1, 3)]
    assert bench.sync() == ([], [key_of(later)])


def test_a_call_whose_write_failed_does_not_begin_later() -> None:
    bench = Bench()
    bench.begins(Walker())
    bench.store.observes[WriteFailed](WriteFailed("full"))
    assert key_of(PAGE) in bench.sync()[1]
    assert not bench.begins(Walker(is_persisted=True))


def test_a_failing_disk_reports_to_the_coordinator_and_records_nothing() -> None:
    bench = Bench()
    bench.team.write_problem = "its disk fails"
    assert not bench.begins(Walker())
    # `Coordinators.save` reports it.
    assert bench.team.saved == ["w"]
    bench.team.ended["w", 1] = "w has ended (died)"
    bench.store.on_tick(0.0)
    assert pending_call_key("w", 1, 3) not in bench.sync()[1]


@pytest.mark.parametrize(("page", "state"), [(PAGE, "running"), (DONE, "done")])
def test_calls_of_an_earlier_life_are_restored_in_the_machine(page: PendingCallRecord, state: str) -> None:
    (call,) = Bench(page).machine.running
    assert (call.key, call.state, call.result) == (("w", 1, 3), state, page.result)


def test_records_of_another_mission_are_left_unchanged() -> None:
    bench = Bench(PendingCallRecord("w", 1, 3, "arm", "lift", program=b"o" * 32))
    assert bench.machine.running == []
    bench.team.ended["w", 1] = "w has ended (done)"
    bench.store.on_tick(0.0)
    assert bench.team.write_ahead.next_batch(1e9) is None
