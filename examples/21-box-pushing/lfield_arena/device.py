"""A robot as a device: instructions and telemetry. `robot.py` defines the requests."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any

from lfield.driver import Device, DeviceError

#: Seconds: interval of polls; time-out of a stop.
POLL_INTERVAL, STOP_TIMEOUT = 0.05, 0.5
#: The fields of each state.
STATE = "north", "east", "moving", "broken", "watchdog", "targets", "now", "north_goals", "south_goals"
#: The fields of each observed object.
TARGET_FIELDS = ("north", "east", "heading")


class OmniDevice(Device):
    """A robot. The last argument, `ask`, sends a request and returns the answer."""

    def __init__(self, *arguments: Any) -> None:
        *device_arguments, ask = arguments
        super().__init__(*device_arguments)
        self._ask: Callable[[str], Awaitable[str]] = ask
        self._lost = self._moves = False

    async def poll(self) -> None:
        """Reads the state of the robot; logs the loss and the recovery of the link."""
        try:
            await self._state()
        except DeviceError as error:
            if not self._lost:
                self.note(f"lost: {error.reason}")
            self._lost = True
        else:
            if self._lost:
                self.note("it responds again")
            self._lost = False

    async def _open(self) -> str:
        end = self.clock.monotonic() + self.binding.option("connect")
        while True:
            try:
                state = await self._state()
                return f"robot {self.binding.option('robot')} at ({state['north']:.2f}, {state['east']:.2f})"
            except DeviceError:
                if self.clock.monotonic() >= end:
                    raise
                await asyncio.sleep(POLL_INTERVAL)

    async def _set_watchdog(self, longest: float) -> float | None:
        await self._command(f"watchdog {longest:.3f}")
        return (await self._state())["watchdog"]

    async def _make_safe(self, state: str) -> None:
        await self._command("stop")
        end = self.clock.monotonic() + STOP_TIMEOUT
        while (await self._state())["moving"]:
            if self.clock.monotonic() > end:
                raise self.error("it was commanded to stop but still moves")
            await asyncio.sleep(POLL_INTERVAL)

    def _moving(self) -> str:
        if self._lost:
            return "no message"
        return "still moving" if self._moves else ""

    async def do_drive_to(self, north: float, east: float, seconds: float) -> bool:
        """Moves to a goal. True at the goal; False if the robot was stopped because the time is over."""
        self._check(north, east, seconds)
        if math.hypot(north, east) > self.binding.limits.get("radius", math.inf):
            raise self.error(
                f"({north:g}, {east:g}) is outside the radius of {self.binding.limits['radius']:g} m"
            )
        end = self.clock.monotonic() + seconds
        await self._command(f"go {north} {east} {self._limit}")
        while (state := await self._state())["moving"]:
            if self.clock.monotonic() >= end:
                await self._make_safe("stop")
                return False
            await asyncio.sleep(POLL_INTERVAL)
        if state["broken"]:
            raise self.error("its motors are off: a fault")
        return True

    async def do_stop(self) -> None:
        """Stops the robot and waits until it is at rest. Also cancels driveTo."""
        await self._make_safe("stop")

    async def do_set_velocity(self, north: float, east: float) -> None:
        """Sends a velocity once. The guard stops the robot if the program does not renew the velocity."""
        self._check(north, east)
        if math.hypot(north, east) > self._limit:
            raise self.error(f"{math.hypot(north, east):g} m/s is above its limit of {self._limit:g}")
        await self._command(f"drive {north} {east}")

    async def do_kick(self, speed: float) -> bool:
        """Kicks the ball. False if the ball is too far away."""
        self._check(speed)
        answer = await self._ask(f"kick {speed}")
        if answer not in ("ok", "no ball"):
            raise self.error(answer if answer.isprintable() else repr(answer))
        return answer == "ok"

    @property
    def _limit(self) -> float:
        return self.binding.limits.get("speed", 1e3)

    def _check(self, *numbers: float) -> None:
        if not all(map(math.isfinite, numbers)):
            raise self.error(f"numbers must be finite, not {', '.join(map(str, numbers))}")

    async def _command(self, line: str) -> None:
        answer = await self._ask(line)
        if answer != "ok":
            raise self.error(answer if answer.isprintable() else repr(answer))

    async def _state(self) -> dict[str, float]:
        """Reads and publishes the state of the robot."""
        fields = (await self._ask("?")).split()
        try:
            state = {name: float(value) for name, value in zip(fields[::2], fields[1::2], strict=True)}
            if not all(map(math.isfinite, state.values())) or not state.keys() >= set(STATE):
                raise ValueError
            names = (f"target{n}_{part}" for n in range(int(state["targets"])) for part in TARGET_FIELDS)
            target = [state[name] for name in names]
        except (ValueError, KeyError):
            raise self.error(f"its state is invalid: {' '.join(fields)[:80]!r}") from None
        self._moves = bool(state["moving"])
        self.heard()
        self.publish(
            position=[state["north"], state["east"]],
            moving=self._moves,
            target=target,
            match=[state["now"], state["north_goals"], state["south_goals"]],
        )
        return state
