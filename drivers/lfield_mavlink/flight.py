"""Modes, arming, taking off, landing, and the safe states: each confirmed by the vehicle's state."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from lfield.errors import DeviceError
from lfield_mavlink.contact import LINK_LOST, SHOWS
from lfield_mavlink.dialect import AUTOPILOT, dialect
from lfield_mavlink.geo import Vector
from lfield_mavlink.orders import ORDERS, Order, Stack, Target
from lfield_mavlink.setpoints import SetpointStream
from lfield_mavlink.watchdog import Watchdog

#: Seconds without coming closer after which a flight has failed, and what counts as closer, in metres.
STUCK, CLOSER = 10.0, 0.1


class Flight(Watchdog):
    """What brings a vehicle into the air and down, and what keeps others' hands free."""

    def _set_up(self) -> None:
        super()._set_up()
        # The modes that the last order leads to; any other mode is somebody else's doing.
        self._commanded: frozenset[str] = frozenset()
        self._stream = SetpointStream(self.clock, self._send)

    @property
    def _orders(self) -> Stack:
        return ORDERS[self.profile.autopilot]

    # -- instructions ---------------------------------------------------------------------------------

    async def do_arm(self) -> None:
        """In a mode that may be armed in, then armed; its own watchdog is looked at before."""
        self._begin("arm")
        if self.state.armed:
            return
        await self._check_watchdog_holds()
        if self.state.mode != self.profile.arming:
            await self._set_mode(self.profile.arming)
        await self._achieve("arm", lambda: self.state.armed, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    async def do_disarm(self) -> None:
        """Motors off."""
        self._begin("disarm")
        await self._achieve("disarm", lambda: not self.state.armed, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)

    async def do_takeoff(self, height: float) -> None:
        """Up to `height` above home."""
        self._check_goal("takeoff", (0.0, 0.0, -height))
        if height <= 0.0:
            raise self.error(f"takeoff needs a height above 0, not {height:g}")
        self._begin("takeoff")
        stood = self.state.landed

        def climbing() -> bool:
            return bool(stood) and not self.state.landed

        order = self._orders.take_off(height)
        await self._start("takeoff", order, taken=climbing)
        near = min(self._tolerance, 0.1 * height)
        await self._travel("takeoff", order, lambda place: abs(height + place[2]), near)

    async def do_land(self) -> None:
        """Down to the ground, here."""
        self._begin("land")
        await self._leave_for("land", self.profile.land, dialect.MAV_CMD_NAV_LAND)

        def height(place: Vector) -> float:
            return 0.0 if self._down else max(-place[2], CLOSER) + 1.0

        await self._travel("land", Order(frozenset({self.profile.land})), height, 0.0)

    async def do_return_home(self) -> None:
        """Back to where home is; what flies and can land is done when it stands there."""
        self._begin("returnHome")
        home = self.profile.home
        await self._leave_for("returnHome", home, dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH)
        lands = self.profile.kind == "copter"
        way = _Way()

        def left(place: Vector) -> float:
            if lands:
                return 0.0 if self._down else way.left(place)
            return math.hypot(*place[:2])

        await self._travel("returnHome", Order(frozenset({home})), left, 0.0 if lands else self._tolerance)

    async def do_hold(self) -> None:
        """Stop and stay."""
        self._begin("hold")
        await self._set_mode(self.profile.hold)

    async def do_set_mode(self, name: str) -> None:
        """Any mode of the autopilot, by its own name for it."""
        wanted = name.upper()
        if self.profile.mode_values(wanted) is None:
            known = ", ".join(sorted(self.profile.modes.values()))
            raise self.error(f"{self.profile.stack} has no mode '{name}'; it has {known}")
        self._begin(f"mode {wanted}")
        await self._set_mode(wanted)

    async def do_release(self) -> None:
        """Whatever mode it is in, the program takes the vehicle back."""
        self._commanded = frozenset({self.state.mode})

    def stop_setpoints(self) -> None:
        """Send no setpoint of a stream any more."""
        self._stream.stop()

    # -- the safe state -------------------------------------------------------------------------------

    async def _make_safe(self, state: str) -> None:
        self._stream.stop()
        if self.state.heard is not None and self._silence() <= LINK_LOST:
            if not self.state.armed:
                return
            if not self._ours:
                # A pilot or the autopilot's own failsafe flies it: to take it from them would be less safe.
                self.note(f"in {self.state.mode}, by a pilot or a failsafe: left to them")
                return
            if self.state.landed and self.profile.flies and await self._disarmed():
                return
        await self._set_mode(self.profile.safe(state))

    async def _disarmed(self) -> bool:
        """Try to switch the motors off on the ground; the autopilot refuses if it is not there."""
        answer = await self._exchange.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
        if answer.result != dialect.MAV_RESULT_ACCEPTED:
            return False
        return await self._seen(lambda: not self.state.armed, SHOWS)

    # -- modes ----------------------------------------------------------------------------------------

    @property
    def _down(self) -> bool:
        """Whether it stands on the ground, or does not move by itself."""
        return bool(self.state.landed) or not self.state.armed

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
        # Noted before it is known to have worked: a safe state that is tried again must count as ours.
        self._commanded = frozenset({name})
        custom = float(dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        values = self.profile.mode_values(name)
        assert values is not None, "the names are those of the table, or have been looked up in it"
        set_mode = dialect.MAV_CMD_DO_SET_MODE
        await self._achieve(f"mode {name}", lambda: self.state.mode == name, set_mode, custom, *values)

    async def _leave_for(self, what: str, mode: str, command: int) -> None:
        """Enter the mode of a command that has one of its own, such as NAV_LAND."""
        self._commanded = frozenset({mode})
        await self._achieve(what, lambda: self.state.mode == mode or self._down, command)

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


class _Way:
    """The way back of a flight that may first climb, as a number that only falls while it gets on."""

    def __init__(self) -> None:
        self._moved = 0.0
        self._last: Vector | None = None

    def left(self, place: Vector) -> float:
        """Minus the metres flown so far: a return has a shape of its own, so any motion is progress."""
        if self._last is not None:
            self._moved += math.dist(place, self._last)
        self._last = place
        return 1e6 - self._moved
