"""Somebody who watches hosts, for the figure `events`.

    watching.py HOST=ADDRESS...

says `watching` when all are heard, and reads what they tell.
"""

from __future__ import annotations

import asyncio
import sys

from lfield.clock import SystemClock
from lfield.operator.client import observer_transport, own_keys
from lfield.operator.dashboard.event_stream.event_follower import EventFollower, FollowOptions
from lfield.wire.subscription_messages import EventBatch

#: How often a second each agent and device is told of.
RATE = 5.0


class Reader:
    """Reads, and says once when all are heard."""

    def __init__(self, hosts: int) -> None:
        self._missing = hosts

    def on_linked(self, host: str) -> None:
        """A host is heard."""
        self._missing -= 1
        if not self._missing:
            print("watching", flush=True)

    def on_unlinked(self, host: str, why: str) -> None:
        """Do nothing: the `EventFollower` connects again."""

    def on_batch(self, host: str, batch: EventBatch, took: float | None) -> None:
        """Discard the batch."""


async def main(words: list[str]) -> None:
    """Watch until the end."""
    addresses = dict(word.split("=", 1) for word in words)
    transport = observer_transport(own_keys(addresses.values(), None))

    async def reach(host: str) -> str:
        return addresses[host]

    hearer = Reader(len(addresses))
    await EventFollower(
        transport, list(addresses), reach, hearer, SystemClock(), FollowOptions(telemetry=RATE)
    ).run()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1:]))
