"""The buttons of a watched team with real hosts, in virtual time."""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager

import pytest
from coroutine_tests import scenario

from lfield.client.capability_query import TeamQueries
from lfield.client.team_actions import TeamActions
from lfield.client.team_connection import TeamConnection
from lfield.client.team_watch import TeamWatch
from lfield.errors import UsageError
from lfield.operator.dashboard.event_stream.event_follower import EventFollower
from lfield.operator.dashboard.event_stream.host_locator import HostLocator
from lfield.operator.targets import TargetTeam
from lfield.operator.team_model.team_contents import team_contents
from lfield.simulate.jumping_loop import LoopClock

PROGRAM = """
resource Hoist {
    init(string[] arg) { while (true) yield(); }
    portal lift(real height) emit real { return height; }
    portal lower(real height) emit real { return height; }
}
coordinator Boss {
    init(string[] arg) {
        Lift[] who = findLift("payload >= 2.0");
        while (true) sleep(1.0);
    }
}
"""
TEAM = "//Hoist:arm1@alpha\n//Hoist:arm2@beta\n//Boss:boss@alpha\n"
CAPABILITIES = """
registry: 1
providers: {Hoist: {attributes: {payload: 20.0}, serves: {Lift: {}}}}
agents: {arm2: {payload: 1.2}}
"""


@asynccontextmanager
async def operated(fleet, mission, asked=None, dialled=None):
    """`dialled` collects the addresses to which the desk connects."""
    team = TargetTeam((), mission.team.addresses_by_host)
    reach = HostLocator(team, lambda: [])
    transport = fleet.network.transport("desk")
    connect = transport.connect

    async def counted(address, handler, host=""):
        if dialled is not None:
            dialled.append(address)
        return await connect(address, handler)

    transport.connect = counted
    watch = TeamWatch(team_contents("team", mission.team, mission), LoopClock())

    def ask():
        if asked is None:
            return TeamQueries(fleet.folder / "mission.dL", mission.team)
        raise UsageError(asked)

    async def at_once(work, *args):
        return work(*args)

    follower = EventFollower(transport, reach.hosts, reach, watch, LoopClock())
    watch.actions = TeamActions(
        TeamConnection(transport, reach), watch, ask, open_links=follower.order, run_in_thread=at_once
    )
    task = asyncio.create_task(follower.run())
    try:
        await fleet.until(lambda: all(host.linked for host in watch.snapshot().hosts.values() if host.host))
        yield watch
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


@pytest.fixture
def operate(fleet):
    """Runs a test with a watched team of two hosts."""

    def run(steps, asked=None, dialled=None) -> None:
        async def main(fleet) -> None:
            mission = fleet.mission(PROGRAM, TEAM, capabilities=CAPABILITIES)
            hosts = await fleet.up(mission)
            async with operated(fleet, mission, asked, dialled) as watch:
                await steps(fleet, watch, hosts)

        fleet(main)

    return run


@scenario("operate")
async def test_a_stop_is_shown_until_it_is_lifted(fleet, shown, hosts, /) -> None:
    done = await shown.actions.stop("a child")
    assert (done.order, done.is_complete, done.unreached) == ("stop", True, {})
    await fleet.until(lambda: shown.snapshot().stop.hosts == ("alpha", "beta"))
    stop = shown.snapshot().stop
    assert stop.reason == "the emergency stop was pressed: a child"
    assert stop.is_complete
    assert (await shown.actions.lift()).is_complete
    await fleet.until(lambda: not shown.snapshot().stop.is_active)


def test_orders_use_open_connections_and_dial_where_there_is_none(operate) -> None:
    dialled: list[str] = []

    async def steps(fleet, shown, hosts) -> None:
        actions = shown.actions
        assert len(dialled) == len(hosts)
        for order in (actions.stop, actions.lift, actions.pause, actions.resume):
            done = await order()
            assert (done.is_complete, done.unreached) == (True, {})
        assert len(dialled) == len(hosts)
        await hosts[1].host.stop()
        del dialled[:]
        assert list((await actions.stop()).unreached) == ["beta"]
        assert dialled
        assert len(set(dialled)) == 1

    operate(steps, dialled=dialled)


@scenario("operate")
async def test_a_pause_is_shown_until_it_ends(fleet, shown, hosts, /) -> None:
    assert (await shown.actions.pause()).is_complete
    await fleet.until(lambda: shown.snapshot().paused == ("alpha", "beta"))
    assert (await shown.actions.resume()).is_complete
    await fleet.until(lambda: shown.snapshot().paused == ())


@scenario("operate")
async def test_an_unreached_host_is_named_by_a_stop_and_in_the_display(fleet, shown, hosts, /) -> None:
    await hosts[1].host.stop()
    done = await shown.actions.stop()
    assert list(done.unreached) == ["beta"]
    assert not done.is_complete
    await fleet.until(lambda: shown.snapshot().stop.is_active)
    stop = shown.snapshot().stop
    assert (stop.hosts, list(stop.unreached), stop.is_complete) == (("alpha",), ["beta"], False)


@scenario("operate")
async def test_a_query_is_answered_and_a_wrong_one_is_marked(fleet, shown, hosts, /) -> None:
    answer = await shown.actions.query("Lift where payload >= 2.0")
    (found,) = answer.found
    assert [offer.agent for offer in found.offers] == ["arm1"]
    assert [refusal.reasons for refusal in found.refusals if refusal.subject == "arm2"] == [
        ("payload 1.2 < 2.0",)
    ]
    wrong = await shown.actions.query("Lift where paylod >= 2.0")
    assert (wrong.found, "^" in wrong.mistakes, "paylod" in wrong.mistakes) == ((), True, True)
    assert (await shown.actions.query("Lift where where where")).mistakes


@scenario("operate")
async def test_a_query_without_any_running_host_is_answered_from_the_files_with_a_note(
    fleet, shown, hosts, /
) -> None:
    for each in hosts:
        await each.host.stop()
    answer = await shown.actions.query("Lift where payload >= 2.0")
    assert set(answer.unanswered) == {"alpha", "beta"}
    (found,) = answer.found
    assert [offer.agent for offer in found.offers] == ["arm1"]
    assert "from the files" in found.notes[0]


@scenario("operate", asked="the files are elsewhere")
async def test_a_query_without_mission_files_reports_the_reason(fleet, shown, hosts, /) -> None:
    answer = await shown.actions.query("Lift")
    assert answer.mistakes == "the files are elsewhere"
