"""A host whose disk is full accepts no coordinators; senders are informed and wait."""

from __future__ import annotations

import asyncio

PROGRAM = """
resource Post {
    int calls;
    init(string[] arg) { }
    portal visit() { calls = calls + 1; write("visited\\n"); }
}
coordinator Guest {
    init(string[] arg) {
        for (int i = 0; i < 40; i = i + 1) {
            try {
                findPost("near").visit();
                findPost("far").visit();
            } catch (UnreachableResourceException e) { print(e.message()); }
            sleep(0.5);
        }
    }
}
"""
DEPLOYMENT = "//Post:near@home\n//Post:far@away\n//Guest:guest@home\n"


async def test_senders_wait_until_the_disk_has_space(team, /):
    home, away = await team.up(team.mission(PROGRAM, DEPLOYMENT), keeps=True)
    await team.until(lambda: len(away.output) > 2)
    team.disks["away"].full = True
    await team.until(lambda: "rejecting migrations: its disk is full" in away.log)
    line_count = len(away.output)
    (waiting,) = home.host.mobility.known_states()
    await team.until(lambda: home.host.mobility.known_states()[0].state == "FROZEN")
    await asyncio.sleep(5.0)
    assert len(away.output) == line_count
    team.disks["away"].full = False
    await team.until(lambda: len(away.output) > line_count)
    assert "accepting migrations again" in away.log
    assert waiting.generation == 1


async def test_a_transfer_that_waits_too_long_fails_with_the_reason(team, /):
    home, away = await team.up(team.mission(PROGRAM, DEPLOYMENT), keeps=True, unreachable_after=3.0)
    await team.until(lambda: away.output)
    team.disks["away"].full = True
    await team.until(lambda: "guest: away could not store guest within 3 s: its disk is full" in home.log)


async def test_no_acting_call_begins_while_the_journal_fails(team, /):
    program = PROGRAM.replace("UnreachableResourceException", "LimitException")
    home, _ = await team.up(
        team.mission(program, DEPLOYMENT.replace("away", "home") + "//Post:third@away\n"), keeps=True
    )
    await team.until(lambda: len(home.output) > 4)
    team.disks["home"].broken = True
    await team.until(lambda: "guest: home cannot write its journal: " in home.log)
    calls = len(home.output)
    await asyncio.sleep(3.0)
    assert len(home.output) == calls
    team.disks["home"].broken = False
    await team.until(lambda: len(home.output) > calls)
    assert "journal writable again" in home.log
