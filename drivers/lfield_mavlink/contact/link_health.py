"""How well the vehicle is heard, how its clock stands to ours, and whether its packets are believed."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from lfield.driver import Clock
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.link.ports import LinkCounts
from lfield_mavlink.link.stats import SenderStats

#: Seconds between two reports, and two round trips.
PERIOD = 1.0
#: Round trips that are kept; the shortest tells the offset best, since the least of it was waiting in queues.
KEPT = 10
#: Seconds after which the answer to a question is no longer believed.
LATE = 3.0


class LinkHealth:
    """Publishes the state of the link once a second. `counts` tells what the readers of all links counted."""

    def __init__(self, vehicle: Contact, counts: Callable[[], LinkCounts]) -> None:
        self._vehicle, self._counts = vehicle, counts
        self._sender = SenderStats()
        self._timesync = TimeSync(vehicle.clock, vehicle.send)
        vehicle.on(dialect.MAVLINK_MSG_ID_TIMESYNC, self._on_timesync)

    def count(self, sequence: int, now: float) -> None:
        """A packet has come from the vehicle, read or not."""
        self._sender.add(sequence, now)

    async def keep(self) -> None:
        """Report and measure until cancelled."""
        while True:
            self._report()
            if not self._vehicle.quiet:
                self._timesync.ask()
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
        # An answer would be a word of ours: PX4 asks ten times a second.
        if self._vehicle.quiet:
            return
        measured = self._timesync.on_message(message)
        if measured is not None:
            self._vehicle.publish(clockOffset=measured.offset, roundTrip=measured.round_trip)


class Offset(NamedTuple):
    """`offset`: the vehicle's clock minus our wall clock; `round_trip`; both in seconds."""

    offset: float
    round_trip: float


class TimeSync:
    """The vehicle's clock beside ours: round trips with it, and answers to its own.

    https://mavlink.io/en/services/timesync.html
    """

    def __init__(self, clock: Clock, send: Callable[[Any], None]) -> None:
        self._clock, self._send = clock, send
        self._asked: deque[int] = deque(maxlen=4)
        self._kept: deque[Offset] = deque(maxlen=KEPT)

    def ask(self) -> None:
        """Begin a round trip."""
        now = self._now()
        self._asked.append(now)
        self._send(dialect.MAVLink_timesync_message(0, now))

    def on_message(self, message: Any) -> Offset | None:
        """Take a TIMESYNC in: a question is answered; an answer to ours gives what is now known."""
        now = self._now()
        if message.tc1 == 0:
            self._send(dialect.MAVLink_timesync_message(now, message.ts1))
            return None
        # The vehicle answers other ground stations too, and a packet may come twice.
        if message.ts1 not in self._asked:
            return None
        self._asked.remove(message.ts1)
        round_trip = (now - message.ts1) / 1e9
        if round_trip > LATE:
            return None
        wall = self._clock.time() - now / 1e9
        self._kept.append(Offset((message.tc1 - (message.ts1 + now) / 2) / 1e9 - wall, round_trip))
        return min(self._kept, key=lambda kept: kept.round_trip)._replace(round_trip=round_trip)

    def _now(self) -> int:
        """Our monotonic clock in nanoseconds, never 0, which marks a question."""
        return max(round(self._clock.monotonic() * 1e9), 1)
