"""Simulated hosts of N vehicles, one each, at Unix sockets of a folder: `watched_hosts.py FOLDER N`.

They send `Hello`, accept a `Subscribe`, and send telemetry at the requested rate over real links in the
wire format of real hosts. Unacknowledged batches are limited by the same window as in a real host. Prints
`ready`, then a line for each latch: device, 1 or 0 (latched or released), monotonic time.
"""

from __future__ import annotations

import asyncio
import math
import random
import sys
import time

from lfield.errors import LfieldError
from lfield.net.tcp_transport import TcpTransport
from lfield.net.transport import Link
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.events import (
    AgentActivity,
    DeviceLatched,
    DeviceReleased,
    DeviceTelemetry,
    Event,
    MigrationArrived,
)
from lfield.wire.messages import Hello, Message
from lfield.wire.subscription_messages import WINDOW, EventAck, EventBatch, Subscribe

RATE = 5.0
#: Seconds between two latches of the team, on average.
LATCH_EVERY = 0.7
#: Seconds in which a host collects events of a batch.
GATHERED = 0.05


class Host:
    """A host and the link of its observer. Implements `LinkHandler`."""

    def __init__(self, number: int) -> None:
        self.number, self._began = number, time.monotonic()
        self._link: Link | None = None
        self._batches = self._seen = self._states = self._sent = 0
        self._due: list[Event] = []
        self._rng = random.Random(number)
        self.latched = False

    @property
    def watched(self) -> bool:
        """True while an observer is subscribed."""
        return self._link is not None

    def on_message(self, link: Link, message: Message) -> None:
        """Handle `Hello`, `Subscribe` and `EventAck`."""
        match message:
            case Hello():
                link.accept_role(message.role)
                link.send(Hello("host", f"h{self.number}", 1))
            case Subscribe():
                self._link, self._batches, self._seen = link, 0, 0
                self._send()
            case EventAck(batch):
                self._seen = batch

    def on_transfer(self, link: Link, header: Transfer, block: memoryview) -> None:
        """Ignore: observers send no coordinators."""

    def on_oversize(self, link: Link, header: Transfer, size: int) -> None:
        """Ignore: observers send no coordinators."""

    def on_closed(self, link: Link, error: LfieldError | None) -> None:
        """Forget the closed link of the observer."""
        self._link = None

    def telemetry(self) -> None:
        """Send telemetry, and sometimes the activity of a coordinator; nothing while the observer lags."""
        if self._batches - self._seen >= WINDOW:
            return
        self._queue(self._measured())
        if self._rng.random() < 0.1:
            self._queue(AgentActivity("pilot", "running", "mission.L", 12, "v1.fly"))
        self._send()

    async def state(self, what: DeviceLatched | DeviceReleased | MigrationArrived) -> None:
        """Send a state event, which must not be lost."""
        self._states += 1
        self._queue(what)
        await asyncio.sleep(self._rng.uniform(0.0, GATHERED))
        self._send()

    def _queue(
        self, what: DeviceTelemetry | AgentActivity | DeviceLatched | DeviceReleased | MigrationArrived
    ) -> None:
        up = time.monotonic() - self._began
        self._due.append(Event(self._states, time.time(), up, 0, what))

    def _send(self) -> None:
        if self._link is None:
            return
        self._batches += 1
        up = time.monotonic() - self._began
        due, self._due = self._due, []
        self._link.send(EventBatch(1, self._batches, time.time(), up, self._sent, self._states, due))
        self._sent = self._states

    def _measured(self) -> DeviceTelemetry:
        host = self.number
        angle = (time.monotonic() - self._began) / 5 + host
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
        return DeviceTelemetry(f"v{host}.fc", values, 0.05)


async def latches(hosts: list[Host]) -> None:
    """Latch or release a device and move a coordinator, repeatedly."""
    rng, number = random.Random(2), 0
    while True:
        await asyncio.sleep(rng.uniform(0.5, 1.5) * LATCH_EVERY)
        number += 1
        host = rng.choice(hosts)
        device, host.latched = f"v{host.number}.fc", not host.latched
        what = DeviceLatched(device, "land", "somebody wants it") if host.latched else DeviceReleased(device)
        print(device, int(host.latched), time.monotonic(), flush=True)
        await host.state(what)
        of = f"h{(number - 1) % len(hosts)}"
        await hosts[number % len(hosts)].state(MigrationArrived("pilot", 1, number, of, 620))


async def main(folder: str, count: int) -> None:
    """Send events until killed."""
    transport, hosts = TcpTransport(1 << 20), [Host(number) for number in range(count)]
    listeners = [
        await transport.listen(f"unix:{folder}/h{host.number}.sock", lambda _, host=host: host)
        for host in hosts
    ]
    assert len(listeners) == count
    print("ready", flush=True)

    async def one(host: Host) -> None:
        while not host.watched:
            await asyncio.sleep(0.1)
        await asyncio.sleep(host.number / count / RATE)
        while True:
            host.telemetry()
            await asyncio.sleep(1 / RATE)

    await asyncio.gather(latches(hosts), *map(one, hosts))


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], int(sys.argv[2])))
