"""Waits until every coordinator of a deployment has ended anywhere, or is lost with a host that is gone."""

from __future__ import annotations

import asyncio
from contextlib import suppress

from lfield.host.host import Host
from lfield.host.status import coordinators_of
from lfield.mobility.fates import Fate, fates

#: How often the other hosts are asked while one is missing, and how long an ending is passed on before this
#: host goes (both in seconds).
ASK_EVERY, LINGER = 0.5, 2.0


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
        found = fates(homes, {host.name: coordinators_of(host.core)}, ())
        gone = host.peers.gone_for(lost_after, unmet)
        if wanted - found.keys() and (gone or host.core.restarted):
            now = fates(homes, await host.ask_others(), gone)
            found = {agent: fate for agent, fate in now.items() if fate.outcome != "lost" or agent in before}
            before = now
        if not wanted - found.keys():
            await _pass_on(host)
            return [found[agent] for agent in sorted(wanted)]
        await _news(host)


async def _pass_on(host: Host) -> None:
    """Stay until every host that can be reached has confirmed the endings."""
    end = host.clock.monotonic() + LINGER
    while host.mobility.unconfirmed(host.peers.incarnations) and host.clock.monotonic() < end:
        host.changed.clear()
        await _news(host)


async def _news(host: Host) -> None:
    """Wait until something has changed, for a while."""
    # Not asyncio.wait_for: before Python 3.12 it may swallow a cancellation that comes with the news.
    with suppress(TimeoutError):
        async with asyncio.timeout(ASK_EVERY):
            await host.changed.wait()
