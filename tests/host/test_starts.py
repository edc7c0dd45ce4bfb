"""Starts are counted by the records here and on other hosts, without a clock, and on disk first."""

from __future__ import annotations

import asyncio

import pytest
from scripted_snapshots import states_of

from lfield.host.inputs import HostExited
from lfield.host.process.mission_completion import wait_until_done
from lfield.journal.records import RunMarker, StartCounter
from lfield.operator.journal_reset import plan_reset
from lfield.replication.transfer.coordinator_copies import MAX_STARTS
from lfield.simulate.jumping_loop import LoopClock

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal stay(real seconds) { write("arrived\\n"); sleep(seconds); }
}
coordinator Guest {
    init(string[] arg) { findPost(arg[1]).stay(20.0); }
}
"""
DEPLOYMENT = "//Guest:guest@home?post\n//Post:post@away\n"
TWO_GUESTS = DEPLOYMENT + "//Guest:other@home?post\n"


def start_of(running, agent: str = "guest") -> int:
    return max(known.generation for known in running.host.mobility.known_states() if known.agent == agent)


async def test_a_start_that_is_away_is_not_repeated(team, /):
    mission = team.mission(PROGRAM, DEPLOYMENT)
    home, away = await team.up(mission, keeps=True)
    await team.until(lambda: away.output)
    # Only the disk knows it; the other host is unreachable.
    team.network.partition("home", "away")
    await home.host.stop()
    (again,) = await team.up(mission, "home", keeps=True)
    assert "guest not started again: it moved to away" in again.log
    assert start_of(again) == start_of(away) == 1


async def test_records_of_other_hosts_count_after_the_disk_was_replaced(team, /):
    mission = team.mission(PROGRAM, DEPLOYMENT)
    home, away = await team.up(mission, keeps=True)
    await team.until(lambda: away.output)
    await home.host.stop()
    team.disks["home"].replace()
    (home,) = await team.up(mission, "home", keeps=True)
    assert "guest not started again: it is alive on another host" in home.log
    assert await team.ended("guest") == "done"
    await home.host.stop()
    (home,) = await team.up(mission, "home", keeps=True)
    assert start_of(home) == 2


async def test_without_records_a_host_waits_until_all_hosts_have_answered(team, /):
    mission = team.mission(PROGRAM, TWO_GUESTS)
    (home,) = await team.up(mission, "home", keeps=True, first_start=False)
    await asyncio.sleep(30.0)
    reason = (
        "guest and other not started: this host has no record of earlier starts, and away has to answer "
        "first; --first-start states that there was no earlier start"
    )
    assert home.log.count(reason) == 1
    assert not home.holds("guest")
    await team.up(mission, "away", keeps=True)
    await team.until(lambda: home.host.mobility.known_states())
    assert start_of(home) == start_of(home, "other") == 1


async def test_first_start_states_that_there_was_no_earlier_start(team, /):
    mission = team.mission(PROGRAM, DEPLOYMENT, without=("away",))
    (home,) = await team.up(mission, "home", keeps=True, first_start=True)
    assert start_of(home) == 1


async def test_without_a_journal_all_hosts_are_asked_first(team, /):
    """Simulated devices, and `up --all`."""
    mission = team.mission(PROGRAM, DEPLOYMENT)
    (home,) = await team.up(mission, "home", first_start=False)
    await asyncio.sleep(5.0)
    assert not home.holds("guest")
    await team.up(mission, "away")
    await team.until(lambda: home.host.mobility.known_states())
    assert start_of(home) == 1


async def test_a_start_that_needs_an_exited_host_is_not_made(team, /):
    mission = team.mission(PROGRAM, DEPLOYMENT)
    (home,) = await team.up(mission, "home", first_start=False)
    await asyncio.sleep(5.0)
    home.host.dispatch(HostExited("unknown"))
    assert home.host.core.startup.unstartable(home.host.core.membership.ended) == {}
    home.host.dispatch(HostExited("away"))
    await asyncio.sleep(5.0)
    assert not home.holds("guest")
    # A host that waits for the end of the mission does not wait without end.
    (outcome,) = await wait_until_done(home.host, 3.0)
    assert (outcome.agent, outcome.outcome) == ("guest", "lost")
    assert outcome.detail == "it was not started, since away has ended"


@pytest.mark.parametrize("keeps", [False, True])
async def test_a_start_that_waits_for_devices_elsewhere_is_known_to_its_home(team, /, keeps):
    """The home of the coordinator has lost its records; the coordinator has run on no other host yet."""
    mission = team.mission(PROGRAM, DEPLOYMENT)
    away, opened = team.make(mission, "away", keeps=keeps), asyncio.Event()
    _opens_later(away, opened)
    starting = asyncio.ensure_future(away.host.start())
    (home,) = await team.up(mission, "home", keeps=keeps)
    await asyncio.sleep(1.0)
    await home.host.stop()
    if keeps:
        team.disks["home"].replace()
    (home,) = await team.up(mission, "home", keeps=keeps, first_start=False)
    assert "guest not started again: it is alive on another host" in home.log
    opened.set()
    await starting
    assert await team.ended("guest") == "done"
    assert away.output == ["arrived"]
    assert start_of(home) == start_of(away) == 1


def _opens_later(running, opened: asyncio.Event) -> None:
    """A host that listens already, and opens its devices later."""
    opens = running.host.guards.open

    async def open_later(devices, recording) -> None:
        await opened.wait()
        await opens(devices, recording)

    running.host.guards.open = open_later


async def test_a_start_that_cannot_be_stored_is_not_made(team, /):
    mission = team.mission(PROGRAM, DEPLOYMENT + "//Post:here@home\n", without=("away",))
    home = team.make(mission, "home", keeps=True)
    team.disks["home"].broken = True
    starting = asyncio.ensure_future(home.host.start())
    await asyncio.sleep(5.0)
    assert "coordinators blocked: journal write failed: " in home.log
    assert home.log.count("coordinators blocked") == 1
    assert not home.holds("guest")
    # The resources are still served.
    assert home.holds("here")
    team.disks["home"].broken = False
    await starting
    assert home.holds("guest")


async def test_a_host_keeps_a_bounded_number_of_starts(team, /):
    """A mission may run again and again; a host keeps how the last starts ended."""
    mission = team.mission(PROGRAM.replace("20.0", "0.0"), DEPLOYMENT)
    await team.up(mission, "away", keeps=True)
    for number in range(1, 71):
        (home,) = await team.up(mission, "home", keeps=True)
        await team.until(lambda home=home, number=number: start_of(home) == number)
        await team.until(lambda home=home: not home.holds("guest"))
        await asyncio.sleep(1.0)
        await home.host.stop()
    records = team.disks["home"].open(LoopClock(), print).records()
    assert len(records) <= MAX_STARTS + 4


async def test_an_ended_coordinator_is_not_started_again_in_an_interrupted_run(team, /):
    mission = team.mission(PROGRAM.replace("20.0", "0.0"), DEPLOYMENT)
    home, _ = await team.up(mission, keeps=True)
    assert await team.ended("guest") == "done"
    await asyncio.sleep(1.0)
    crash(home)
    (again,) = await team.up(mission, "home", keeps=True)
    assert "guest not started again: it has ended (done) in the current run" in again.log
    await again.host.stop()
    (next_run,) = await team.up(mission, "home", keeps=True)
    assert start_of(next_run) == 2


async def test_a_counted_start_that_was_not_made_is_made_the_next_time(team, /):
    mission = team.mission(PROGRAM.replace("20.0", "0.0"), DEPLOYMENT)
    home, _ = await team.up(mission, keeps=True)
    assert await team.ended("guest") == "done"
    await asyncio.sleep(1.0)
    await home.host.stop()
    journal = team.disks["home"].open(LoopClock(), print)
    await journal.persist([RunMarker(open=True), StartCounter(2)])
    (again,) = await team.up(mission, "home", keeps=True)
    assert start_of(again) == 3


def crash(running) -> None:
    """As by SIGKILL: none of its later actions has an effect."""
    running.host.peers.close()
    running.host.options.journal.close()
    running.host.fail(RuntimeError("killed"))


async def test_after_a_reset_the_coordinator_starts_again_and_the_old_start_is_known_as_lost(team, /):
    mission = team.mission(PROGRAM, DEPLOYMENT)
    home, away = await team.up(mission, keeps=True)
    await team.until(lambda: away.output)
    await away.host.stop()
    # The holder discards its copy, then the home starts again.
    disk = team.disks["away"].open(LoopClock(), print)
    await disk.persist(plan_reset("away", disk.records(), {}).records)
    (again,) = await team.up(mission, "away", keeps=True)
    assert again.output == []
    assert await team.ended("guest") == "lost"
    await home.host.stop()
    disk = team.disks["home"].open(LoopClock(), print)
    found = plan_reset("home", disk.records(), states_of({"away": again.host.status()}))
    assert (found.departed, found.discarded) == ([], [])
    await disk.persist(found.records)
    (home,) = await team.up(mission, "home", keeps=True)
    await team.until(lambda: again.output == ["arrived"])
    assert start_of(home) == start_of(again) == 2
