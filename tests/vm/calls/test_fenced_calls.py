"""A fenced coordinator begins no portal call unless its host permits it; a running call can be detached."""

from __future__ import annotations

import random
from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.bytecode.program import Program
from lfield.clock import ManualClock
from lfield.testing.golden import GoldenWorld, compile_text, run_until_idle
from lfield.vm.agent import Agent, MachineTeam, TeamMember
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.inspection.block_view import view
from lfield.vm.machine import Machine

STORE, CLERK = (
    TeamMember(0, "store", "Store", "resource", 0),
    TeamMember(1, "clerk", "Clerk", "coordinator", 0),
)
FAR, LIMITS = TeamMember(2, "far", "Store", "resource", 1), AgentLimits()
#: More instructions than the machine executes before it returns to its host.
BUSY = 20_000
STORES = """
resource Store {
  int kept; boolean go;
  init(string[] arg) { for (int i = 0; i < BUSY; i = i + 1) { } }
  portal add(int n) emit int { kept = kept + n; return kept; }
  portal total() emit int { return kept; }
  portal free() { go = true; }
  portal hold(int[] a) emit int[] { while (!go) sleep(1.0); kept = kept + 1; a[0] = kept; return a; }
  portal synchronized lock() emit int { while (!go) sleep(1.0); throw new DeviceException("late"); }
  portal synchronized after() emit int { return kept; }
}
coordinator Clerk { init(string[] arg) { Store store = findStore("store"); %s } }
"""


@cache
def program(body: str, busy: int) -> Program:
    return compile_text(STORES.replace("BUSY", str(busy)) % body)


class Gate(GoldenWorld):
    """A world with a settable answer, and its requests: whether the portal acts, and whether the block is
    stored."""

    def __init__(self) -> None:
        super().__init__()
        self.open = True
        self.asked: list[tuple[bool, bool]] = []

    def may_start_call(self, agent: Agent, acts: bool) -> bool:
        assert agent.frozen
        assert agent.fenced
        self.asked.append((acts, agent.is_persisted))
        return self.open


class Host:
    """One host with a store, whose init takes `busy` rounds, and a clerk with the code of a test."""

    def __init__(self, body: str, busy: int = 0) -> None:
        self.gate, self.clock = Gate(), ManualClock()
        self.machine = Machine(
            program(body, busy),
            MachineTeam([STORE, CLERK, FAR], 0, 1, {"clerk"}),
            self.gate,
            self.clock,
            random.Random(1),
        )
        self.clerk = self.machine.start(CLERK, LIMITS, 1)
        self.store = self.machine.start(STORE, LIMITS, 1)

    def run(self) -> list[str]:
        run_until_idle(self.machine, self.clock)
        return self.gate.output

    def until(self, seconds: float) -> list[str]:
        """Run for some seconds, in small steps."""
        for _ in range(int(seconds * 10)):
            while self.machine.run() == 0.0:
                pass
            self.clock.advance(0.1)
        return self.gate.output

    @property
    def calls(self) -> int:
        """The number of running portal calls."""
        return len(self.machine._scheduler.calls)


# --- the gate ------------------------------------------------------------------------------------------

SEVERAL = "print(store.add(1)); print(store.total()); print(store.add(1)); print(store.total());"


def test_a_fenced_coordinator_requests_permission_for_every_call() -> None:
    host = Host(SEVERAL)
    assert host.run() == ["1", "1", "2", "2"]
    assert host.gate.asked == [(True, False), (False, False)] * 2
    assert host.clerk.ended == "done"


def test_an_arrived_coordinator_requests_permission_with_a_stored_block() -> None:
    host = Host('findStore("far").add(1); ')
    host.run()
    ((agent, _),) = host.gate.departures
    image = bytes(host.machine.pack(agent))
    gate, clock, rng = Gate(), ManualClock(), random.Random(1)
    machine = Machine(
        host.machine.program, MachineTeam([STORE, CLERK, FAR], 1, 2, {"clerk"}), gate, clock, rng
    )
    machine.start(FAR, LIMITS, 1)
    gate.open = False
    arrived = machine.inject(CLERK, image, LIMITS)
    run_until_idle(machine, clock)
    assert gate.asked == []
    for count in (1, 2, 3):
        machine.unfreeze(arrived)
        run_until_idle(machine, clock)
        assert gate.asked == [(True, True)] * count
        assert arrived.frozen
    gate.open = True
    machine.unfreeze(arrived)
    run_until_idle(machine, clock)
    assert machine.agents["far"].served == 1
    assert not machine.agents.get("clerk")


def test_a_call_that_waited_for_a_resource_is_checked_when_it_would_begin() -> None:
    host = Host("print(store.total());", busy=BUSY)
    host.machine.run()
    assert len(host.store.waiting) == 1
    assert host.gate.asked == []
    host.gate.open = False
    host.run()
    assert host.gate.asked == [(False, False)]
    assert host.clerk.frozen
    assert (host.store.served, host.calls, host.gate.output) == (0, 0, [])
    host.gate.open = True
    host.machine.unfreeze(host.clerk)
    assert host.run() == ["0"]
    assert host.gate.asked == [(False, False)] * 2


def test_a_call_that_may_not_begin_ends_by_an_exception() -> None:
    host = Host("try { store.add(5); } catch (LimitException e) { print(e.message()); } print(store.add(1));")
    host.gate.open = False
    host.run()
    host.clerk.is_persisted = True  # the record of the call is durable
    host.gate.open = True
    host.machine.resume(host.clerk, "LimitException", "no lease", "store")
    assert host.run() == ["no lease", "1"]
    assert host.gate.asked == [(True, False)] * 2


@settings(max_examples=60)
@given(st.lists(st.booleans(), max_size=12))
def test_no_call_begins_while_the_host_refuses(answers: list[bool]) -> None:
    """With any answers of the host, each call begins once, and only after permission."""
    host = Host(SEVERAL)
    yes = 0
    for answer in [*answers, *[True] * 4]:
        host.gate.open = answer
        before = len(host.gate.asked)
        host.machine.unfreeze(host.clerk)
        host.run()
        new = len(host.gate.asked) - before
        yes += new if answer else 0
        assert host.store.served == yes
    assert host.gate.output == ["1", "1", "2", "2"]


# --- a call that is detached from its caller ----------------------------------------------------------

HOLD = """
int[] a = new int[1];
try { a = store.hold(a); } catch (RestartException e) { print(e.message() + " " + e.source()); }
"""
DETACHED = ("RestartException", "the mission is paused")


def test_a_running_call_is_detached_and_its_portal_continues_alone() -> None:
    host = Host(HOLD + "print(store.total()); store.free(); sleep(3.0); print(store.total()); print(a[0]);")
    host.until(8.0)
    assert host.calls == 1
    (thread,) = (t.id for t in view(host.store.block, host.machine.program).threads)
    assert host.machine.served_calls.caller(host.store, thread) is host.clerk
    assert host.machine.detach_caller(host.clerk, *DETACHED)
    assert host.calls == 0
    assert host.machine.served_calls.caller(host.store, thread) is None
    assert not host.machine.detach_caller(host.clerk, *DETACHED)
    # The portal continues, and its result is dropped.
    assert host.run() == ["the mission is paused store", "0", "1", "0"]
    assert (host.clerk.ended, host.store.ended, host.store.served, host.calls) == ("done", "", 4, 0)


def test_a_detached_portal_that_throws_frees_its_monitor() -> None:
    host = Host(
        "try { store.lock(); } catch (RestartException e) { print(e.source()); } store.free();"
        "sleep(3.0); print(store.after());"
    )
    host.until(8.0)
    assert host.machine.detach_caller(host.clerk, *DETACHED)
    assert host.run() == ["store", "0"]
    assert (host.store.ended, host.store.served, host.calls) == ("", 3, 0)


def test_a_call_that_waits_for_its_resource_is_detached() -> None:
    body = "try { store.add(1); } catch (RestartException e) { print(e.source()); } print(store.add(1));"
    host = Host(body, busy=BUSY)
    host.machine.run()
    assert host.store.waiting
    assert host.machine.detach_caller(host.clerk, *DETACHED)
    assert host.store.waiting == []
    assert host.run() == ["store", "1"]


def test_a_coordinator_that_dies_of_the_detach_leaves_its_portal_running() -> None:
    host = Host("store.hold(new int[1]);")
    host.until(8.0)
    assert host.machine.detach_caller(host.clerk, *DETACHED)
    assert host.clerk.ended == "died"
    assert host.clerk.report.startswith("RestartException: the mission is paused\n    at Clerk.init")
    host.until(3.0)
    assert (host.store.ended, host.calls) == ("", 0)


def test_the_death_of_a_resource_with_a_detached_call_affects_no_caller() -> None:
    host = Host(HOLD + "sleep(20.0);")
    host.until(8.0)
    assert host.machine.detach_caller(host.clerk, *DETACHED)
    host.machine._scheduler.die(host.store, "bug")
    host.run()
    assert host.clerk.ended == "done"


@pytest.mark.parametrize("body", ["sleep(100.0);", "while (true) { }", 'findStore("far").total();'])
def test_a_coordinator_without_a_portal_call_is_not_affected(body: str) -> None:
    host = Host(body)
    host.until(1.0) if "while" not in body else host.machine.run()
    assert not host.machine.detach_caller(host.clerk, *DETACHED)
    assert not host.machine.detach_caller(host.store, *DETACHED)
    assert not host.clerk.ended


def test_a_coordinator_frozen_before_its_call_is_not_affected() -> None:
    host = Host("store.add(1);")
    host.gate.open = False
    host.run()
    assert host.clerk.frozen
    assert not host.machine.detach_caller(host.clerk, *DETACHED)
    host.gate.open = True
    host.machine.unfreeze(host.clerk)
    host.run()
    assert (host.clerk.ended, host.store.served) == ("done", 1)
    assert not host.machine.detach_caller(host.clerk, *DETACHED)
