"""A home with a new disk does not start a coordinator again that the team recovers from a shadow."""

from __future__ import annotations

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal count() { write("counted\\n"); }
    portal stay(real seconds) { write("arrived\\n"); sleep(seconds); }
}
coordinator Guest {
    init(string[] arg) {
        FIRST
        findPost("far").count();
        try { findPost("near").stay(1000.0); }
        catch (RestartException again) { print("told: " + again.message()); sleep(1000.0); }
    }
}
"""
DEPLOYMENT = "//Guest:guest@home\n//Post:near@home\n//Post:far@away\n//@tower\n"


async def with_a_new_disk(team, first):
    """guest has returned home from away; then home is restarted with another disk."""
    mission = team.mission(PROGRAM.replace("FIRST", first), DEPLOYMENT)
    hosts = {running.host.core.name: running for running in await team.up(mission, keeps=True)}
    home, away = hosts["home"], hosts["away"]
    await team.until(lambda: "arrived" in home.output)
    await home.host.stop()
    team.disks["home"].replace()
    (again,) = await team.up(mission, "home", keeps=True)
    return again, away


async def test_a_coordinator_under_leases_is_recovered_from_its_shadow(team, /):
    home, away = await with_a_new_disk(team, "heartbeatInterval(3.0);")
    expected = "guest not started again: it has left away, where a copy of it is kept"
    await team.until(lambda: expected in home.log)
    await team.until(lambda: "guest: told: guest was recovered on away" in away.log)
    assert not home.holds("guest")
    assert away.output == ["counted"]


async def test_a_coordinator_without_leases_is_started_again(team, /):
    home, away = await with_a_new_disk(team, "")
    await team.until(lambda: "arrived" in home.output)
    assert away.output == ["counted", "counted"]
