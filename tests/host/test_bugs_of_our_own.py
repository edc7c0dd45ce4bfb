"""Exceptions planted where there are none: in an agent's turn they end that agent, elsewhere the host."""

from __future__ import annotations

import asyncio

import pytest

from lfield import exits
from lfield.host.core import HostCore
from lfield.host.host import Host
from lfield.host.logbook import Logbook
from lfield.host.process.run import live
from lfield.host.process.stop_words import StopWords
from lfield.host.team.world import HostWorld
from lfield.mobility.core import Mobility
from lfield.net.peers import Peers, Session
from lfield.vm import portals
from lfield.vm.agent import Agent
from lfield.vm.machine import Machine
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import W_ID
from lfield.vm.memory.liveness import Liveness
from lfield.vm.outside import Outsiders
from lfield.vm.reference import Engine
from lfield.vm.scheduler import Scheduler
from lfield.vm.turns import Turns

# Everything that leaves the engine, by one coordinator and its resource, and by another pair.
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
    (Engine, "run"), (Engine, "complete"), (Engine, "throw"),
    (Scheduler, "complete"), (Scheduler, "with_room"), (Scheduler, "open"),
    (Scheduler, "throw"), (Scheduler, "standing"), (portals, "new_thread"), (Scheduler, "flush"),
    (Scheduler, "forget"), (Scheduler, "give_back"), (Scheduler, "uncaught"), (Scheduler, "freeze"),
    (Outsiders, "carry_out"), (Outsiders, "_yield"), (Outsiders, "_sleep"), (Outsiders, "_now"),
    (Outsiders, "_random"), (Outsiders, "_random_int"), (Outsiders, "_find"), (Outsiders, "_find_all"),
    (Outsiders, "_pcall"), (Outsiders, "_write"),
    (Turns, "last"), (Turns, "next"), (Turns, "soon"), (Turns, "sleep"),
    (portals, "call"), (portals, "begin"), (portals, "finish"), (portals, "fail"),
    (HostWorld, "write"), (HostWorld, "log"), (HostWorld, "depart"), (Liveness, "clear_dead"),
]  # fmt: skip


def names(places):
    return [f"{getattr(owner, '__name__', owner)}.{name}" for owner, name in places]


def plant(monkeypatch, owner, name, after=0, only=()):
    """Raise in the call number `after` that is about an agent of `only` (in any, if that is empty)."""
    original = getattr(owner, name)
    seen = []

    def planted(*given, **named):
        if not only or any(whose(value) in only for value in given):
            seen.append(name)
            if len(seen) == after + 1:
                raise ZeroDivisionError("planted")
        return original(*given, **named)

    monkeypatch.setattr(owner, name, planted)
    return seen


def whose(value):
    """The agent that an argument is, or whose block it is."""
    if isinstance(value, Agent):
        return value.id
    return value.string(value.w[W_ID]) if isinstance(value, Block) and value.w[W_ID] else None


@pytest.mark.few(12)
@pytest.mark.parametrize("after", [0, 7])
@pytest.mark.parametrize(("owner", "name"), IN_A_TURN, ids=names(IN_A_TURN))
def test_a_bug_in_the_turn_of_an_agent_ends_that_agent_only(fleet, monkeypatch, owner, name, after):
    seen = plant(monkeypatch, owner, name, after, MINE)

    async def story(team):
        alpha, bravo = await team.up(team.mission(PROGRAM, DEPLOYMENT))
        assert await team.ended("bystander") == "done"
        logs = alpha.log + bravo.log
        assert "bystander: walked to the end" in logs
        assert len(seen) > after, "the planted bug was never reached"
        assert "bug in lfield: ZeroDivisionError: planted" in logs
        assert "died of an uncaught bug in lfield" in logs
        # Whoever it was, the coordinator heard of it: it died itself, or its portal call did.
        assert await team.ended("victim") == "died"
        assert alpha.host.failure is None
        assert bravo.host.failure is None
        assert alpha.host.turn()

    fleet(story)


OF_THE_HOST = [
    (HostCore, "start_resources"), (HostCore, "start_coordinators"), (HostCore, "run"), (HostCore, "take"),
    (HostCore, "linked"), (HostCore, "unlinked"), (HostCore, "arrived"), (HostCore, "received"),
    (Machine, "run"), (Machine, "release"), (Turns, "wake"), (Turns, "pause"),
    (Mobility, "linked"), (Mobility, "arrive"), (Mobility, "receive"),
    (Mobility, "tick"), (Mobility, "unlinked"),
    (Peers, "send"), (Peers, "send_transfer"), (Peers, "gone"), (Host, "_carry_out"),
]  # fmt: skip


@pytest.mark.parametrize(("owner", "name"), OF_THE_HOST, ids=names(OF_THE_HOST))
def test_a_bug_of_the_host_ends_the_host_and_it_feeds_no_guard(fleet, monkeypatch, owner, name):
    async def story(team):
        asyncio.get_running_loop().set_exception_handler(lambda loop, context: unhandled(loop, context))
        mission = team.mission(PROGRAM, DEPLOYMENT)
        alpha, bravo = (team.make(mission, host, unreachable_after=3.0) for host in mission.team.hosts)
        hosts = (alpha.host, bravo.host)

        def unhandled(loop, context):
            for host in hosts:
                host.unhandled(loop, context)

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
            assert not running.host.turn(), "a beat would be given"
            assert (
                f"{running.host.name} ends because of a bug in lfield itself: ZeroDivisionError"
                in running.log
            )
            assert running.log.count("ends because of") == 1
            said = running.log
            await asyncio.sleep(5.0)
            assert running.log == said, "nothing more is done"

    fleet(story)


def test_a_bug_in_a_task_of_the_links_ends_the_host(fleet, monkeypatch):
    async def story(team):
        mission = team.mission(PROGRAM, DEPLOYMENT)
        alpha = team.make(mission, "alpha")
        asyncio.get_running_loop().set_exception_handler(alpha.host.unhandled)
        await alpha.host.start()
        # What the task that keeps links alive sleeps for is no time at all.
        monkeypatch.setattr("lfield.net.peers.PING_EVERY", "a second")
        await asyncio.sleep(5.0)
        assert alpha.host.failure is not None

    fleet(story)


@pytest.mark.parametrize("name", ["note", "flush", "write"])
def test_a_bug_in_the_log_does_not_keep_the_host_from_ending(fleet, monkeypatch, name):
    async def story(team):
        alpha, bravo = await team.up(team.mission(PROGRAM, DEPLOYMENT))

        def planted(*given):
            raise RuntimeError("planted")

        asyncio.get_running_loop().set_exception_handler(alpha.host.unhandled)
        monkeypatch.setattr(Logbook, name, planted)
        await asyncio.sleep(2.0)
        team.network.partition("alpha", "bravo")
        await asyncio.sleep(5.0)
        failed = [running for running in (alpha, bravo) if running.host.failed.is_set()]
        assert failed
        assert not any(running.host.turn() for running in failed)
        monkeypatch.undo()

    fleet(story)


@pytest.mark.parametrize("error", [ConnectionResetError, OSError, ZeroDivisionError])
@pytest.mark.parametrize("place", ["on_message", "on_transfer", "_taken"])
def test_what_a_callback_of_a_link_raises_is_no_lost_connection(fleet, monkeypatch, place, error):
    """The loops take an OSError there for the end of the connection, and say nothing."""

    async def story(team):
        alpha, bravo = await team.up(team.mission(PROGRAM, DEPLOYMENT))

        def unhandled(loop, context):
            for running in (alpha, bravo):
                running.host.unhandled(loop, context)

        asyncio.get_running_loop().set_exception_handler(unhandled)

        def planted(*given):
            raise error("planted")

        monkeypatch.setattr(Session, place, planted)
        await asyncio.sleep(5.0)
        assert isinstance(alpha.host.failure.cause, error)

    fleet(story)


LONELY = """
coordinator Walker { init(string[] arg) { sleep(0.1); %s } }
"""


@pytest.mark.parametrize(
    ("does", "planted", "status"),
    [
        ("print(1);", False, exits.DONE),
        ("print(arg[7]);", False, exits.FAILED),
        ("print(1);", True, exits.SOFTWARE),
    ],
)
def test_until_done_ends_with_what_a_coordinator_died_of(fleet, monkeypatch, does, planted, status):
    if planted:
        plant(monkeypatch, Outsiders, "_sleep")

    async def story(team):
        alpha = team.make(team.mission(LONELY % does, "//Walker:walker@alpha"), "alpha")
        assert await live(alpha.host, StopWords(alpha.host.clock), 30.0) == status

    fleet(story)
