"""How a motion is begun, kept up, watched and given up, and whose vehicle it is."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from lfield.driver import Clock, DeviceError
from lfield_mavlink.contact.contact import SHOWS, Contact
from lfield_mavlink.geo import Vector
from lfield_mavlink.link.dialect import AUTOPILOT, dialect
from lfield_mavlink.parts.orders import ORDERS, Order, Stack, Target
from lfield_mavlink.services.parameters import Parameters

#: Seconds without coming closer after which a motion has failed, and what counts as closer, in metres.
STUCK, CLOSER = 10.0, 0.1
#: Seconds between two setpoints of a stream; PX4 wants more than 2 per second.
PERIOD = 0.05


class SetpointStream:
    """Repeats the last setpoint until a time, and never past it: PX4 must be fed."""

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


class Motion:
    """Modes and motions of one vehicle, for the parts whose instructions move it."""

    def __init__(self, vehicle: Contact, parameters: Parameters) -> None:
        self._vehicle, self._state, self._parameters = vehicle, vehicle.state, parameters
        self.stream = SetpointStream(vehicle.clock, vehicle.send)
        self.tolerance: float = vehicle.binding.option("tolerance")
        # The modes that the last order leads to; any other mode is somebody else's doing.
        self._commanded: frozenset[str] = frozenset()
        # What setSpeed() asked for last; the autopilot forgets it with every change of mode.
        self._speed: float | None = None

    @property
    def orders(self) -> Stack:
        """What this autopilot must be sent for a motion."""
        return ORDERS[self._vehicle.profile.autopilot]

    # -- modes ----------------------------------------------------------------------------------------

    @property
    def ours(self) -> bool:
        """Whether the mode is one that this program led to; of a vehicle at rest it does not matter."""
        if not self._state.armed:
            return True
        profile = self._vehicle.profile
        return self._state.mode in (profile.guided, *profile.own, *self._commanded)

    def claim(self, *modes: str) -> None:
        """These modes are what this program led to, and no others."""
        self._commanded = frozenset(modes)

    def begin(self, what: str) -> None:
        """A new motion ends the setpoints. Raises DeviceError when the vehicle is not ours to move."""
        self._vehicle.check_link()
        self._vehicle.check_identity()
        if not self.ours:
            raise self._vehicle.error(
                f"{what} refused: the vehicle is in {self._state.mode}, which this program did not "
                f"choose; {self._state.holder} has it. release() takes it back"
            )
        self.stream.stop()

    async def set_mode(self, name: str) -> None:
        """Any mode that the vehicle has. Raises DeviceError."""
        await self.enter(f"mode {name}", name, dialect.MAV_CMD_DO_SET_MODE, *self.mode_values(name))

    def mode_values(self, name: str) -> tuple[float, ...]:
        """The parameters of DO_SET_MODE for a mode that there is."""
        values = self._vehicle.profile.mode_values(name)
        assert values is not None, "the names are those of the table, or have been looked up in it"
        return (float(dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), *values)

    async def enter(
        self,
        what: str,
        mode: str,
        command: int,
        *values: float,
        done: Callable[[], bool] = lambda: False,
    ) -> None:
        """Enter a mode by a command that leads to it, or see that what it is for is `done`.

        Raises DeviceError.
        """
        # Noted before it is known to have worked: a safe state that is tried again must count as ours, and so
        # must the mode that it is still in when the new one is refused.
        self._commanded |= {mode}
        await self._vehicle.achieve(what, lambda: self._state.mode == mode or done(), command, *values)
        self.claim(mode)

    # -- motions --------------------------------------------------------------------------------------

    async def start(self, what: str, order: Order, taken: Callable[[], bool] | None = None) -> None:
        """Begin an order: parameters, mode, command, and the mode it leads to. Raises DeviceError."""
        for name, value in order.parameters.items():
            await self._parameters.write(name, value)
        if order.mode and self._state.mode != order.mode:
            await self.set_mode(order.mode)
        # As in `enter`: until the new order is seen, the mode it is still in is ours too.
        self._commanded |= order.modes
        if (command := order.command) is not None:
            await self._vehicle.command(
                what, command.number, *command.values, place=command.place, taken=taken
            )
        await self._vehicle.until(lambda: self._state.mode in order.modes, SHOWS, what)
        self.claim(*order.modes)

    async def travel(self, what: str, order: Order, distance: Callable[[Vector], float], near: float) -> None:
        """Wait until `distance` of the position is at most `near`, as long as it gets less.

        Raises DeviceError.
        """
        vehicle = self._vehicle
        start = vehicle.clock.monotonic()
        best, best_at, sent_at = math.inf, start, -math.inf
        while True:
            now = vehicle.clock.monotonic()
            vehicle.check_link()
            place = self._state.position
            left = distance(place) if place is not None else math.inf
            if left <= near:
                return
            self._check_underway(what, order.modes, start)
            if left < best - CLOSER:
                best, best_at = left, now
            if now - best_at > STUCK:
                await self._give_up(order)
                raise vehicle.error(
                    f"{what} gave up: no progress for {STUCK:g} s, {left:.1f} m from its goal"
                )
            if order.target is not None and place is not None and now - sent_at >= order.period:
                vehicle.send(self.setpoint(order.target(place)))
                sent_at = now
            await vehicle.next_news(min(0.25, order.period))

    def setpoint(self, target: Target) -> Any:
        """The message of a setpoint, in the autopilot's local frame."""
        place = (g + h for g, h in zip(target.place, self._state.home_offset, strict=True))
        frame, acceleration = dialect.MAV_FRAME_LOCAL_NED, (0.0, 0.0, 0.0)
        return dialect.MAVLink_set_position_target_local_ned_message(
            0,
            self._vehicle.system,
            AUTOPILOT,
            frame,
            target.mask,
            *place,
            *target.velocity,
            *acceleration,
            0.0,
            target.yaw_rate,
        )

    async def _give_up(self, order: Order) -> None:
        """Have the autopilot give up too, or the goal would be followed on when what is in its way has gone.

        A landing or a return goes on: there is nothing safer to do instead.
        """
        if order.command is not None or order.target is not None:
            with suppress(DeviceError):
                await self.set_mode(self._vehicle.profile.hold)

    def _check_underway(self, what: str, modes: frozenset[str], start: float) -> None:
        """Raise when somebody else has taken over, or the motors are off."""
        if self._state.armed and self._state.mode in modes:
            return
        why = f"the vehicle went to {self._state.mode}" if self._state.armed else "the motors are off"
        raise self._vehicle.error(f"{what} ended early: {why}{self._vehicle.reasons(start)}")

    # -- speed ----------------------------------------------------------------------------------------

    @property
    def wanted_speed(self) -> float | None:
        """What was asked for last, else the limit of the binding, else the autopilot's own."""
        return self._speed or self._vehicle.binding.limits.get("speed")

    async def set_speed(self, speed: float) -> None:
        """The speed over ground for this motion and those that follow. Raises DeviceError."""
        await self._change_speed(speed)
        self._speed = speed

    async def keep_speed(self) -> None:
        """Have the autopilot keep the wanted speed in what it flies by itself. Raises DeviceError."""
        if self.wanted_speed is not None:
            await self._change_speed(self.wanted_speed)

    async def _change_speed(self, speed: float) -> None:
        await self._vehicle.command("speed", dialect.MAV_CMD_DO_CHANGE_SPEED, 1.0, speed, -1.0)
