"""The page of a team of so many vehicles, each told of 5 times a second by its host: `watched_page.py N`.

The batches go through the bytes that hosts send and into the picture that `lfield watch` has; only the
sockets of the hosts are left out. Prints its link, and then a line for each latch: device, monotonic time.
"""

from __future__ import annotations

import asyncio
import math
import random
import sys
import time

from lfield.clock import SystemClock
from lfield.operator.sight.picture.places import Instruments
from lfield.operator.sight.picture.roll import Enrolled, Roll
from lfield.operator.sight.watched import Watched
from lfield.operator.web.server import Served, serve
from lfield.operator.web.site import on_this_computer
from lfield.wire.codec import decode, encode, limits
from lfield.wire.events import Came, Event, Latched, Measured, Released, Standing
from lfield.wire.framing import FrameDecoder
from lfield.wire.watching import Events

RATE = 5.0
#: Seconds between two latches, on average.
LATCH_EVERY = 0.7


class Hosts:
    """What all of them say."""

    def __init__(self, count: int, shown: Watched) -> None:
        self._shown, self._count = shown, count
        self._began = time.monotonic()
        self._numbers = [0] * count
        self._batches = [0] * count
        self._dice = random.Random(1)
        self._latched: dict[int, bool] = {}

    def say(self, host: int) -> None:
        """Its telemetry, a coordinator that comes now and then, and a latch or its end."""
        up = time.monotonic() - self._began
        told = [self._event(host, up, self._measured(host, up))]
        if self._dice.random() < 0.1:
            told.append(self._event(host, up, Standing("pilot", "running", "mission.L", 12, "v1.fly")))
        self._tell(host, up, told)

    def latch(self, host: int) -> None:
        """Its device goes into its safe state, or out of it; who waits for that is told when it did."""
        up = time.monotonic() - self._began
        device = f"v{host}.fc"
        latched = self._latched[host] = not self._latched.get(host, False)
        what = Latched(device, "land", "somebody wants it") if latched else Released(device)
        # As a host has it: within a twentieth of a second of its last batch it waits for the next.
        time_of_it = time.monotonic()
        self._tell(host, up, [self._event(host, up, what)])
        print(device, int(latched), time_of_it, flush=True)

    def hop(self, host: int, number: int) -> None:
        """A coordinator comes."""
        up = time.monotonic() - self._began
        of = f"h{(host - 1) % self._count}"
        self._tell(host, up, [self._event(host, up, Came("pilot", 1, number, of, 620))])

    def _tell(self, host: int, up: float, told: list[Event]) -> None:
        self._batches[host] += 1
        number = self._numbers[host]
        states = sum(not isinstance(event.what, Measured | Standing) for event in told)
        batch = Events(1, self._batches[host], time.time(), up, number - states, number, told)
        # As the follower gets it.
        decoder = FrameDecoder(limits("host", 0))
        ((kind, payload),) = decoder.feed(encode(batch))
        decoded = decode(kind, payload)
        assert isinstance(decoded, Events)
        self._shown.told(f"h{host}", decoded, None)

    def _event(self, host: int, up: float, what: Measured | Standing | Latched | Released | Came) -> Event:
        if not isinstance(what, Measured | Standing):
            self._numbers[host] += 1
        return Event(self._numbers[host], time.time(), up, 0, what)

    def _measured(self, host: int, up: float) -> Measured:
        angle = up / 5 + host
        north, east = (8 + 2 * host) * math.cos(angle), (8 + 2 * host) * math.sin(angle)
        values = {
            "position": [north, east, -5.0 - host % 7],
            "globalPosition": [47.0 + north * 9e-6, 8.0 + east * 13e-6, 400.0],
            "velocity": [1.0, 0.5, 0.0],
            "attitude": [0.01, 0.02, angle % 6.28],
            "heading": angle % 6.28,
            "groundSpeed": 1.4,
            "altitude": 5.0 + host % 7,
            "battery": 0.9,
            "voltage": 15.8,
            "current": 11.0,
            "mode": "GUIDED",
            "armed": True,
            "fix": 3,
            "satellites": 14,
            "ready": True,
        }
        return Measured(f"v{host}.fc", values, 0.05)


async def main(count: int) -> None:
    """Serve until killed."""
    hosts = tuple(f"h{number}" for number in range(count))
    agents = {f"v{n}": Enrolled(f"v{n}", "Copter", f"h{n}", "resource") for n in range(count)}
    agents["pilot"] = Enrolled("pilot", "Pilot", "h0", "coordinator")
    roll = Roll("bench", hosts, agents, {f"v{n}.fc": Instruments(moves=True) for n in range(count)})
    shown = Watched(roll, SystemClock())
    for host in hosts:
        shown.linked(host)

    class NobodyActs:
        barred: dict[str, str] = {}

    said = Hosts(count, shown)

    async def one(host: int) -> None:
        await asyncio.sleep(host / count / RATE)
        while True:
            said.say(host)
            await asyncio.sleep(1 / RATE)

    async def latches() -> None:
        dice = random.Random(2)
        number = 0
        while True:
            await asyncio.sleep(dice.uniform(0.5, 1.5) * LATCH_EVERY)
            number += 1
            said.latch(dice.randrange(count))
            said.hop(number % count, number)

    page = Served("bench", shown, NobodyActs(), SystemClock())  # type: ignore[arg-type]
    await asyncio.gather(
        serve(page, on_this_computer(0), lambda link: print(link, flush=True)),
        shown.tick(),
        latches(),
        *(one(host) for host in range(count)),
    )


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1])))
