"""Somebody who watches hosts, for the figure `events`.

    watching.py HOST=ADDRESS...

says `watching` when all are heard, and reads what they tell.
"""

from __future__ import annotations

import asyncio
import sys

from lfield.clock import SystemClock
from lfield.operator.ask import observer, own_keys
from lfield.operator.sight.following.follower import Follower
from lfield.wire.watching import Events

#: How often a second each agent and device is told of.
RATE = 5.0


class Reader:
    """Reads, and says once when all are heard."""

    def __init__(self, hosts: int) -> None:
        self._missing = hosts

    def linked(self, host: str) -> None:
        """A host is heard."""
        self._missing -= 1
        if not self._missing:
            print("watching", flush=True)

    def unlinked(self, host: str, why: str) -> None:
        """It is tried again."""

    def told(self, host: str, batch: Events, took: float | None) -> None:
        """What happens is read, and that is all."""


async def main(words: list[str]) -> None:
    """Watch until the end."""
    addresses = dict(word.split("=", 1) for word in words)
    transport = observer(own_keys(addresses.values(), None))

    async def reach(host: str) -> str:
        return addresses[host]

    hearer = Reader(len(addresses))
    await Follower(transport, list(addresses), reach, hearer, SystemClock(), telemetry=RATE).run()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1:]))
