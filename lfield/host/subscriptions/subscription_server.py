"""Serves the event subscriptions of one host: sends batches when due; has no timer without subscribers."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from msgspec.structs import replace

from lfield.clock import Clock
from lfield.devices.device_guards import DeviceGuards
from lfield.errors import AddressError
from lfield.host.core import HostCore
from lfield.host.events.event_subscription import READ_TIMEOUT, EventSubscription
from lfield.host.events.portal_events import PortalEvents
from lfield.host.subscriptions.telemetry_snapshot import snapshot
from lfield.net.health.link_monitor import LinkFigures
from lfield.net.transport import Link
from lfield.wire.messages import HandshakeRefused
from lfield.wire.observer_messages import DirectoryEntry, Status
from lfield.wire.subscription_messages import EventAck, EventBatch, Subscribe

#: The maximum number of subscriptions of one host.
MAX_SUBSCRIPTIONS = 16
#: Seconds for which portal calls are recorded after the end of the last subscription.
LINGER = 60.0
#: Seconds between two checks of which agents can be called.
OFFERS_EVERY = 1.0
#: Minimum delay of a timer that expired early.
TICK = 0.001


def subscription_to_evict(watching: Sequence[str], newcomer: str) -> int | None:
    """The index of the subscription to evict for `newcomer`, of all present ones; None to refuse it.

    The result is the oldest subscription of the identity with the most, if this identity then still has at
    least as many as the newcomer: no identity can exclude others with several subscriptions.
    """
    identity = max(watching, key=Counter(watching).__getitem__)
    return watching.index(identity) if watching.count(identity) > watching.count(newcomer) + 1 else None


class SubscriptionServer:
    """The subscriptions of one host, by link; `status` is for snapshots, `links` are the figures of its
    links."""

    def __init__(
        self,
        core: HostCore,
        guards: DeviceGuards,
        clock: Clock,
        status: Callable[[], Status],
        links: Mapping[str, LinkFigures],
    ) -> None:
        self._core, self._guards, self._clock, self._status = core, guards, clock, status
        self._link_figures = links
        self._recorder = core.recorder
        self._portals = PortalEvents(core.recorder, core.machine)
        self._subscriptions: dict[Link, EventSubscription] = {}
        self._timer: asyncio.TimerHandle | None = None
        self._leaving: asyncio.TimerHandle | None = None
        self._offers_due = 0.0

    def subscribe(self, message: Subscribe, link: Link) -> None:
        """Start or replace a subscription."""
        if len(self._subscriptions) >= MAX_SUBSCRIPTIONS and link not in self._subscriptions:
            evicted = subscription_to_evict(
                [str(each.identity) for each in self._subscriptions], str(link.identity)
            )
            if evicted is None:
                self._end(link, f"{MAX_SUBSCRIPTIONS} others watch {self._core.name} already")
                return
            self._end(
                list(self._subscriptions)[evicted], f"others watch {self._core.name} too, and less often"
            )
        recorder, before = self._recorder, self._subscriptions.get(link)
        # A repeated request must not cause extra work.
        first_batch_at = recorder.uptime if before is None else max(recorder.uptime, before.next_batch_at)
        # Events before the subscription are not reported as lost.
        recorder.drain()
        self._subscriptions[link] = watcher = EventSubscription(
            recorder.event_log, self._core.incarnation, message, first_batch_at
        )
        if before is not None:
            watcher.resume_from(before)
        self._portals.attach()
        if self._leaving is not None:
            self._leaving.cancel()
            self._leaving = None
        recorder.listen(self._on_event)
        self._send_due()

    def snapshot_batch(self, *, directory: bool) -> EventBatch:
        """The state of the host as of its newest event, for an observer that requests it once, with the whole
        `directory` or not.
        """
        self._recorder.drain()
        latest = self._recorder.event_log.latest
        status = self._status() if directory else self._brief_status()
        now, uptime = self._clock.time(), self._recorder.uptime
        return EventBatch(self._core.incarnation, 1, now, uptime, latest, latest, [], {}, status)

    def on_ack(self, message: EventAck, link: Link) -> None:
        """A subscriber acknowledges batches."""
        if (watcher := self._subscriptions.get(link)) is not None:
            watcher.on_ack(message.batch, self._recorder.uptime, link.traffic.subscription_bytes)
            self._on_event()

    def flush_and_close(self) -> None:
        """The host stops: send each subscriber its pending events, if it reads them, and close its link."""
        self._recorder.report_dropped(at_once=True)
        for link, watcher in list(self._subscriptions.items()):
            while (batch := self._batch(watcher, max(self._recorder.uptime, watcher.due))) and batch.events:
                self._send(link, batch)
            link.close()
        self._subscriptions.clear()
        self._stop_timer()

    def _on_event(self) -> None:
        """An event is pending: the timer may have to expire earlier."""
        self._wake_at(min((watcher.due for watcher in self._subscriptions.values()), default=None))

    def _wake_at(self, due: float | None) -> None:
        if due is None:
            return
        pause = max(TICK, due - self._recorder.uptime)
        loop = asyncio.get_running_loop()
        if self._timer is not None:
            if self._timer.when() <= loop.time() + pause:
                return
            self._timer.cancel()
        self._timer = loop.call_later(pause, self._on_timer)

    def _on_timer(self) -> None:
        self._timer = None
        self._send_due()

    def _send_due(self) -> None:
        """Send all batches that are due."""
        self._recorder.report_dropped()
        uptime, at = self._recorder.uptime, self._clock.time()
        if uptime >= self._offers_due:
            self._offers_due = uptime + OFFERS_EVERY
            self._check_offers()
        dues = [
            watcher.sample_due for watcher in self._subscriptions.values() if watcher.sample_due is not None
        ]
        if dues and uptime >= min(dues):
            now = self._clock.monotonic()
            values = snapshot(self._core, self._guards, self._link_figures, now)
            stamp = self._recorder.hybrid_clock.tick(now)
            for watcher in self._subscriptions.values():
                watcher.on_sample(values, at, uptime, stamp)
        for link, watcher in list(self._subscriptions.items()):
            if watcher.has_gone(uptime):
                self._send(link, watcher.final_batch(at, uptime))
                self._end(link, f"what it watches was not read for {READ_TIMEOUT:g} s")
            elif batch := self._batch(watcher, uptime):
                watcher.on_sending(link.traffic.subscription_bytes)
                self._send(link, batch)
        if self._subscriptions:
            self._schedule()
        else:
            self._stop_timer()

    def _schedule(self) -> None:
        dues = [watcher.due for watcher in self._subscriptions.values()]
        dues += [w.sample_due for w in self._subscriptions.values() if w.sample_due is not None]
        self._wake_at(min(*dues, self._offers_due))

    def _batch(self, watcher: EventSubscription, uptime: float) -> EventBatch | None:
        return watcher.next_batch(self._clock.time(), uptime, self._brief_status)

    def _brief_status(self) -> Status:
        """The status without the attributes of agents of other hosts: every host has the attributes of all
        agents, so their total size grows with the square of the team.
        """
        status = self._status()
        own = {agent.id for agent in status.agents}
        brief = [
            entry if entry.agent in own else DirectoryEntry(entry.agent, entry.refusal, {}, {})
            for entry in status.directory
        ]
        return replace(status, directory=brief)

    def _send(self, link: Link, message: EventBatch) -> None:
        try:
            link.send(message)
        except AddressError:
            self._subscriptions.pop(link, None)

    def _end(self, link: Link, reason: str) -> None:
        self._subscriptions.pop(link, None)
        try:
            link.send(HandshakeRefused(reason))
        except AddressError:
            return
        link.close()

    def _check_offers(self) -> None:
        """Record which agents are offered from now on, or not any more."""
        team = self._core.team
        hosts = {member.id: team.hosts[member.host] for member in team.members}
        self._recorder.on_offers(self._core.directory.refusals(), hosts)

    def _stop_timer(self) -> None:
        """No subscribers: stop the timer, and soon the recording of portal calls."""
        self._recorder.listen(None)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._leaving is None:
            self._leaving = asyncio.get_running_loop().call_later(LINGER, self._portals.detach)
