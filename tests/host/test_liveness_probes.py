"""Hosts that lose some or all links: a loss is reported only with proof."""

from __future__ import annotations

import asyncio
import os
import re
from itertools import combinations

import pytest

from lfield.host.inputs import HostExited
from lfield.host.process import parent_pipe
from lfield.host.process.mission_completion import wait_until_done
from lfield.host.process.parent_pipe import ParentPipe

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal stay(real seconds) { write("arrived\\n"); sleep(seconds); }
}
coordinator Guest {
    init(string[] arg) { for (int i = 1; i < arg.length(); i = i + 1) findPost(arg[i]).stay(10.0); }
}
"""
HOSTS = ("alpha", "bravo", "carol")
DEPLOYMENT = "//Post:a@alpha\n//Post:b@bravo\n//Post:c@carol\n//Guest:guest@bravo?{way}\n"


async def fates_of(running, lost_after: float):
    """The outcome that each host reports; it stops then, as in a process."""
    (outcome,) = await wait_until_done(running.host, lost_after)
    await running.host.stop()
    return outcome


async def all_fates(hosts, lost_after: float = 5.0):
    async with asyncio.timeout(200.0):
        return await asyncio.gather(*(fates_of(running, lost_after) for running in hosts))


@pytest.mark.few(5)
@pytest.mark.parametrize("way", ["c", "a&c", "c&a", "b", "a&c&b"])
@pytest.mark.parametrize("edge", list(combinations(HOSTS, 2)), ids="-".join)
async def test_one_cut_link_with_a_live_coordinator_is_no_loss(team, /, edge, way):
    hosts = await team.up(team.mission(PROGRAM, DEPLOYMENT.format(way=way)), unreachable_after=60.0)
    await team.until(lambda: any(running.output for running in hosts))
    team.network.partition(*edge)
    if "&" in way:
        # Hosts cannot be called over the cut link, which returns in time.
        asyncio.get_running_loop().call_later(15.0, team.network.heal, *edge)
    outcomes = await all_fates(hosts)
    assert [outcome.outcome for outcome in outcomes] == ["done"] * 3, [running.log for running in hosts]


@pytest.mark.parametrize("way", ["c", "b"], ids=["behind the cut", "at the neighbour"])
async def test_an_unreachable_host_is_named_with_the_seconds(team, /, way):
    hosts = await team.up(team.mission(PROGRAM, DEPLOYMENT.format(way=way)))
    await team.until(lambda: any(running.output for running in hosts))
    for other in ("bravo", "carol"):
        team.network.partition("alpha", other)
    alpha, *others = await all_fates(hosts)
    assert alpha.outcome == "unheard"
    assert re.search("bravo has been unreachable for [56] s$", alpha.detail)
    assert [outcome.outcome for outcome in others] == ["done", "done"]


async def test_the_exit_of_a_host_process_is_proof_at_once(team, /):
    alpha, bravo, carol = await team.up(team.mission(PROGRAM, DEPLOYMENT.format(way="c")))
    await team.until(lambda: carol.output)
    await carol.host.stop()
    started = asyncio.get_running_loop().time()
    for running in (alpha, bravo):
        running.host.dispatch(HostExited("carol"))
    outcomes = await all_fates([alpha, bravo], lost_after=1000.0)
    assert {(outcome.outcome, outcome.detail) for outcome in outcomes} == {
        ("lost", "its last host carol has ended")
    }
    assert asyncio.get_running_loop().time() - started < 5.0


@pytest.mark.parametrize("moment", [0.0, 0.2, 0.4, 0.6, 0.8, 1.1])
async def test_proof_of_a_loss_reaches_all_hosts_before_its_finder_stops(team, /, moment):
    """Carol restarts without the guest. Alpha checks a moment later than bravo."""
    mission = team.mission(PROGRAM, DEPLOYMENT.format(way="c"))
    hosts = await team.up(mission)
    await team.until(lambda: hosts[2].output)
    await hosts[2].host.stop()
    (carol,) = await team.up(mission, "carol")
    tasks = [asyncio.create_task(fates_of(hosts[1], 5.0)), asyncio.create_task(fates_of(carol, 5.0))]
    await asyncio.sleep(moment)
    started = asyncio.get_running_loop().time()
    outcomes = [await fates_of(hosts[0], 5.0), *[await task for task in tasks]]
    assert [outcome.outcome for outcome in outcomes] == ["lost"] * 3, [running.log for running in hosts]
    assert asyncio.get_running_loop().time() - started < 5.0


async def test_a_host_that_is_silent_for_a_moment_is_waited_for(team, /):
    hosts = await team.up(team.mission(PROGRAM, DEPLOYMENT.format(way="c")))
    await team.until(lambda: hosts[2].output)
    for other in ("alpha", "bravo"):
        team.network.partition(other, "carol")
    asyncio.get_running_loop().call_later(4.0, team.network.heal, "bravo", "carol")
    assert [outcome.outcome for outcome in await all_fates(hosts, lost_after=10.0)] == ["done"] * 3


# The pipe from the parent process


class PipeLog:
    def __init__(self) -> None:
        self.lines: list[str] = []
        self.closed = asyncio.Event()


def on_parent_pipe(scenario) -> PipeLog:
    async def main() -> PipeLog:
        log = PipeLog()
        near, far = os.pipe()
        try:
            ParentPipe(near, log.lines.append, log.closed.set)
            await scenario(far)
            async with asyncio.timeout(30.0):
                await log.closed.wait()
        finally:
            os.close(near)
        return log

    return asyncio.run(main())


def test_exit_lines_are_reported_and_the_end_of_the_pipe_stops():
    async def scenario(far: int) -> None:
        data = parent_pipe.exit_line("bravo") + b"something else\n" + parent_pipe.exit_line("cärol")
        for at in range(len(data)):
            os.write(far, data[at : at + 1])
            await asyncio.sleep(0)
        os.close(far)

    assert on_parent_pipe(scenario).lines == ["bravo", "cärol"]


def test_garbage_on_the_parent_pipe_is_ignored():
    async def scenario(far: int) -> None:
        for data in (b"\xff\x00" * 1000 + b"\n", b"reaped " + b"x" * 20000, b"\nreaped bravo"):
            os.write(far, data)
            await asyncio.sleep(0.01)
        os.close(far)

    assert len(on_parent_pipe(scenario).lines) <= 1
