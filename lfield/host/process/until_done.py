"""Waits until every coordinator of a deployment has ended anywhere, is lost for certain, or is not heard of.

While nobody is missing, endings are told to every host. While a host is missed, was restarted or has ended,
all that can be reached are asked what they know: a census, of so many hosts at a time. It goes on as long as
somebody hears whoever is missing here. Who has proof of a loss tells the others before it goes: for the
moment they are as certain.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

from lfield.host.host import Host
from lfield.journal.pages import CopyPage
from lfield.mobility.fates import Absent, Fate, Judge, known_fates
from lfield.text.suggest import listed
from lfield.wire.coordinators import Known
from lfield.wire.observing import StatusRequest

#: How often the other hosts are asked while one is missing, how long they have to answer, and how long an
#: ending is passed on before this host goes (all in seconds).
ASK_EVERY, ANSWER_WITHIN, LINGER = 0.5, 1.0, 2.0
#: So many are asked at a time.
ASKED_AT_ONCE = 8
#: So long a loss that was told is believed without asking, in seconds: its coordinator may be started again.
FRESH = 1.5
NOT_FINAL = "{} {} ended here, and no majority of the members has that on disk yet: {} waits for it"
UNHEARD = (
    "{} ended here, and that is not final: no majority of the members was heard for {:g} s, and it may go on "
    "elsewhere"
)
#: After so many seconds of a link a home has started its coordinators, if it does so at all.
SETTLED = 5.0


async def until_done(host: Host, lost_after: float) -> list[Fate]:
    """The fates of all coordinators. A host that nobody has heard for `lost_after` seconds is not waited for.

    One that has not come up yet is waited for as long as portal calls to it are, if that is longer. A
    coordinator that is not started yet is waited for as long as it may be: until a host that its start needs
    has ended for certain.
    """
    unmet = max(lost_after, host.options.unreachable_after)
    homes = {member.id: host.team.hosts[member.host] for member in host.team.coordinators}
    judge = Judge(homes)
    hearsay = host.core.hearsay
    remembered = _Remembered(host, homes, lost_after, unmet)
    # What was told while this host was starting is news, too.
    since = 0.0
    while True:
        host.changed.clear()
        found = known_fates(homes, host.mobility.knowledge(), host.mobility.proven(since))
        whole = hearsay.whole(host.clock.monotonic())
        if whole:
            hearsay.missed.clear()
        if homes.keys() - found.keys() and (hearsay.gone or not whole or host.mobility.lost):
            records = await _census(host)
            now = host.clock.monotonic()
            found = judge.judge(records, _absent(host, hearsay.absent(records, now, lost_after, unmet)))
            found |= known_fates(homes, host.mobility.knowledge(), host.mobility.proven(now - FRESH))
        unstartable = host.core.startup.unstartable(hearsay.gone)
        found |= {agent: Fate(agent, "lost", why) for agent, why in unstartable.items()}
        for agent in remembered.unsettled():
            found.pop(agent, None)
        if not homes.keys() - found.keys():
            await _pass_on(host, found.values())
            await _finality(host, lost_after)
            return [found[agent] for agent in sorted(homes)]
        await _news(host, ASK_EVERY)
        since = host.clock.monotonic() - FRESH


class _Remembered:
    """The endings that hosts know from journals: those of an earlier run, when a home begins a new one.

    `homes` has the home of each coordinator; `lost_after` and `unmet` are as in `Hearsay.absent`.
    """

    def __init__(self, host: Host, homes: Mapping[str, str], lost_after: float, unmet: float) -> None:
        self._host, self._homes, self._bounds = host, homes, (lost_after, unmet)
        pages = (page for page in host.scribe.pages if isinstance(page, CopyPage))
        self._ended = {(page.agent, page.generation) for page in pages if page.state == "EXITED"}
        #: The starts that were alive since this host was started, or ended here since.
        self._fresh: set[tuple[str, int]] = set()
        #: When each home was first linked.
        self._met: dict[str, float] = {}

    def unsettled(self) -> set[str]:
        """The coordinators that may be started anew yet."""
        if not self._host.scribe.memory:
            return set()
        newest: dict[str, int] = {}
        self._fresh |= self._host.mobility.telling - self._ended
        for row in self._host.mobility.knowledge():
            if row.agent not in self._homes:
                continue
            start = row.agent, row.generation
            newest[row.agent] = max(newest.get(row.agent, 0), row.generation)
            if row.state != "EXITED":
                self._fresh.add(start)
        old = {agent for agent, _ in newest.items() - self._fresh}
        return {agent for agent in old if not self._settled(self._homes[agent])}

    def _settled(self, home: str) -> bool:
        """Whether a home has started what it starts, or is not heard of."""
        host = self._host
        if home == host.name:
            return host.core.startup.settled
        now = host.clock.monotonic()
        if home in host.peers.incarnations:
            self._met.setdefault(home, now)
        if now >= self._met.get(home, now) + SETTLED:
            return True
        absent = host.core.hearsay.absent(set(host.team.hosts) - {home}, now, *self._bounds)
        return home in absent.gone or home in absent.unheard


def _absent(host: Host, absent: Absent) -> Absent:
    """With what those that answered answer from, and whether hosts keep what they have."""
    return replace(absent, lives=host.mobility.memories, kept=bool(host.scribe.memory))


async def _pass_on(host: Host, found: Collection[Fate]) -> None:
    """Tell of the endings, and stay until every host that can be reached has confirmed them."""
    host.pass_on(found)
    end = host.clock.monotonic() + LINGER
    while host.mobility.unconfirmed(_in_reach(host)) and host.clock.monotonic() < end:
        host.changed.clear()
        await _news(host, ASK_EVERY)


async def _finality(host: Host, lost_after: float) -> None:
    """Stay until what ended here is final, so that nobody recovers it; or without a lease for `lost_after`.

    A host without a lease keeps nobody from recovering it.
    """
    heard, told = host.clock.monotonic(), False
    while names := host.core.leases.unsettled:
        now = host.clock.monotonic()
        heard = now if host.core.leases.left else heard
        if now - heard >= lost_after:
            host.note(UNHEARD.format(listed(names), lost_after))
            return
        if not told:
            host.note(NOT_FINAL.format(listed(names), "has" if len(names) == 1 else "have", host.name))
            told = True
        host.changed.clear()
        await _news(host, ASK_EVERY)


def _in_reach(host: Host) -> set[str]:
    """The hosts that are linked, or about to be."""
    return {
        other for other in host.team.hosts if other in host.peers.incarnations or host.peers.is_new(other)
    }


async def _census(host: Host) -> Mapping[str, Sequence[Known]]:
    """The coordinators that this host and every host it can reach know of, by host, asked now."""
    host.statuses.clear()
    others = [
        other for other in host.team.hosts if other != host.name and other not in host.core.hearsay.gone
    ]
    for first in range(0, len(others), ASKED_AT_ONCE):
        if first:
            await asyncio.sleep(ASK_EVERY)
        await _ask(host, others[first : first + ASKED_AT_ONCE])
    # Their answers are no news to wait for: what changes from here on is.
    host.changed.clear()
    answers = {other: status.coordinators for other, status in host.statuses.items() if other}
    return answers | {host.name: host.mobility.knowledge()}


async def _ask(host: Host, others: Collection[str]) -> None:
    """Ask some, and wait for the answers of those that are linked, or are being called now."""
    asked: set[str] = set()
    for other in others:
        host.peers.reach(other)
    end = host.clock.monotonic() + ANSWER_WITHIN
    while True:
        host.changed.clear()
        linked = {other for other in others if other in host.peers.incarnations}
        for other in sorted(linked - asked):
            host.peers.send(other, StatusRequest())
        asked |= linked
        waited_for = {other for other in others if other in linked or host.peers.is_new(other)}
        if waited_for <= host.statuses.keys() or host.clock.monotonic() >= end:
            return
        await _news(host, max(0.0, end - host.clock.monotonic()))


async def _news(host: Host, bound: float) -> None:
    """Wait until something has changed, for so long at most."""
    # Not asyncio.wait_for: before Python 3.12 it may swallow a cancellation that comes with the news.
    with suppress(TimeoutError):
        async with asyncio.timeout(bound):
            await host.changed.wait()
