"""Link quality, clock offset and signature counts of a vehicle."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from lfield.driver import Clock
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.link.link_quality import SenderStats
from lfield_mavlink.link.ports import LinkCounts

#: Seconds between two reports, and between two round trips.
PERIOD = 1.0
#: Number of stored round trips; the shortest gives the offset, since it has the least queueing delay.
MAX_OFFSETS = 10
#: Seconds after which a response is ignored.
LATE = 3.0


class LinkHealth:
    """Publishes the link state once a second. `counts` returns the counters of all links."""

    def __init__(self, vehicle: Contact, counts: Callable[[], LinkCounts]) -> None:
        self._vehicle, self._counts = vehicle, counts
        self._sender = SenderStats()
        self._timesync = TimeSync(vehicle.clock, vehicle.send)
        vehicle.on(dialect.MAVLINK_MSG_ID_TIMESYNC, self._on_timesync)

    def count(self, sequence: int, now: float) -> None:
        """Counts a packet of the vehicle, decoded or not."""
        self._sender.add(sequence, now)

    async def run(self) -> None:
        """Reports and measures until cancelled."""
        while True:
            self._report()
            if not self._vehicle.is_quiet:
                self._timesync.start_round_trip()
            await asyncio.sleep(PERIOD)

    def _report(self) -> None:
        counts = self._counts()
        self._vehicle.publish(
            linkQuality=self._sender.quality(self._vehicle.clock.monotonic()),
            packetsLost=self._sender.lost,
            packetsBroken=counts.broken,
            signaturesGood=counts.good_signatures,
            signaturesBad=counts.bad_signatures,
            unsignedRefused=counts.unsigned,
        )

    def _on_timesync(self, message: Any) -> None:
        # A request would count as contact: PX4 requests ten times a second.
        if self._vehicle.is_quiet:
            return
        measured = self._timesync.on_message(message)
        if measured is not None:
            self._vehicle.publish(clockOffset=measured.offset, roundTrip=measured.round_trip)


class Offset(NamedTuple):
    """`offset`: the vehicle's clock minus our wall clock; `round_trip`; both in seconds."""

    offset: float
    round_trip: float


class TimeSync:
    """Clock offset by TIMESYNC, and responses to the vehicle's own.

    https://mavlink.io/en/services/timesync.html.
    """

    def __init__(self, clock: Clock, send: Callable[[Any], None]) -> None:
        self._clock, self._send = clock, send
        self._pending_requests: deque[int] = deque(maxlen=4)
        self._offsets: deque[Offset] = deque(maxlen=MAX_OFFSETS)

    def start_round_trip(self) -> None:
        now = self._now()
        self._pending_requests.append(now)
        self._send(dialect.MAVLink_timesync_message(0, now))

    def on_message(self, message: Any) -> Offset | None:
        """Handles a TIMESYNC: a request is answered; a response to ours gives the offset."""
        now = self._now()
        if message.tc1 == 0:
            self._send(dialect.MAVLink_timesync_message(now, message.ts1))
            return None
        # Responses to other stations, and repeated packets.
        if message.ts1 not in self._pending_requests:
            return None
        self._pending_requests.remove(message.ts1)
        round_trip = (now - message.ts1) / 1e9
        if round_trip > LATE:
            return None
        wall = self._clock.time() - now / 1e9
        self._offsets.append(Offset((message.tc1 - (message.ts1 + now) / 2) / 1e9 - wall, round_trip))
        return min(self._offsets, key=lambda offset: offset.round_trip)._replace(round_trip=round_trip)

    def _now(self) -> int:
        """Our monotonic clock in nanoseconds, never 0, which marks a request."""
        return max(round(self._clock.monotonic() * 1e9), 1)
