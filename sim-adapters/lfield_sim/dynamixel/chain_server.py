"""The chain in real time behind a serial port.

A servo ignores a client with another baud rate, which is read from the terminal (Linux).
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path

from lfield.errors import AddressError
from lfield.event_loop import SimulatedLoop
from lfield_sim.dynamixel.servo_chain import ServoChain, TimedReply
from lfield_sim.terminal import Terminal

#: Seconds between two steps of the servos without requests.
TICK = 0.02
#: asyncio wakes up a millisecond late: the last COARSE seconds use `time.sleep`; less than GRAIN is skipped.
COARSE, GRAIN = 0.002, 0.0001


class ChainServer:
    """One adapter with its chain. Plugged in until `unplug`.

    `on_change` is called whenever a servo may have changed.
    """

    def __init__(self, chain: ServoChain, path: Path, on_change: Callable[[], None]) -> None:
        self._chain, self._on_change = chain, on_change
        self._loop = asyncio.get_running_loop()
        # A simulated loop wakes up exactly.
        self._coarse = 0.0 if isinstance(self._loop, SimulatedLoop) else COARSE
        self._terminal = Terminal(path, self._received)
        self.plug, self.unplug = self._terminal.plug, self._terminal.unplug
        chain.faults.watch(self._apply_unplug_fault)

    @property
    def now(self) -> float:
        """The time of the chain."""
        return self._loop.time()

    def _apply_unplug_fault(self) -> None:
        """Applies the plug fault. Raises ValueError, which is reported to its setter."""
        if self._chain.faults.get("unplug"):
            self.unplug()
            return
        try:
            self.plug()
        except AddressError as error:
            raise ValueError(str(error)) from None

    def _received(self, data: bytes, speed: int | None) -> None:
        replies = self._chain.receive(data, self.now, speed)
        self._on_change()
        for reply in replies:
            self._send(reply)

    def _send(self, reply: TimedReply) -> None:
        remaining = reply.at - self.now
        if remaining > self._coarse:
            self._loop.call_later(remaining - self._coarse / 2, self._write, reply)
        else:
            self._write(reply)

    def _write(self, reply: TimedReply) -> None:
        remaining = reply.at - self.now
        if remaining > GRAIN:
            time.sleep(remaining)
        self._terminal.write(reply.data)

    async def run(self) -> None:
        """Advances the servos until cancelled."""
        while True:
            self._chain.advance(self.now)
            self._on_change()
            await asyncio.sleep(TICK)
