"""The referee as a device: instruction and telemetry. `referee.py` defines the requests."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from lfield.driver import Device, DeviceError
from lfield_arena.referee import SIDES

#: Seconds between two requests while the device waits for the kick-off.
INTERVAL = 0.05
STATE = ("now", "north_goals", "south_goals")


class WhistleDevice(Device):
    """The referee. The last argument, `ask`, sends a request and returns the answer."""

    def __init__(self, *arguments: Any) -> None:
        *device_arguments, ask = arguments
        super().__init__(*device_arguments)
        self._ask: Callable[[str], Awaitable[str]] = ask
        self._lost = False

    async def poll(self) -> None:
        """Reads the state of the match; logs the loss of the link."""
        try:
            await self._state()
        except DeviceError as error:
            if not self._lost:
                self.note(f"lost: {error.reason}")
            self._lost = True
        else:
            self._lost = False

    async def _open(self) -> str:
        end = self.clock.monotonic() + self.binding.option("connect")
        while True:
            try:
                await self._state()
                return "the referee"
            except DeviceError:
                if self.clock.monotonic() >= end:
                    raise
                await asyncio.sleep(INTERVAL)

    async def do_ready(self, side: str) -> None:
        """Reports a team as ready; returns at the kick-off."""
        if side not in SIDES:
            raise self.error(f"a team plays to the {SIDES[0]} or the {SIDES[1]}, not to {side!r}")
        while (answer := await self._ask(f"ready {side}")) != "ok":
            if answer != "wait":
                raise self.error(answer if answer.isprintable() else repr(answer))
            await asyncio.sleep(INTERVAL)

    async def _state(self) -> None:
        """Reads and publishes the state of the match."""
        fields = (await self._ask("?")).split()
        try:
            state = {name: float(value) for name, value in zip(fields[::2], fields[1::2], strict=True)}
            match = [state[name] for name in STATE]
        except (ValueError, KeyError):
            raise self.error(f"its state is invalid: {' '.join(fields)[:80]!r}") from None
        self.heard()
        self.publish(match=match)
