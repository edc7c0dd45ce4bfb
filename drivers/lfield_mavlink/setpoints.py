"""Setpoints on the wire: one message for ArduPilot, a stream that ends by itself for PX4."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from lfield.clock import Clock

#: Seconds between two setpoints of a stream; PX4 wants more than 2 per second.
PERIOD = 0.05


class SetpointStream:
    """Repeats the last setpoint until a time, and never past it."""

    def __init__(self, clock: Clock, send: Callable[[Any], None]) -> None:
        self._clock, self._send = clock, send
        self._timer: asyncio.TimerHandle | None = None

    def start(self, message: Any, until: float) -> None:
        """Send a message now and on until `until` (on the clock), in place of what was sent before."""
        self.stop()
        self._repeat(message, until)

    def stop(self) -> None:
        """Send no more."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _repeat(self, message: Any, until: float) -> None:
        self._timer = None
        now = self._clock.monotonic()
        if now >= until:
            return
        self._send(message)
        if now + PERIOD < until:
            loop = asyncio.get_running_loop()
            self._timer = loop.call_later(PERIOD, self._repeat, message, until)
