"""A mission that is paused: no agent runs, nobody's patience ends, and all goes on when it is resumed."""

from __future__ import annotations

import asyncio

from scripted_snapshots import states_of

from lfield.client.status_json import status_data
from lfield.operator.client import pause
from lfield.operator.observer_link import send_request

PROGRAM = """
resource Post {
    int calls;
    init(string[] arg) { }
    portal stay(real seconds) {
        calls = calls + 1;
        print("begins " + i2s(calls));
        sleep(seconds);
    }
}
coordinator Guest {
    init(string[] arg) {
        Post post = findPost(arg[1]);
        try { post.stay(100.0); }
        catch (RestartException paused) { print("told: " + paused.message()); }
        post.stay(0.1);
        sleep(1000.0);
    }
}
coordinator Late {
    init(string[] arg) {
        sleep(2.0);
        try { findPost(arg[1]).stay(0.1); print("late came"); }
        catch (UnreachableResourceException e) { print("late gave up: " + e.message()); }
    }
}
"""
DEPLOYMENT = "//Guest:guest@home?post\n//Post:post@away\n//Late:late@home?post\n"
TOLD = "guest: told: the mission was paused; this call may have begun"


async def said(team, host, *, lift=False):
    return await send_request(team.network.transport("desk"), f"{host}:8181", pause(lift=lift))


def waits(running, agent):
    known = running.host.mobility.known_states()
    return (agent, "FROZEN") in [(one.agent, one.state) for one in known]


async def begun(team):
    home, away = await team.up(team.mission(PROGRAM, DEPLOYMENT), keeps=True, unreachable_after=3.0)
    await team.until(lambda: "begins 1" in away.log)
    return home, away


async def test_no_agent_runs_until_it_is_resumed_and_the_call_under_way_is_told_of(team, /):
    home, away = await begun(team)
    for host in ("home", "away"):
        assert (await said(team, host)).devices == {}
    assert status_data(states_of({"away": away.host.status()}))["away"]["paused"]
    before = away.log
    await asyncio.sleep(300.0)
    assert away.log == before
    assert "late" not in home.log
    await said(team, "away")  # Again is nothing new.
    for host in ("home", "away"):
        await said(team, host, lift=True)
    await team.until(lambda: TOLD in away.log)
    # The resource has kept its field.
    await team.until(lambda: "begins 2" in away.log and "begins 3" in away.log)
    await team.until(lambda: "late: late came" in away.log)
    assert not away.host.status().paused
    await said(team, "away", lift=True)
    assert away.log.count("mission resumed") == 1


async def test_who_is_on_its_way_to_a_paused_host_waits_and_does_not_give_up(team, /):
    home, away = await begun(team)
    await said(team, "away")
    await team.until(
        lambda: ("late", "FROZEN") in [(k.agent, k.state) for k in home.host.mobility.known_states()]
    )
    await asyncio.sleep(60.0)
    assert "late gave up" not in home.log
    await said(team, "away", lift=True)
    await team.until(lambda: "late: late came" in away.log)


async def test_who_is_on_its_way_to_a_paused_host_that_is_gone_gives_up(team, /):
    home, away = await begun(team)
    await said(team, "away")
    await team.until(
        lambda: ("late", "FROZEN") in [(k.agent, k.state) for k in home.host.mobility.known_states()]
    )
    await away.host.stop()
    await team.until(lambda: "late gave up" in home.log)


async def test_a_host_that_is_started_again_is_still_paused(team, /):
    _, away = await begun(team)
    await said(team, "away")
    await away.host.stop()
    (again,) = await team.up(away.host.mission, "away", keeps=True)
    assert again.host.status().paused
    assert "mission still paused: no agent runs here until 'lfield resume'" in again.log
    await asyncio.sleep(20.0)
    assert "told" not in again.log
    await said(team, "away", lift=True)
    await team.until(lambda: "guest: told: away restarted; this call" in again.log)
    await again.host.stop()
    (last,) = await team.up(away.host.mission, "away", keeps=True)
    assert not last.host.status().paused
    assert "still paused" not in str(last.log)
