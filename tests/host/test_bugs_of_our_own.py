"""Planted exceptions: in the turn of an agent they end that agent, elsewhere the host."""

from __future__ import annotations

import asyncio

import pytest

from lfield import exit_status
from lfield.host.core import HostCore
from lfield.host.host import Host
from lfield.host.logbook import Logbook
from lfield.host.process.host_process import run_until_exit
from lfield.host.process.shutdown_signals import ShutdownSignals
from lfield.host.team.host_services import HostServices
from lfield.net.link_manager import LinkManager, Session
from lfield.replication.transfer.core import Mobility
from lfield.vm import portal_calls
from lfield.vm.agent import Agent
from lfield.vm.host_calls import HostCallDispatcher
from lfield.vm.machine import Machine
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import W_ID
from lfield.vm.memory.liveness import Liveness
from lfield.vm.reference import ReferenceEngine
from lfield.vm.scheduler import Scheduler
from lfield.vm.turns.run_queue import RunQueue

# All features of the engine, used by one coordinator and its resource, and by another pair.
PROGRAM = """
class Trouble { private int why; public Trouble() { why = 7; } }
resource Post {
    int count;
    init(string[] arg) { write("up\\n"); sleep(0.1); }
    portal echo(string text) emit string { yield(); write(text); return text + "!"; }
    portal fail() { throw new Trouble(); }
    portal big(int[] many) emit int { return many.length(); }
    portal stay(real seconds) { sleep(seconds); }
}
coordinator Walker {
    init(string[] arg) {
        Post near = findPost(arg[1]);
        Post far = findPost(arg[2]);
        int round = 0;
        while (round < 40) {
            print(i2s(round) + f2s(now() - now()) + i2s(random(3)) + f2s(random() * 0.0));
            near = findPost(arg[1]);
            near.echo("a");
            far.echo("b\\n");
            try { near.fail(); } catch (Trouble expected) { }
            int[] many = new int[1000];
            near.big(many);
            Post[] all = findPost();
            sleep(0.5);
            yield();
            round = round + 1;
        }
        print("walked to the end");
    }
}
"""
DEPLOYMENT = """
//Post:vnear@alpha
//Post:vfar@bravo
//Post:near@alpha
//Post:far@bravo
//Walker:victim@alpha?vnear&vfar
//Walker:bystander@alpha?near&far
"""
MINE = ("victim", "vnear", "vfar")

IN_A_TURN = [
    (Machine, "_done"), (Machine, "_turn"), (Machine, "pack"),
    (ReferenceEngine, "run"), (ReferenceEngine, "complete"), (ReferenceEngine, "throw"),
    (Scheduler, "complete"), (Scheduler, "run_with_collection"), (Scheduler, "open"),
    (Scheduler, "throw"), (Scheduler, "instruction_of"), (Block, "new_thread"), (Scheduler, "flush"),
    (Scheduler, "forget"), (Scheduler, "release_monitor"), (Scheduler, "uncaught"), (Agent, "depart_for"),
    (HostCallDispatcher, "dispatch"), (HostCallDispatcher, "_yield"), (HostCallDispatcher, "_sleep"),
    (HostCallDispatcher, "_now"),
    (HostCallDispatcher, "_random"), (HostCallDispatcher, "_random_int"), (HostCallDispatcher, "_find"),
    (HostCallDispatcher, "_find_all"),
    (HostCallDispatcher, "_pcall"), (HostCallDispatcher, "_write"),
    (RunQueue, "push_back"), (RunQueue, "push_front"), (RunQueue, "push_ready_front"), (RunQueue, "sleep"),
    (portal_calls, "call"), (portal_calls, "start_call"), (portal_calls, "finish"), (portal_calls, "fail"),
    (HostServices, "write"), (HostServices, "log"), (HostServices, "depart"), (Liveness, "clear_dead"),
]  # fmt: skip


def names(places):
    return [f"{getattr(owner, '__name__', owner)}.{name}" for owner, name in places]


def plant(monkeypatch, owner, name, after=0, only=()):
    """Raise in call number `after` that concerns an agent of `only` (any agent, if that is empty)."""
    original = getattr(owner, name)
    calls = []

    def planted(*given, **named):
        if not only or any(agent_of(value) in only for value in given):
            calls.append(name)
            if len(calls) == after + 1:
                raise ZeroDivisionError("planted")
        return original(*given, **named)

    monkeypatch.setattr(owner, name, planted)
    return calls


def agent_of(value):
    """The agent of an argument, or of its block."""
    if isinstance(value, Agent):
        return value.id
    return value.string(value.w[W_ID]) if isinstance(value, Block) and value.w[W_ID] else None


@pytest.mark.few(4)
@pytest.mark.parametrize("after", [0, 7])
@pytest.mark.parametrize(("owner", "name"), IN_A_TURN, ids=names(IN_A_TURN))
async def test_a_bug_in_the_turn_of_an_agent_ends_only_that_agent(team, /, monkeypatch, owner, name, after):
    calls = plant(monkeypatch, owner, name, after, MINE)

    alpha, bravo = await team.up(team.mission(PROGRAM, DEPLOYMENT))
    assert await team.ended("bystander") == "done"
    logs = alpha.log + bravo.log
    assert "bystander: walked to the end" in logs
    assert len(calls) > after, "the planted bug was never reached"
    assert "bug in lfield: ZeroDivisionError: planted" in logs
    assert "died of an uncaught bug in lfield" in logs
    # The coordinator fails in either case: itself, or its portal call.
    assert await team.ended("victim") == "died"
    assert alpha.host.failure is None
    assert bravo.host.failure is None
    assert alpha.host.step()


OF_THE_HOST = [
    (HostCore, "start_resources"), (HostCore, "start_coordinators"), (HostCore, "run"),
    (HostCore, "drain_effects"),
    (HostCore, "on_linked"), (HostCore, "on_unlinked"), (HostCore, "on_transfer"), (HostCore, "on_message"),
    (Machine, "run"), (Machine, "release"), (RunQueue, "pop_due"), (RunQueue, "seconds_until_due"),
    (Mobility, "on_linked"), (Mobility, "on_transfer"), (Mobility, "on_message"),
    (Mobility, "tick"), (Mobility, "on_unlinked"),
    (LinkManager, "send"), (LinkManager, "send_transfer"), (LinkManager, "on_link_closed"),
    (Host, "_execute"),
]  # fmt: skip


def lines_of_core(running):
    """The log without lines of the links: until its process ends, a failed host dials others at any time."""
    return [line for line in running.log.splitlines() if " unreachable at " not in line]


@pytest.mark.few(10)
@pytest.mark.parametrize(("owner", "name"), OF_THE_HOST, ids=names(OF_THE_HOST))
async def test_a_bug_of_the_host_ends_the_host_without_a_further_beat(team, /, monkeypatch, owner, name):
    asyncio.get_running_loop().set_exception_handler(lambda loop, context: unhandled(loop, context))
    mission = team.mission(PROGRAM, DEPLOYMENT)
    alpha, bravo = (team.make(mission, host, unreachable_after=3.0) for host in mission.team.hosts)
    hosts = (alpha.host, bravo.host)

    def unhandled(loop, context):
        for host in hosts:
            host.on_unhandled(loop, context)

    plant(monkeypatch, owner, name)
    await asyncio.gather(*(host.start() for host in hosts))
    await asyncio.sleep(5.0)
    if not any(host.failure for host in hosts):
        team.network.partition("alpha", "bravo")
        await asyncio.sleep(5.0)
    failed = [running for running in (alpha, bravo) if running.host.failure]
    assert failed
    for running in failed:
        assert isinstance(running.host.failure.cause, ZeroDivisionError)
        assert running.host.failed.is_set()
        assert not running.host.step(), "a heartbeat would be sent"
        assert f"{running.host.name} stopped: bug in lfield: ZeroDivisionError" in running.log
        assert running.log.count("stopped: bug in lfield") == 1
        lines = lines_of_core(running)
        await asyncio.sleep(5.0)
        assert lines_of_core(running) == lines, "the host still acts"


async def test_a_bug_in_a_task_of_the_links_ends_the_host(team, /, monkeypatch):
    mission = team.mission(PROGRAM, DEPLOYMENT)
    alpha = team.make(mission, "alpha")
    asyncio.get_running_loop().set_exception_handler(alpha.host.on_unhandled)
    await alpha.host.start()
    # The interval of the heartbeats is no number.
    monkeypatch.setattr("lfield.net.link_manager.PING_EVERY", "a second")
    await asyncio.sleep(5.0)
    assert alpha.host.failure is not None


@pytest.mark.parametrize("name", ["note", "flush", "write"])
async def test_a_bug_in_the_log_does_not_prevent_the_end_of_the_host(team, /, monkeypatch, name):
    alpha, bravo = await team.up(team.mission(PROGRAM, DEPLOYMENT))

    def planted(*given):
        raise RuntimeError("planted")

    asyncio.get_running_loop().set_exception_handler(alpha.host.on_unhandled)
    monkeypatch.setattr(Logbook, name, planted)
    await asyncio.sleep(2.0)
    team.network.partition("alpha", "bravo")
    await asyncio.sleep(5.0)
    failed = [running for running in (alpha, bravo) if running.host.failed.is_set()]
    assert failed
    assert not any(running.host.step() for running in failed)
    monkeypatch.undo()


@pytest.mark.parametrize("error", [ConnectionResetError, OSError, ZeroDivisionError])
@pytest.mark.parametrize("place", ["on_message", "on_transfer", "_on_accepted"])
async def test_an_exception_in_a_link_callback_is_not_reported_as_a_lost_connection(
    team, /, monkeypatch, place, error
):
    """The event loops treat an OSError there as the end of the connection, without a report."""
    alpha, bravo = await team.up(team.mission(PROGRAM, DEPLOYMENT))

    def unhandled(loop, context):
        for running in (alpha, bravo):
            running.host.on_unhandled(loop, context)

    asyncio.get_running_loop().set_exception_handler(unhandled)

    def planted(*given):
        raise error("planted")

    monkeypatch.setattr(Session, place, planted)
    await asyncio.sleep(5.0)
    assert isinstance(alpha.host.failure.cause, error)


LONELY = """
coordinator Walker { init(string[] arg) { sleep(0.1); %s } }
"""


@pytest.mark.parametrize(
    ("does", "planted", "status"),
    [
        ("print(1);", False, exit_status.DONE),
        ("print(arg[7]);", False, exit_status.FAILED),
        ("print(1);", True, exit_status.SOFTWARE),
    ],
)
async def test_the_exit_status_of_until_done_tells_how_a_coordinator_ended(
    team, /, monkeypatch, does, planted, status
):
    if planted:
        plant(monkeypatch, HostCallDispatcher, "_sleep")

    alpha = team.make(team.mission(LONELY % does, "//Walker:walker@alpha"), "alpha")
    assert await run_until_exit(alpha.host, ShutdownSignals(alpha.host.clock), 30.0) == status
