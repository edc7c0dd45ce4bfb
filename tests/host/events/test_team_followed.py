"""The view of a team of real hosts by a client that follows their events, in virtual time."""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager

import pytest

from lfield.client.team_watch import TeamWatch
from lfield.operator.dashboard.event_feed import log_backlog
from lfield.operator.dashboard.event_stream.event_follower import EventFollower, FollowOptions
from lfield.operator.dashboard.timeline.event_timeline import EventTimeline
from lfield.operator.team_model.team_contents import team_contents
from lfield.simulate.jumping_loop import LoopClock
from lfield.wire.subscription_messages import EventBatch

PROGRAM = """
resource Post {
    int seen;
    init(string[] arg) { }
    portal visit(int n) { seen = seen + 1; print("visit " + i2s(n)); }
}
coordinator Walker {
    init(string[] arg) {
        Post[] posts = findPost();
        int n = 0;
        while (n < 6) {
            posts[n % 2].visit(n);
            sleep(1.0);
            n = n + 1;
        }
    }
}
"""
TEAM = "//Post:p@alpha\n//Post:q@beta\n//Walker:walker@alpha\n"


class WatchWithTimeline(TeamWatch):
    """The display of a team with its time line."""

    def __init__(self, roll, clock) -> None:
        super().__init__(roll, clock)
        self.timeline = EventTimeline()

    def on_batch(self, host: str, batch: EventBatch, took: float | None) -> None:
        super().on_batch(host, batch, took)
        for event in batch.events:
            self.timeline.add(host, batch.incarnation, event)


@asynccontextmanager
async def followed(fleet, mission, since=None):
    async def reach(host: str) -> str:
        return mission.team.addresses_by_host[host]

    watch = WatchWithTimeline(team_contents("team", mission.team, mission), LoopClock())
    transport = fleet.network.transport("desk")
    follower = EventFollower(
        transport, mission.team.hosts, reach, watch, LoopClock(), FollowOptions(since=since, telemetry=5.0)
    )
    task = asyncio.create_task(follower.run())
    try:
        yield watch
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_a_walk_is_shown_hop_by_hop_to_its_end(fleet, /) -> None:
    mission = fleet.mission(PROGRAM, TEAM)
    await fleet.up(mission)
    async with followed(fleet, mission, since=0) as watch:
        await fleet.until(lambda: watch.snapshot().agents["walker"].finished)
        # The end of the coordinator is reported before its last hop is confirmed.
        await fleet.until(lambda: watch.snapshot().coordinators["walker"].trail[-1].duration is not None)
        await fleet.until(lambda: len([x for x in watch.snapshot().log if "visit" in x.text]) == 6)
        observed = watch.snapshot()
        walker = observed.coordinators["walker"]
        assert (walker.finished, walker.host) == ("done", "beta")
        assert [(hop.source, hop.target) for hop in walker.trail] == [
            ("alpha", "beta"),
            ("beta", "alpha"),
        ] * 2 + [("alpha", "beta")]
        assert all(hop.duration is not None and hop.resource in "pq" for hop in walker.trail)
        assert walker.hops == 5
        assert all(host.linked for host in observed.hosts.values())
        entries = watch.timeline.drain_events()
        # Entries beside the numbered events have the number of the last one: the first has its own.
        numbered = reversed(list(enumerate(entries)))
        times = {(d.host, d.incarnation, d.event.number): n for n, d in numbered}
        causes = [(times[d.cause], n) for n, d in enumerate(entries) if d.cause in times]
        assert len(causes) > 20
        assert all(cause < effect for cause, effect in causes)


THERE_AND_BACK = """
resource Post {
    init(string[] arg) { }
    portal visit() { }
}
coordinator Walker {
    init(string[] arg) {
        Post[] posts = findPost();
        int n = 0;
        while (n < 20) {
            posts[n % 2].visit();
            n = n + 1;
        }
    }
}
"""


async def test_every_hop_has_its_duration_when_the_return_confirms_it(fleet, /) -> None:
    mission = fleet.mission(THERE_AND_BACK, TEAM)
    await fleet.up(mission)
    async with followed(fleet, mission, since=0) as watch:
        await fleet.until(lambda: watch.snapshot().agents["walker"].finished)
        await asyncio.sleep(3.0)
        entries = [dated.event for dated in watch.timeline.drain_events()]
        hops = {kind: [e.what.sequence for e in entries if e.kind == kind] for kind in ("left", "hopped")}
        assert len(hops["left"]) == 19
        assert hops["hopped"] == hops["left"]
        assert all(e.what.seconds is not None for e in entries if e.kind == "hopped")


async def test_a_late_client_gets_the_earlier_log_in_order_and_once(fleet, /) -> None:
    mission = fleet.mission(PROGRAM, TEAM)
    await fleet.up(mission)
    await asyncio.sleep(3.5)
    transport = fleet.network.transport("desk")

    async def reach(host: str) -> str:
        return mission.team.addresses_by_host[host]

    async with followed(fleet, mission) as watch:
        backlog = log_backlog(transport, mission.team.hosts, reach, LoopClock())
        await watch.start_log(backlog)
        assert len([line for line in watch.snapshot().log if "visit" in line.text]) == 4
        await fleet.until(lambda: watch.snapshot().agents["walker"].finished)
        log = watch.snapshot().log
        assert [x.text for x in log if "visit" in x.text] == [f"visit {n}" for n in range(6)]
        first = next(line for line in log if "visit" in line.text)
        assert first.age == pytest.approx(watch.snapshot().log[-1].age + 5.0, abs=0.5)
        # Earlier hops are not shown.
        assert len(watch.snapshot().coordinators["walker"].trail) == 2


async def test_an_ended_host_stays_displayed_and_its_restart_is_counted(fleet, /) -> None:
    mission = fleet.mission(PROGRAM, TEAM)
    _, beta = await fleet.up(mission)
    async with followed(fleet, mission) as watch:
        await fleet.until(lambda: watch.snapshot().hosts["beta"].linked)
        await asyncio.sleep(1.0)
        await beta.host.stop()
        await fleet.until(lambda: not watch.snapshot().hosts["beta"].linked)
        gone = watch.snapshot().hosts["beta"]
        assert gone.end_reason is not None
        await asyncio.sleep(30.0)
        assert watch.snapshot().hosts["beta"].age == pytest.approx(30.0, abs=2.0)
        await fleet.up(mission, "beta", first_start=False)
        await fleet.until(lambda: watch.snapshot().hosts["beta"].linked)
        again = watch.snapshot().hosts["beta"]
        assert (again.restarts, again.end_reason) == (1, None)
        assert "state" not in again.lost_events
