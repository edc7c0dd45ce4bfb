"""The events of a hop are in order for any clocks of its hosts; a clock that is far ahead is reported."""

from __future__ import annotations

from itertools import pairwise

import pytest

from lfield.hybrid_clock import MAX_AHEAD
from lfield.operator.dashboard.event_feed import log_backlog
from lfield.simulate.jumping_loop import LoopClock
from lfield.text import log_messages
from lfield.wire.events import LineLogged

PROGRAM = """
resource Post { init(string[] arg) { } portal visit(int n) { print("visit " + i2s(n)); } }
coordinator Walker {
    init(string[] arg) {
        Post[] posts = findPost();
        int n = 0;
        while (n < 20) {
            print("before " + i2s(n));
            posts[n % 2].visit(n);
            print("after " + i2s(n));
            n = n + 1;
        }
    }
}
"""
TEAM = "//Post:p@alpha\n//Post:q@beta\n//Walker:walker@alpha\n"


class WrongClock(LoopClock):
    """The loop's clock with a wall clock in 2023 that is wrong by `off` seconds."""

    def __init__(self, off: float) -> None:
        self.off = 1.7e9 + off

    def time(self) -> float:
        return self.monotonic() + self.off


async def walk(fleet, off: float):
    """A walk of a coordinator between alpha and beta, whose wall clock is wrong; returns the hosts."""
    mission = fleet.mission(PROGRAM, TEAM)
    hosts = [fleet.make(mission, name, clock=WrongClock(by)) for name, by in (("alpha", 0.0), ("beta", off))]
    for running in hosts:
        await running.host.start()
    assert await fleet.ended("walker") == "done"
    return mission, hosts


def clock_lines(running) -> list[str]:
    events = running.host.recorder.event_log.after(0, 10_000, 1 << 22)[0]
    lines = [event.what for event in events if isinstance(event.what, LineLogged)]
    return [line.text for line in lines if line.code == log_messages.CLOCK_AHEAD.code]


@pytest.mark.parametrize("off", [-0.9 * MAX_AHEAD, 0.9 * MAX_AHEAD, -300.0, 5.0])
async def test_logs_of_hosts_with_clocks_minutes_apart_are_merged_in_causal_order(
    fleet, /, off: float
) -> None:
    mission, hosts = await walk(fleet, off)

    async def locate(host: str) -> str:
        return mission.team.addresses_by_host[host]

    log = await log_backlog(fleet.network.transport("desk"), mission.team.hosts, locate, LoopClock())
    printed = [dated for dated in log if dated.event.kind == "printed"]
    lines = [dated.event.what.text for dated in printed]
    assert lines == [f"{part} {n}" for n in range(20) for part in ("before", "visit", "after")]
    stamps = [dated.event.stamp for dated in printed]
    assert all(one < other for one, other in pairwise(stamps))
    # The wall time of each host is still shown.
    behind = "alpha" if off > 0.0 else "beta"
    assert {dated.host for dated in printed if dated.within is not None} == {behind}
    assert [clock_lines(running) for running in hosts] == [[], []]


async def test_a_clock_far_ahead_is_reported_once_and_not_followed(fleet, /) -> None:
    _, (alpha, beta) = await walk(fleet, MAX_AHEAD + 90.0)
    expected = log_messages.CLOCK_AHEAD.line(host="beta", seconds=MAX_AHEAD + 90.0)
    assert [clock_lines(alpha), clock_lines(beta)] == [[expected], []]
    assert alpha.host.hybrid_clock.last / (1 << 16) < (1.7e9 + LoopClock().time()) * 1000.0 + 1000.0
