"""A mission that was over is run once more, by hosts that remember the first time."""

from __future__ import annotations

import asyncio

from lfield.host.process.until_done import until_done

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal visit() { write("visited\\n"); }
}
coordinator Guest {
    init(string[] arg) { findPost(arg[1]).visit(); }
}
"""
DEPLOYMENT = "//Post:post@away\n//Guest:guest@home?post\n"


async def life(running) -> str:
    """A host with --until-done, from its start to its end; how the guest ended."""
    await running.host.start()
    (fate,) = await until_done(running.host, lost_after=15.0)
    await running.host.stop()
    return fate.outcome


def test_a_host_that_remembers_an_earlier_run_waits_for_the_next(fleet):
    """Its journal says that the coordinator has ended; its home begins it anew a moment later."""

    async def story(team):
        mission = team.mission(PROGRAM, DEPLOYMENT)
        for _ in range(3):
            away, home = (team.make(mission, name, keeps=True) for name in mission.team.hosts)
            assert await asyncio.gather(life(home), life(away)) == ["done", "done"]
            assert away.output == ["visited"]

    fleet(story)


def test_a_host_that_remembers_an_end_does_not_wait_for_a_home_that_has_gone(fleet):
    async def story(team):
        mission = team.mission(PROGRAM, DEPLOYMENT)
        away, home = (team.make(mission, name, keeps=True) for name in mission.team.hosts)
        await asyncio.gather(life(home), life(away))
        assert await life(team.make(mission, "away", keeps=True)) == "done"

    fleet(story)


def test_a_start_that_fails_leaves_the_run_as_it_was(fleet):
    """The host was killed when all was over. One that tries again by itself begins no mission anew."""

    async def story(team):
        mission = team.mission(PROGRAM, DEPLOYMENT)
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
        assert "guest has ended (done) in the run that goes on here" in last.log
        assert away.output == ["visited"]

    fleet(story)


def _ended(running) -> bool:
    return any(row.state == "EXITED" for row in running.host.mobility.knowledge())
