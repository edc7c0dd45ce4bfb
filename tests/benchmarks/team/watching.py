"""An observer of hosts, for the figure `events`.

watching.py HOST=ADDRESS...

prints `watching` when all hosts are connected, and discards their events.
"""

from __future__ import annotations

import asyncio
import sys

from lfield.clock import SystemClock
from lfield.operator.client import observer_transport, own_keys
from lfield.operator.dashboard.event_stream.event_follower import EventFollower, FollowOptions
from lfield.wire.subscription_messages import EventBatch

#: Telemetry rate of each agent and device (Hz).
RATE = 5.0


class Reader:
    """Prints a line when all hosts are connected, and discards events."""

    def __init__(self, hosts: int) -> None:
        self._missing = hosts

    def on_linked(self, host: str) -> None:
        """Count the host; print `watching` after the last one."""
        self._missing -= 1
        if not self._missing:
            print("watching", flush=True)

    def on_unlinked(self, host: str, why: str) -> None:
        """Do nothing: the `EventFollower` connects again."""

    def on_batch(self, host: str, batch: EventBatch, took: float | None) -> None:
        """Discard the batch."""


async def main(words: list[str]) -> None:
    """Observe the hosts until killed."""
    addresses = dict(word.split("=", 1) for word in words)
    transport = observer_transport(own_keys(addresses.values(), None))

    async def reach(host: str) -> str:
        return addresses[host]

    reader = Reader(len(addresses))
    await EventFollower(
        transport, list(addresses), reach, reader, SystemClock(), FollowOptions(telemetry=RATE)
    ).run()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1:]))
