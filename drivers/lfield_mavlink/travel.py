"""How a motion is begun, kept up, watched and given up, and whose vehicle it is."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from lfield.errors import DeviceError
from lfield_mavlink.contact import SHOWS
from lfield_mavlink.dialect import AUTOPILOT, dialect
from lfield_mavlink.geo import Vector
from lfield_mavlink.orders import ORDERS, Order, Stack, Target
from lfield_mavlink.setpoints import SetpointStream
from lfield_mavlink.watchdog import Watchdog

#: Seconds without coming closer after which a motion has failed, and what counts as closer, in metres.
STUCK, CLOSER = 10.0, 0.1


class Travel(Watchdog):
    """Modes and motions; the instructions that use them are in Flight and Guidance."""

    def _set_up(self) -> None:
        super()._set_up()
        # The modes that the last order leads to; any other mode is somebody else's doing.
        self._commanded: frozenset[str] = frozenset()
        self._stream = SetpointStream(self.clock, self._send)

    @property
    def _orders(self) -> Stack:
        return ORDERS[self.profile.autopilot]

    def stop_setpoints(self) -> None:
        """Send no setpoint of a stream any more."""
        self._stream.stop()

    # -- modes ----------------------------------------------------------------------------------------

    @property
    def _ours(self) -> bool:
        """Whether the mode is one that this program led to; of a vehicle at rest it does not matter."""
        if not self.state.armed:
            return True
        profile = self.profile
        return self.state.mode in (profile.guided, *profile.own, *self._commanded)

    def _begin(self, what: str) -> None:
        """A new motion ends the setpoints. Raises DeviceError when the vehicle is not ours to move."""
        self._check_link()
        self._check_identity()
        if not self._ours:
            raise self.error(
                f"{what} refused: the vehicle is in {self.state.mode}, which this program did not choose; "
                "a pilot or a failsafe has it. release() takes it back"
            )
        self._stream.stop()

    async def _set_mode(self, name: str) -> None:
        # Noted before it is known to have worked: a safe state that is tried again must count as ours, and so
        # must the mode that it is still in when the new one is refused.
        self._commanded |= {name}
        set_mode, values = dialect.MAV_CMD_DO_SET_MODE, self._mode_values(name)
        await self._achieve(f"mode {name}", lambda: self.state.mode == name, set_mode, *values)
        self._commanded = frozenset({name})

    def _mode_values(self, name: str) -> tuple[float, ...]:
        """The parameters of DO_SET_MODE for a mode that there is."""
        values = self.profile.mode_values(name)
        assert values is not None, "the names are those of the table, or have been looked up in it"
        return (float(dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), *values)

    # -- motions --------------------------------------------------------------------------------------

    @property
    def _tolerance(self) -> float:
        tolerance: float = self.binding.option("tolerance")
        return tolerance

    async def _start(self, what: str, order: Order, taken: Callable[[], bool] = lambda: False) -> None:
        """Begin an order: parameters, mode, command, and the mode it leads to."""
        for name, value in order.parameters.items():
            await self._parameters.write(name, value)
        if order.mode and self.state.mode != order.mode:
            await self._set_mode(order.mode)
        self._commanded = order.modes
        if order.command is not None:
            await self._command(
                what, order.command.number, *order.command.values, place=order.command.place, taken=taken
            )
        await self._until(lambda: self.state.mode in order.modes, SHOWS, what)

    async def _travel(
        self, what: str, order: Order, distance: Callable[[Vector], float], near: float
    ) -> None:
        """Wait until `distance` of the position is at most `near`, as long as it gets less."""
        start = self.clock.monotonic()
        best, best_at, sent_at = math.inf, start, -math.inf
        while True:
            now = self.clock.monotonic()
            self._check_link()
            place = self.state.position
            left = distance(place) if place is not None else math.inf
            if left <= near:
                return
            self._check_underway(what, order.modes, start)
            if left < best - CLOSER:
                best, best_at = left, now
            if now - best_at > STUCK:
                await self._give_up(order)
                raise self.error(f"{what} gave up: no progress for {STUCK:g} s, {left:.1f} m from its goal")
            if order.target is not None and place is not None and now - sent_at >= order.period:
                self._send(self._setpoint(order.target(place)))
                sent_at = now
            await self._next_news(min(0.25, order.period))

    async def _give_up(self, order: Order) -> None:
        """Have the autopilot give up too, or the goal would be followed on when what is in its way has gone.

        A landing or a return goes on: there is nothing safer to do instead.
        """
        if order.command is not None or order.target is not None:
            with suppress(DeviceError):
                await self._set_mode(self.profile.hold)

    def _check_underway(self, what: str, modes: frozenset[str], start: float) -> None:
        """Raise when somebody else has taken over, or the motors are off."""
        if self.state.armed and self.state.mode in modes:
            return
        why = "the motors are off" if not self.state.armed else f"the vehicle went to {self.state.mode}"
        raise self.error(f"{what} ended early: {why}{self._reasons(start)}")

    def _check_goal(self, what: str, goal: Vector) -> None:
        """Refuse a goal that is no place, or outside the limits of the binding."""
        north, east, down = goal
        if not all(map(math.isfinite, goal)):
            raise self.error(f"{what} needs finite numbers")
        ceiling = self.binding.limits.get("altitude", math.inf)
        if -down > ceiling:
            raise self.error(f"{what} refused: {-down:g} m is above the limit of {ceiling:g} m")
        radius, far = self.binding.limits.get("radius", math.inf), math.hypot(north, east)
        if far > radius:
            raise self.error(f"{what} refused: {far:.1f} m from home is beyond the limit of {radius:g} m")

    def _setpoint(self, target: Target) -> Any:
        """The message of a setpoint, in the autopilot's local frame."""
        place = (g + h for g, h in zip(target.place, self.state.home_offset, strict=True))
        frame, acceleration = dialect.MAV_FRAME_LOCAL_NED, (0.0, 0.0, 0.0)
        return dialect.MAVLink_set_position_target_local_ned_message(
            0,
            self.system,
            AUTOPILOT,
            frame,
            target.mask,
            *place,
            *target.velocity,
            *acceleration,
            0.0,
            target.yaw_rate,
        )
