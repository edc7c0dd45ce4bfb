"""Waits until every coordinator of a deployment has ended anywhere, or is lost with a host that is gone.

While nobody is missing, endings are told to every host. When a host has been away too long or was restarted,
all that can be reached are asked what they know: a census.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress

from lfield.host.host import Host
from lfield.mobility.fates import Fate, fates
from lfield.wire.messages import Known, StatusRequest

#: How often the other hosts are asked while one is missing, how long they have to answer, and how long an
#: ending is passed on before this host goes (all in seconds).
ASK_EVERY, ANSWER_WITHIN, LINGER = 0.5, 1.0, 2.0


async def until_done(host: Host, lost_after: float) -> list[Fate]:
    """The fates of all coordinators. A host that cannot be reached for `lost_after` seconds is given up.

    One that has not come up yet is not given up before portal calls to it are.
    """
    unmet = max(lost_after, host.options.unreachable_after)
    homes = {member.id: host.team.hosts[member.host] for member in host.team.coordinators}
    wanted = homes.keys()
    before: dict[str, Fate] = {}
    while True:
        host.changed.clear()
        found = fates(homes, {host.name: host.mobility.knowledge()}, ())
        gone = host.peers.gone_for(lost_after, unmet)
        if wanted - found.keys() and (gone or host.core.restarted):
            now = fates(homes, await _census(host), gone)
            found = {agent: fate for agent, fate in now.items() if fate.outcome != "lost" or agent in before}
            before = now
        if not wanted - found.keys():
            await _pass_on(host)
            return [found[agent] for agent in sorted(wanted)]
        await _news(host, ASK_EVERY)


async def _pass_on(host: Host) -> None:
    """Stay until every host that can be reached has confirmed the endings."""
    end = host.clock.monotonic() + LINGER
    while host.mobility.unconfirmed(host.peers.incarnations) and host.clock.monotonic() < end:
        host.changed.clear()
        await _news(host, ASK_EVERY)


async def _census(host: Host) -> dict[str, list[Known]]:
    """The coordinators that this host and every host it can reach know of, by host, asked now."""
    host.statuses.clear()
    asked = set(host.peers.incarnations)
    for other in asked:
        host.peers.send(other, StatusRequest())
    end = host.clock.monotonic() + ANSWER_WITHIN
    while asked - host.statuses.keys() and host.clock.monotonic() < end:
        host.changed.clear()
        await _news(host, ANSWER_WITHIN)
    answers = {other: status.coordinators for other, status in host.statuses.items()}
    return answers | {host.name: host.mobility.knowledge()}


async def _news(host: Host, bound: float) -> None:
    """Wait until something has changed, for so long at most."""
    # Not asyncio.wait_for: before Python 3.12 it may swallow a cancellation that comes with the news.
    with suppress(TimeoutError):
        async with asyncio.timeout(bound):
            await host.changed.wait()
