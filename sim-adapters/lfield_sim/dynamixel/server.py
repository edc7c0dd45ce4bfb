"""The chain on the loop's time behind a serial port.

A client with another baud rate than a servo is not heard by it: the speed is asked of the terminal (Linux).
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path

from lfield.errors import AddressError
from lfield.loop import Simulated
from lfield_sim.dynamixel.chain import Chain, Reply
from lfield_sim.terminal import Terminal

#: How often the servos move when nobody asks, in seconds.
TICK = 0.02
#: asyncio wakes up a millisecond late: the last COARSE seconds are slept; GRAIN is not worth waiting for.
COARSE, GRAIN = 0.002, 0.0001


class Server:
    """One adapter with its chain. It stays plugged in until `unplug`.

    `moved` is called whenever a servo may have changed.
    """

    def __init__(self, chain: Chain, path: Path, moved: Callable[[], None]) -> None:
        self._chain, self._moved = chain, moved
        self._loop = asyncio.get_running_loop()
        # A simulated loop wakes up to the moment.
        self._coarse = 0.0 if isinstance(self._loop, Simulated) else COARSE
        self._terminal = Terminal(path, self._received)
        self.plug, self.unplug = self._terminal.plug, self._terminal.unplug
        chain.faults.watch(self._follow)

    @property
    def now(self) -> float:
        """The chain's time."""
        return self._loop.time()

    def _follow(self) -> None:
        """Be where the faults say. Raises ValueError, which whoever sets them is told."""
        if self._chain.faults.get("unplug"):
            self.unplug()
            return
        try:
            self.plug()
        except AddressError as error:
            raise ValueError(str(error)) from None

    def _received(self, data: bytes, speed: int | None) -> None:
        replies = self._chain.receive(data, self.now, speed)
        self._moved()
        for reply in replies:
            self._send(reply)

    def _send(self, reply: Reply) -> None:
        left = reply.at - self.now
        if left > self._coarse:
            self._loop.call_later(left - self._coarse / 2, self._write, reply)
        else:
            self._write(reply)

    def _write(self, reply: Reply) -> None:
        left = reply.at - self.now
        if left > GRAIN:
            time.sleep(left)
        self._terminal.write(reply.data)

    async def run(self) -> None:
        """Let the servos move, for ever."""
        while True:
            self._chain.advance(self.now)
            self._moved()
            await asyncio.sleep(TICK)
