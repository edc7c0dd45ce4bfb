"""A scripted vehicle joined to a service by a channel that may lose, repeat and overtake packets."""

from __future__ import annotations

import asyncio
import random
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from lfield.errors import DeviceError
from lfield.simulate.jumping_loop import run_jumping
from lfield_mavlink.link.dialect import Reader, Writer, dialect


class Channel:
    """Both directions of a link, in bytes, and the Peer that a service uses.

    `vehicle` is called with each message; what it returns is sent.
    """

    def __init__(
        self,
        vehicle: Callable[[Any], list[Any]],
        *,
        seed: int = 0,
        loss: float = 0.0,
        repeat: float = 0.0,
        overtake: float = 0.0,
    ) -> None:
        self.vehicle = vehicle
        self.random = random.Random(seed)
        self.loss, self.repeat, self.overtake = loss, repeat, overtake
        self.sent: list[Any] = []
        self.handlers: defaultdict[int, list[Callable[[Any], None]]] = defaultdict(list)
        self.up = (Writer(), Reader())
        self.down = (dialect.MAVLink(None, srcSystem=1, srcComponent=1), Reader())
        self.system = 1
        #: Raises in tests where the link is lost.
        self.check_link: Callable[[], None] = lambda: None

    def on(self, message_id: int, handler: Callable[[Any], None]) -> None:
        """Subscribes the service to messages of this id."""
        self.handlers[message_id].append(handler)

    def error(self, reason: str, *, timeout: bool = False) -> DeviceError:
        return DeviceError("fc", reason, kind="DeviceTimeoutException" if timeout else "DeviceException")

    def send(self, message: Any) -> None:
        """From the service to the vehicle."""
        self.sent.append(message)
        self._carry(self.up[0].pack(message, 255), self._at_vehicle)

    def send_text(self, messages: list[Any]) -> None:
        """From the vehicle to the service."""
        for message in messages:
            data = bytes(message.pack(self.down[0]))
            self.down[0].seq = (self.down[0].seq + 1) % 256
            self._carry(data, self._at_service)

    def _carry(self, data: bytes, arrive: Callable[[bytes], None]) -> None:
        loop = asyncio.get_running_loop()
        for _ in range(2 if self.random.random() < self.repeat else 1):
            if self.random.random() >= self.loss:
                delay = 0.005 + (0.3 * self.random.random() if self.random.random() < self.overtake else 0.0)
                loop.call_later(delay, arrive, data)

    def _at_vehicle(self, data: bytes) -> None:
        for message in self.up[1].feed(data):
            self.send_text(self.vehicle(message))

    def _at_service(self, data: bytes) -> None:
        for message in self.down[1].feed(data):
            for handler in self.handlers[message.get_msgId()]:
                handler(message)

    def kinds(self) -> list[str]:
        """The message types that the service has sent, in order."""
        return [message.get_type() for message in self.sent]


def run(work: Any, seconds: float = 1e6) -> Any:
    """Runs `work` in virtual time; it must end within `seconds`."""

    async def bounded() -> Any:
        async with asyncio.timeout(seconds):
            return await work

    return run_jumping(bounded())
