"""A host that restarts while its coordinator is alive elsewhere does not start a second one."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from lfield.host.process.host_process import run_until_exit
from lfield.host.process.mission_completion import wait_until_done
from lfield.host.process.shutdown_signals import ShutdownSignals
from lfield.journal.records import RecordKey, RunMarker

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal stay(real seconds) {
        write("arrived\\n");
        sleep(seconds);
        write("done\\n");
    }
}
coordinator Guest {
    init(string[] arg) {
        findPost(arg[1]).stay(20.0);
        print("goes on after " + i2s(hops()) + " hop(s)");
    }
}
"""
# In the second, the other host dials the guest's home; in the first the home dials.
FIRST_HOME = "//Guest:guest@home?post\n//Post:post@away\n"
LAST_HOME = "//Post:post@away\n//Guest:guest@home?post\n"


@pytest.mark.parametrize("deployment", [FIRST_HOME, LAST_HOME])
async def test_a_coordinator_that_is_alive_elsewhere_is_not_started_again(team, /, deployment):
    mission = team.mission(PROGRAM, deployment)
    home, away = await team.up(mission, "home", "away")
    await team.until(lambda: away.output == ["arrived"])
    await home.host.stop()
    await asyncio.sleep(2.0)
    (again,) = await team.up(mission, "home")
    assert "guest not started again: it is alive on another host" in again.log
    assert not again.holds("guest")
    assert await team.ended("guest") == "done"
    assert away.output == ["arrived", "done"]
    assert "guest: goes on after 1 hop(s)" in away.log


async def test_a_coordinator_that_was_lost_with_its_host_is_started_again(team, /):
    mission = team.mission(PROGRAM, FIRST_HOME)
    home, away = await team.up(mission)
    await team.until(lambda: away.output == ["arrived"])
    await home.host.stop()
    await away.host.stop()
    _, again = await team.up(mission)
    assert await team.ended("guest") == "done"
    assert again.output == ["arrived", "done"]


async def test_a_coordinator_is_lost_with_a_host_that_restarts_at_once(team, /):
    mission = team.mission(PROGRAM, FIRST_HOME)
    home, away = await team.up(mission)
    await team.until(lambda: away.output == ["arrived"])
    await away.host.stop()
    await team.up(mission, "away")
    (outcome,) = await wait_until_done(home.host, lost_after=1000.0)
    assert outcome.outcome == "lost"
    assert outcome.detail.endswith("which was restarted")


TWICE = """
resource Post {
    int calls;
    init(string[] arg) { }
    portal stay(string who, real seconds) {
        calls = calls + 1;
        write(who + " begins\\n");
        sleep(seconds);
        write(who + " ends\\n");
    }
}
coordinator Guest {
    init(string[] arg) {
        Post home = findPost(arg[1]);
        Post carol = findPost(arg[3]);
        string who = f2s(now(), 3);
        if (now() < 1010.0) {
            carol.stay(who, 20.0);
            findPost(arg[2]).stay(who, 1.0);
        }
        while (true) home.stay(who, 1.0);
    }
}
"""
THREE_HOSTS = "//Post:h@home\n//Post:a@away\n//Post:c@carol\n//Guest:guest@home?h&a&c\n"


async def test_an_arriving_start_ends_before_it_runs_beside_a_later_one(team, /):
    """Two starts of one coordinator never both run on a host."""
    mission = team.mission(TWICE, THREE_HOSTS, without=("carol",))
    home, _, carol = await team.up(mission, keeps=True)
    await team.until(lambda: carol.output)
    first = carol.output[0].split()[0]
    # No reachable host knows it, and its record on disk is damaged: a second one is started.
    team.network.partition("home", "carol")
    await home.host.stop()
    await asyncio.sleep(10.0)
    team.disks["home"].damage(RecordKey("copy", "guest", 1))
    again = team.make(mission, "home", keeps=True)
    await again.host.start()
    await team.until(lambda: again.output)
    second = again.output[0].split()[0]
    assert second != first
    await team.until(lambda: any(line.startswith(first) for line in again.output))
    arrived = next(n for n, line in enumerate(again.output) if line.startswith(first))
    await asyncio.sleep(5.0)
    # A portal that the second one had begun may end; it begins no other.
    assert f"{second} begins" not in again.output[arrived:]
    assert again.host.failure is None
    assert [a.generation for a in again.host.machine.agents.values() if a.id == "guest"]


VISIT = """
resource Post {
    init(string[] arg) { }
    portal visit() { write("visited\\n"); }
}
coordinator Guest {
    init(string[] arg) { findPost(arg[1]).visit(); }
}
"""
ONE_VISIT = "//Post:post@away\n//Guest:guest@home?post\n"


async def life(running, lost_after: float = 15.0) -> str:
    """Run a host with --until-done from its start to its end; return how the guests ended."""
    await running.host.start()
    outcomes = await wait_until_done(running.host, lost_after)
    await running.host.stop()
    return ", ".join(outcome.outcome for outcome in outcomes)


async def test_a_host_with_records_of_an_earlier_run_waits_for_the_next(team, /):
    """Journals, its own or those of others, have the end of the coordinator; its home starts it again."""
    mission = team.mission(VISIT, ONE_VISIT)
    for run in range(3):
        away, home = (team.make(mission, name, keeps=True) for name in mission.team.hosts)
        assert await asyncio.gather(life(home), life(away)) == ["done", "done"]
        assert away.output == ["visited"]
        if run == 1:
            team.disks["away"].replace()


NEVER_AWAY = """
resource Post { init(string[] arg) { } }
coordinator Guest { init(string[] arg) { sleep(12.0); } }
"""
TWO_HOMES = "//Guest:first@home\n//Guest:second@away\n//Post:post@carol\n"


@pytest.mark.parametrize("lost_after", [3.0, 300.0])
async def test_hosts_end_with_coordinators_that_they_have_never_held(team, /, lost_after):
    """All hosts end with the last coordinator; in a second run not before."""
    mission = team.mission(NEVER_AWAY, TWO_HOMES)
    for _ in range(2):
        hosts = [team.make(mission, name, keeps=True) for name in mission.team.hosts]
        begin = hosts[0].host.clock.monotonic()
        assert await asyncio.gather(*(life(one, lost_after) for one in hosts)) == ["done, done"] * 3
        assert 12.0 <= hosts[0].host.clock.monotonic() - begin < 16.0


async def test_hosts_restarted_after_the_last_end_all_end(team, /):
    """Each home has the end of the other's coordinator only in its journal."""
    mission = team.mission(NEVER_AWAY, TWO_HOMES)
    before = await team.up(mission, keeps=True)
    await team.until(lambda: all(len(_ends(one)) == 2 for one in before))
    # Like killed hosts, they cannot store that the run is over.
    for disk in team.disks.values():
        disk.full, disk.reserve = True, 0
    for one in before:
        await one.host.stop()
    for disk in team.disks.values():
        disk.full = False
    after = [team.make(mission, name, keeps=True) for name in mission.team.hosts]
    assert await asyncio.gather(*(life(one, 300.0) for one in after)) == ["done, done"] * 3
    log = after[0].log + after[1].log
    assert "first not started again: it has ended (done) in the current run" in log


async def test_a_host_with_a_stored_end_does_not_wait_for_a_stopped_home(team, /):
    mission = team.mission(VISIT, ONE_VISIT)
    away, home = (team.make(mission, name, keeps=True) for name in mission.team.hosts)
    await asyncio.gather(life(home), life(away))
    assert await life(team.make(mission, "away", keeps=True)) == "done"


async def test_a_start_that_fails_leaves_the_run_unchanged(team, /):
    """The host was killed at the end of the run. A start that a service repeats begins no new run."""
    mission = team.mission(VISIT, ONE_VISIT)
    away, home = await team.up(mission, keeps=True)
    await team.until(lambda: _ended(home))
    disk = team.disks["home"]
    disk.full, disk.reserve = True, 0
    await home.host.stop()
    disk.full = False
    # It opens no device, and ends.
    await team.make(mission, "home", keeps=True).host.stop()
    last = team.make(mission, "home", keeps=True)
    await last.host.start()
    assert "guest not started again: it has ended (done) in the current run" in last.log
    assert away.output == ["visited"]


async def test_a_host_killed_while_its_vehicles_land_does_not_repeat_the_mission(team, /):
    """All coordinators have ended, and a service or unit restarts the host."""
    mission = team.mission(VISIT, ONE_VISIT)
    away, home = await team.up(mission, keeps=True)
    await team.until(lambda: _ended(home))
    home.host.guards.close = asyncio.get_running_loop().create_future
    stopping = asyncio.create_task(home.host.stop())
    await asyncio.sleep(5.0)
    stopping.cancel()
    del home.host.guards.close
    home.host.peers.close()
    (again,) = await team.up(mission, "home", keeps=True)
    assert "guest not started again: it has ended (done) in the current run" in again.log
    assert away.output == ["visited"]


async def test_the_result_is_written_before_the_journal_ends_the_run(team, /):
    """A service begins a new run after a host that was killed without a result."""
    mission = team.mission(VISIT, "//Post:post@home\n//Guest:guest@home?post\n")
    running = team.make(mission, "home", keeps=True)
    found = []

    def is_open() -> list[bool]:
        return [page.open for page in team.disks["home"].records() if isinstance(page, RunMarker)]

    def ended(status: int) -> None:
        found.append((status, is_open()))

    signals = ShutdownSignals(running.host.clock)
    assert await run_until_exit(running.host, signals, 3.0, ended=ended) == 0
    assert (found, is_open()) == ([(0, [True])], [False])


async def test_the_loader_of_the_language_document_continues_after_a_restart(team, /):
    """The host of the winch is stopped while the loader calls the winch."""
    text = (Path(__file__).parents[2] / "lfield/docs/language.md").read_text(encoding="utf-8")
    (program,) = (block for block in text.split("```") if block.startswith("java\nresource Winch"))
    program = program.removeprefix("java\n").replace("return out;", "sleep(9.0); return out;")

    mission = team.mission(program, "//Winch:winch@away\n//Loader:loader@home?winch\n")
    away, home = await team.up(mission, keeps=True)
    await team.until(lambda: away.holds("loader"))
    await asyncio.sleep(1.0)
    await away.host.stop()
    (again,) = await team.up(mission, "away", keeps=True)
    assert "loader: away restarted; this call may have begun (winch.lower)" in again.log
    assert await team.ended("loader") == "done"
    assert "loader: lowered to 1.5" in again.log
    assert not home.holds("loader")


async def test_the_exception_of_a_restart_names_the_call(team, /):
    program = """
resource Post {
    int n;
    init(string[] arg) { }
    portal mark() { n = 1; sleep(9.0); }
    portal done() { write("marked\\n"); }
}
coordinator Guest {
    init(string[] arg) {
        Post post = findPost("post");
        try { post.mark(); }
        catch (RestartException e) { print(e.message() + " from " + e.source()); }
        findPost("post").done();
    }
}
"""

    mission = team.mission(program, "//Post:post@away\n//Guest:guest@away\n")
    (away,) = await team.up(mission, "away", keeps=True)
    await asyncio.sleep(1.0)
    await away.host.stop()
    (again,) = await team.up(mission, "away", keeps=True)
    assert "away restarted; this call may have begun (post.mark) from post" in again.log
    assert await team.ended("guest") == "done"


def _ended(running) -> bool:
    return bool(_ends(running))


def _ends(running) -> list[str]:
    return [row.agent for row in running.host.mobility.known_states() if row.state == "EXITED"]
