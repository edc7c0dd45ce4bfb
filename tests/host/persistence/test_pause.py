"""A paused mission: no agent runs, no time limit expires, and everything continues after the resume."""

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


async def send_pause(team, host, *, lift=False):
    return await send_request(team.network.transport("desk"), f"{host}:8181", pause(lift=lift))


def waits(running, agent):
    known = running.host.mobility.known_states()
    return (agent, "FROZEN") in [(one.agent, one.state) for one in known]


async def call_started(team):
    home, away = await team.up(team.mission(PROGRAM, DEPLOYMENT), keeps=True, unreachable_after=3.0)
    await team.until(lambda: "begins 1" in away.log)
    return home, away


async def test_no_agent_runs_until_resume_and_the_pending_call_is_interrupted(team, /):
    home, away = await call_started(team)
    for host in ("home", "away"):
        assert (await send_pause(team, host)).devices == {}
    assert status_data(states_of({"away": away.host.status()}))["away"]["paused"]
    before = away.log
    await asyncio.sleep(300.0)
    assert away.log == before
    assert "late" not in home.log
    await send_pause(team, "away")  # A repeated pause changes nothing.
    for host in ("home", "away"):
        await send_pause(team, host, lift=True)
    await team.until(lambda: TOLD in away.log)
    # The resource has kept its field.
    await team.until(lambda: "begins 2" in away.log and "begins 3" in away.log)
    await team.until(lambda: "late: late came" in away.log)
    assert not away.host.status().paused
    await send_pause(team, "away", lift=True)
    assert away.log.count("mission resumed") == 1


async def test_a_transfer_to_a_paused_host_waits(team, /):
    home, away = await call_started(team)
    await send_pause(team, "away")
    await team.until(lambda: waits(home, "late"))
    await asyncio.sleep(60.0)
    assert "late gave up" not in home.log
    await send_pause(team, "away", lift=True)
    await team.until(lambda: "late: late came" in away.log)


async def test_a_transfer_to_a_paused_host_that_ends_gives_up(team, /):
    home, away = await call_started(team)
    await send_pause(team, "away")
    await team.until(lambda: waits(home, "late"))
    await away.host.stop()
    await team.until(lambda: "late gave up" in home.log)


async def test_a_restarted_host_is_still_paused(team, /):
    _, away = await call_started(team)
    await send_pause(team, "away")
    await away.host.stop()
    (again,) = await team.up(away.host.mission, "away", keeps=True)
    assert again.host.status().paused
    assert "mission still paused: no agent runs here until 'lfield resume'" in again.log
    await asyncio.sleep(20.0)
    assert "told" not in again.log
    await send_pause(team, "away", lift=True)
    await team.until(lambda: "guest: told: away restarted; this call" in again.log)
    await again.host.stop()
    (last,) = await team.up(away.host.mission, "away", keeps=True)
    assert not last.host.status().paused
    assert "still paused" not in str(last.log)
