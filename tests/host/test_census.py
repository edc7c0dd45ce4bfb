"""Hosts that lose one link, several, or one another: whoever can know how it ends says so, nobody guesses."""

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
    """The fates that each host tells; as in a process, it stops then."""
    (fate,) = await wait_until_done(running.host, lost_after)
    await running.host.stop()
    return fate


async def all_fates(hosts, lost_after: float = 5.0):
    async with asyncio.timeout(200.0):
        return await asyncio.gather(*(fates_of(running, lost_after) for running in hosts))


@pytest.mark.few(5)
@pytest.mark.parametrize("way", ["c", "a&c", "c&a", "b", "a&c&b"])
@pytest.mark.parametrize("edge", list(combinations(HOSTS, 2)), ids="-".join)
async def test_one_edge_cut_with_the_coordinator_alive_is_no_loss(team, /, edge, way):
    hosts = await team.up(team.mission(PROGRAM, DEPLOYMENT.format(way=way)), unreachable_after=60.0)
    await team.until(lambda: any(running.output for running in hosts))
    team.network.partition(*edge)
    if "&" in way:
        # No host can be called over the edge that is cut; the link returns in time.
        asyncio.get_running_loop().call_later(15.0, team.network.heal, *edge)
    fates = await all_fates(hosts)
    assert [fate.outcome for fate in fates] == ["done"] * 3, [running.log for running in hosts]


@pytest.mark.parametrize("way", ["c", "b"], ids=["on the far side", "on the neighbour"])
async def test_a_host_that_nobody_hears_any_more_is_named_with_the_seconds(team, /, way):
    hosts = await team.up(team.mission(PROGRAM, DEPLOYMENT.format(way=way)))
    await team.until(lambda: any(running.output for running in hosts))
    for other in ("bravo", "carol"):
        team.network.partition("alpha", other)
    alpha, *others = await all_fates(hosts)
    assert alpha.outcome == "unheard"
    assert re.search("bravo has been unreachable for [56] s$", alpha.detail)
    assert [fate.outcome for fate in others] == ["done", "done"]


async def test_a_host_that_was_reaped_is_proof_at_once(team, /):
    alpha, bravo, carol = await team.up(team.mission(PROGRAM, DEPLOYMENT.format(way="c")))
    await team.until(lambda: carol.output)
    await carol.host.stop()
    began = asyncio.get_running_loop().time()
    for running in (alpha, bravo):
        running.host.dispatch(HostExited("carol"))
    fates = await all_fates([alpha, bravo], lost_after=1000.0)
    assert {(fate.outcome, fate.detail) for fate in fates} == {("lost", "its last host carol has ended")}
    assert asyncio.get_running_loop().time() - began < 5.0


@pytest.mark.parametrize("moment", [0.0, 0.2, 0.4, 0.6, 0.8, 1.1])
async def test_proof_of_a_loss_is_told_to_all_before_its_finder_goes(team, /, moment):
    """Carol comes back without the guest. Alpha looks a moment later than bravo does."""
    mission = team.mission(PROGRAM, DEPLOYMENT.format(way="c"))
    hosts = await team.up(mission)
    await team.until(lambda: hosts[2].output)
    await hosts[2].host.stop()
    (carol,) = await team.up(mission, "carol")
    tasks = [asyncio.create_task(fates_of(hosts[1], 5.0)), asyncio.create_task(fates_of(carol, 5.0))]
    await asyncio.sleep(moment)
    began = asyncio.get_running_loop().time()
    fates = [await fates_of(hosts[0], 5.0), *[await task for task in tasks]]
    assert [fate.outcome for fate in fates] == ["lost"] * 3, [running.log for running in hosts]
    assert asyncio.get_running_loop().time() - began < 5.0


async def test_a_host_that_is_silent_for_a_moment_is_waited_for(team, /):
    hosts = await team.up(team.mission(PROGRAM, DEPLOYMENT.format(way="c")))
    await team.until(lambda: hosts[2].output)
    for other in ("alpha", "bravo"):
        team.network.partition(other, "carol")
    asyncio.get_running_loop().call_later(4.0, team.network.heal, "bravo", "carol")
    assert [fate.outcome for fate in await all_fates(hosts, lost_after=10.0)] == ["done"] * 3


# The pipe from the parent process


class Heard:
    def __init__(self) -> None:
        self.lines: list[str] = []
        self.let_go = asyncio.Event()


def on_parent_pipe(story) -> Heard:
    async def main() -> Heard:
        heard = Heard()
        near, far = os.pipe()
        try:
            ParentPipe(near, heard.lines.append, heard.let_go.set)
            await story(far)
            async with asyncio.timeout(30.0):
                await heard.let_go.wait()
        finally:
            os.close(near)
        return heard

    return asyncio.run(main())


def test_lines_are_news_and_the_end_means_stop():
    async def story(far: int) -> None:
        data = parent_pipe.exit_line("bravo") + b"something else\n" + parent_pipe.exit_line("cärol")
        for at in range(len(data)):
            os.write(far, data[at : at + 1])
            await asyncio.sleep(0)
        os.close(far)

    assert on_parent_pipe(story).lines == ["bravo", "cärol"]


def test_garbage_on_the_parent_pipe_is_ignored():
    async def story(far: int) -> None:
        for data in (b"\xff\x00" * 1000 + b"\n", b"reaped " + b"x" * 20000, b"\nreaped bravo"):
            os.write(far, data)
            await asyncio.sleep(0.01)
        os.close(far)

    assert len(on_parent_pipe(story).lines) <= 1
