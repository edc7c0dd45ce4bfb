"""The watchers of one host: a batch of events for each when it is due, a timer only while there is one."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from lfield.clock import Clock
from lfield.devices.guards import Guards
from lfield.errors import AddressError
from lfield.host.core import HostCore
from lfield.host.sight.portals import Portals
from lfield.host.sight.watcher import PATIENCE, Watcher
from lfield.host.watching.standing import sample
from lfield.net.health.watch import Figures
from lfield.net.transport import Link
from lfield.wire.messages import Refuse
from lfield.wire.observing import Status
from lfield.wire.watching import Events, Seen, Watch

#: So many may watch one host.
MOST = 16
#: For so many seconds after the last of them has gone portal calls are still told, for one that comes back.
LINGER = 60.0
#: Seconds between two looks at who can be called in the team.
OFFERS_EVERY = 1.0
#: A timer that is a little early is set again, and not for no time at all.
TICK = 0.001


def giving_way(watching: Sequence[str], comes: str) -> int | None:
    """Which place is given to one more who `comes`, of all that are taken; None for none.

    It is the oldest of whoever has the most, if they still have as many as the newcomer then: nobody shuts
    all others out by watching more than once.
    """
    most = max(watching, key=Counter(watching).__getitem__)
    return watching.index(most) if watching.count(most) > watching.count(comes) + 1 else None


class Watchers:
    """Whoever watches a host, by link; `status` is for snapshots, `links` are the figures of its links."""

    def __init__(
        self,
        core: HostCore,
        guards: Guards,
        clock: Clock,
        status: Callable[[], Status],
        links: Mapping[str, Figures],
    ) -> None:
        self._core, self._guards, self._clock, self._status = core, guards, clock, status
        self._figures = links
        self._teller = core.teller
        self._portals = Portals(core.teller, core.machine)
        self._watchers: dict[Link, Watcher] = {}
        self._timer: asyncio.TimerHandle | None = None
        self._leaving: asyncio.TimerHandle | None = None
        self._offers_due = 0.0

    def watch(self, message: Watch, link: Link) -> None:
        """Somebody wants to be told from now on."""
        if len(self._watchers) >= MOST and link not in self._watchers:
            way = giving_way([str(each.who) for each in self._watchers], str(link.who))
            if way is None:
                self._end(link, f"{MOST} others watch {self._core.name} already")
                return
            self._end(list(self._watchers)[way], f"others watch {self._core.name} too, and less often")
        teller, before = self._teller, self._watchers.get(link)
        # Nobody can keep a host busy by asking anew.
        begins = teller.up if before is None else max(teller.up, before.next)
        self._watchers[link] = watcher = Watcher(teller.stream, self._core.incarnation, message, begins)
        if before is not None:
            watcher.goes_on(before)
        self._portals.attach()
        if self._leaving is not None:
            self._leaving.cancel()
            self._leaving = None
        teller.on_told = self._told
        self._turn()

    def seen(self, message: Seen, link: Link) -> None:
        """A watcher has read what it was sent."""
        if (watcher := self._watchers.get(link)) is not None:
            watcher.seen(message.batch, self._teller.up)
            self._told()

    def last_words(self) -> None:
        """The host ends: tell each watcher what it is owed, as far as it reads, and close its link."""
        self._teller.settle(at_once=True)
        for link, watcher in list(self._watchers.items()):
            while (batch := self._batch(watcher, max(self._teller.up, watcher.due))) and batch.events:
                self._send(link, batch)
            link.close()
        self._watchers.clear()
        self._rest()

    def _told(self) -> None:
        """Something is owed that was not: sooner or later than the timer stands."""
        self._wake_at(min((watcher.due for watcher in self._watchers.values()), default=None))

    def _wake_at(self, due: float | None) -> None:
        if due is None:
            return
        pause = max(TICK, due - self._teller.up)
        loop = asyncio.get_running_loop()
        if self._timer is not None:
            if self._timer.when() <= loop.time() + pause:
                return
            self._timer.cancel()
        self._timer = loop.call_later(pause, self._wake)

    def _wake(self) -> None:
        self._timer = None
        self._turn()

    def _turn(self) -> None:
        """Whatever is due for anybody."""
        self._teller.settle()
        up, at = self._teller.up, self._clock.time()
        if up >= self._offers_due:
            self._offers_due = up + OFFERS_EVERY
            self._look_at_offers()
        dues = [watcher.sample_due for watcher in self._watchers.values() if watcher.sample_due is not None]
        if dues and up >= min(dues):
            now = sample(self._core, self._guards, self._figures, self._clock.monotonic())
            for watcher in self._watchers.values():
                watcher.sample(now, at, up)
        for link, watcher in list(self._watchers.items()):
            if watcher.has_gone(up):
                self._send(link, watcher.last(at, up))
                self._end(link, f"what it watches was not read for {PATIENCE:g} s")
            elif batch := self._batch(watcher, up):
                self._send(link, batch)
        if self._watchers:
            self._come_back()
        else:
            self._rest()

    def _come_back(self) -> None:
        dues = [watcher.due for watcher in self._watchers.values()]
        dues += [w.sample_due for w in self._watchers.values() if w.sample_due is not None]
        self._wake_at(min(*dues, self._offers_due))

    def _batch(self, watcher: Watcher, up: float) -> Events | None:
        return watcher.batch(self._clock.time(), up, self._status)

    def _send(self, link: Link, message: Events) -> None:
        try:
            link.send(message)
        except AddressError:
            self._watchers.pop(link, None)

    def _end(self, link: Link, reason: str) -> None:
        """Tell somebody why it is told nothing more."""
        self._watchers.pop(link, None)
        try:
            link.send(Refuse(reason))
        except AddressError:
            return
        link.close()

    def _look_at_offers(self) -> None:
        team = self._core.team
        hosts = {member.id: team.hosts[member.host] for member in team.members}
        self._teller.offers(self._core.directory.refusals(), hosts)

    def _rest(self) -> None:
        """Nobody watches any more: no timer, and soon no word about portal calls."""
        self._teller.on_told = None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._leaving is None:
            self._leaving = asyncio.get_running_loop().call_later(LINGER, self._portals.detach)
