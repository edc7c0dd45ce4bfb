"""How well the vehicle is heard, how its clock stands to ours, and whether its packets are believed."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lfield_mavlink.dialect import dialect
from lfield_mavlink.link_stats import SenderStats
from lfield_mavlink.streams import Streams
from lfield_mavlink.timesync import TimeSync

#: Seconds between two reports, and two round trips.
PERIOD = 1.0


@dataclass(frozen=True, slots=True)
class LinkCounts:
    """What the readers of all links have counted: damaged packets, and signatures."""

    broken: int = 0
    good_signatures: int = 0
    bad_signatures: int = 0
    unsigned: int = 0


class LinkHealth(Streams):
    """Publishes the state of the link once a second. `counts` is set by the driver, which has the readers."""

    counts: Callable[[], LinkCounts] = LinkCounts

    def _set_up(self) -> None:
        super()._set_up()
        self._sender = SenderStats()
        self._timesync = TimeSync(self.clock, self._send)
        self._on(dialect.MAVLINK_MSG_ID_TIMESYNC, self._on_timesync)

    def on_message(self, message: Any) -> None:
        """A message of this vehicle's autopilot."""
        self._sender.add(message.get_seq(), self.clock.monotonic())
        super().on_message(message)

    def is_spare(self, kind: int, sequence: int) -> bool:
        """As above; what is not read is counted all the same."""
        spare = super().is_spare(kind, sequence)
        if spare:
            self._sender.add(sequence, self.clock.monotonic())
        return spare

    async def keep_link(self) -> None:
        """Report and measure until cancelled."""
        while True:
            self._report()
            if not self.quiet:
                self._timesync.ask()
            await asyncio.sleep(PERIOD)

    def _report(self) -> None:
        counts = self.counts()
        self.publish(
            linkQuality=self._sender.quality(self.clock.monotonic()),
            packetsLost=self._sender.lost,
            packetsBroken=counts.broken,
            signaturesGood=counts.good_signatures,
            signaturesBad=counts.bad_signatures,
            unsignedRefused=counts.unsigned,
        )

    def _on_timesync(self, message: Any) -> None:
        measured = self._timesync.on_message(message)
        if measured is not None:
            self.publish(clockOffset=measured.offset, roundTrip=measured.round_trip)
