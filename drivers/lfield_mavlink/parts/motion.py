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
from lfield_mavlink.limits import BRAKES
from lfield_mavlink.link.dialect import AUTOPILOT, dialect
from lfield_mavlink.parts.failsafe import Failsafe
from lfield_mavlink.parts.fences import OwnFence
from lfield_mavlink.parts.orders import ONLY_POSITION, ORDERS, Order, Patience, Stack, Target
from lfield_mavlink.parts.progress import Arrival, Progress
from lfield_mavlink.services.parameters import Parameters

#: Seconds between two setpoints of a stream; PX4 wants more than 2 per second.
PERIOD = 0.05
#: How often a vehicle is told to stay before it is told its speed, and the seconds after each: enough that
#: one arrives on a bad link, and that ArduPilot's control of a position has begun.
STAYS, BEGINS = 3, 0.1
#: Of what flies to a goal, and of what drives there.
ON_ITS_WAY, DRIVES = Patience(), Patience(turning=40.0, detour=30.0)
#: m/s above which it moves, unless it is told a low speed: then the share of that, and what is always noise.
MOVES, SHARE, NOISE = 0.3, 0.5, 0.05
#: The seconds after which one that does not move is asked why.
ASKED_WHY = 2.0


def stopping_place(place: Vector, velocity: Vector) -> Vector:
    """Where it comes to rest when it brakes now: behind that, what steers like a car would drive a loop."""
    way = math.hypot(*velocity[:2]) / (2.0 * BRAKES)
    return place[0] + velocity[0] * way, place[1] + velocity[1] * way, place[2]


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
        self.fence, self.failsafe = OwnFence(vehicle, parameters), Failsafe(vehicle)
        self.stream = SetpointStream(vehicle.clock, vehicle.send)
        self.tolerance: float = vehicle.binding.option("tolerance")
        # The modes that the last order leads to; any other mode is somebody else's doing.
        self._commanded: frozenset[str] = frozenset()
        # What setSpeed() asked for last; the autopilot forgets it with every change of mode.
        self._speed: float | None = None
        # Whether ArduPilot's control of a position is running, which keeps the speed that it is told.
        self._steady = False
        # Whether the last order sent PX4 to a goal, which it flies to in its mode for staying.
        self._has_goal = False
        # The speed of this motion, where it is not the wanted one, and how often it was told to be slower.
        self._pace: float | None = None
        self._slowed = 0
        # When the last motion was begun, and why it was stopped by this driver.
        self._began, self._stopped = -math.inf, ""
        vehicle.on(dialect.MAVLINK_MSG_ID_HEARTBEAT, self._on_heartbeat)

    @property
    def orders(self) -> Stack:
        """What this autopilot must be sent for a motion."""
        return ORDERS[self._vehicle.profile.autopilot]

    # -- modes ----------------------------------------------------------------------------------------

    @property
    def ours(self) -> bool:
        """Whether this program led to the mode, not a failsafe; of a vehicle at rest it does not matter."""
        if self.failsafe.has_it or not self._state.armed:
            return not self._state.armed
        profile = self._vehicle.profile
        return self._state.mode in (profile.guided, *profile.own, *self._commanded)

    def claim(self, *modes: str) -> None:
        """These modes are what this program led to, and no others."""
        self._commanded = frozenset(modes)

    def release(self) -> None:
        """Whatever mode it is in, and whoever chose it, is this program's from now on."""
        self.failsafe.release()
        self.claim(self._state.mode)

    def begin(self, what: str) -> None:
        """A new motion ends the setpoints. Raises DeviceError when the vehicle is not ours to move."""
        self._vehicle.check_link()
        self._vehicle.check_identity()
        if not self.ours:
            raise self._vehicle.error(
                f"{what} refused: the vehicle is in {self._state.mode}, which this program did not "
                f"choose; {self.failsafe.holding}. release() takes it back"
            )
        self._began, self._stopped = self._vehicle.clock.monotonic(), ""
        self._slowed, self._pace = 0, None
        self.stream.stop()

    async def halt(self, why: str) -> None:
        """Hold, whatever is under way; the motion that this ends says why. Raises DeviceError."""
        self._stopped = why
        self.stream.stop()
        await self.hold()

    async def hold(self) -> None:
        """Into the mode for staying where it is, and stay there. Raises DeviceError."""
        await self.set_mode(self._vehicle.profile.hold)

    async def set_mode(self, name: str) -> None:
        """Any mode that the vehicle has; the one for staying stops it. Raises DeviceError."""
        self._slowed = 0
        if name != self._vehicle.profile.hold or not await self._stays():
            await self.enter(f"mode {name}", name, dialect.MAV_CMD_DO_SET_MODE, *self.mode_values(name))

    async def _stays(self) -> bool:
        """Send PX4 to where it can stop, if it may be flying a goal; whether it was, and took that.

        It does so in the very mode for staying, and goes on to its goal when the mode is asked for again.
        """
        profile, state, place = self._vehicle.profile, self._state, self._state.position
        # A goal that was sent a moment ago may not show in the mode yet.
        goes = state.armed and (state.mode == profile.hold or self._has_goal)
        if not (profile.px4 and goes) or place is None or state.home is None:
            return False
        try:
            order = self.orders.go_to(state, stopping_place(place, state.velocity), self.wanted_speed)
            await self.start("hold", order)
        except DeviceError:
            return False
        return True

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
        """Enter a mode by a command that leads to it, or see that it is `done`. Raises DeviceError."""
        # Noted before it is known to have worked: a safe state that is tried again must count as ours, and so
        # must the mode that it is still in when the new one is refused.
        self._commanded |= {mode}
        fed = self._state.mode == "OFFBOARD"
        await self._vehicle.achieve(
            what, lambda: self._state.mode == mode or done(), command, *values, mode=mode
        )
        if fed:
            await self.failsafe.did_the_same(what, command, *values)
        self._has_goal = False
        self.claim(mode)

    # -- motions --------------------------------------------------------------------------------------

    async def start(self, what: str, order: Order, taken: Callable[[], bool] | None = None) -> None:
        """Begin an order: mode, command, the mode it leads to, and its speed. Raises DeviceError."""
        if order.mode and self._state.mode != order.mode:
            await self.set_mode(order.mode)
        # As in `enter`: until the new order is seen, the mode it is still in is ours too.
        self._commanded |= order.modes
        self._has_goal = order.modes == {self._vehicle.profile.hold}
        if (command := order.command) is not None:
            self._steady = False
            await self._vehicle.command(
                what, command.number, *command.values, place=command.place, taken=taken
            )
        await self._vehicle.until(lambda: self._state.mode in order.modes, SHOWS, what)
        self.claim(*order.modes)
        self._pace = order.speed
        if order.speed is not None and order.command is None:
            await self._keep_pace(order.speed)

    async def travel(
        self,
        what: str,
        order: Order,
        distance: Callable[[Vector], float],
        near: float,
        patience: Patience = ON_ITS_WAY,
    ) -> None:
        """Wait until `distance` of the position is at most `near`, as long as it gets less.

        Raises DeviceError.
        """
        vehicle = self._vehicle
        start = vehicle.clock.monotonic()
        progress, sent_at, asked = Progress(patience, start, self._state.position), -math.inf, False
        while True:
            now = vehicle.clock.monotonic()
            vehicle.check_link()
            place = self._state.position
            left = distance(place) if place is not None else math.inf
            if left <= near:
                return
            await self._check_underway(what, order, start)
            if progress.is_over(left, self.moves, now, self._told, place):
                await self._give_up(order)
                seconds = patience.bound(self.moves, self._told)
                words = patience.words.format(seconds=seconds, left=left, room=patience.room)
                fence = await self.fence.perhaps() if order.goal is not None else ""
                raise vehicle.error(f"{what} gave up: {words}{fence}")
            if not asked and self._is_refused(order, progress, now):
                asked = True
                await self._check_fence(what, order)
            if order.target is not None and place is not None and now - sent_at >= order.period:
                vehicle.send(self.setpoint(order.target(place)))
                sent_at = now
            await vehicle.next_news(min(0.25, order.period))

    @property
    def patience(self) -> Patience:
        """How long it may come no closer to a place."""
        return ON_ITS_WAY if self._vehicle.profile.flies else DRIVES

    @property
    def moves(self) -> bool:
        """Whether it moves over ground or up and down, as far as it tells."""
        least = MOVES if self._told is None else max(min(MOVES, SHARE * self._told), NOISE)
        return self._state.speeds is not None and math.hypot(*self._state.speeds) > least

    def _is_refused(self, order: Order, progress: Progress, now: float) -> bool:
        """Whether it looks as if the autopilot does not want to go there."""
        told = "geofence" in self._vehicle.reasons(self._began)
        return order.goal is not None and (told or progress.stood(now) > ASKED_WHY)

    async def _check_fence(self, what: str, order: Order) -> None:
        """Raise DeviceError when its own fence is why it does not move."""
        assert order.goal is not None, "the caller has looked"
        told = self._vehicle.reasons(self._began)
        why = await self.fence.why_beyond(order.goal)
        if why or "geofence" in told:
            await self._give_up(order)
            raise self._vehicle.error(f"{what} refused: {why or 'the goal is outside its own fence'}{told}")

    async def arrival(self) -> Arrival:
        """How what drives arrives: ArduPilot stops a rover within its WP_RADIUS of a goal."""
        profile, radius = self._vehicle.profile, 0.0
        if profile.kind == "rover" and not profile.px4:
            radius = await self._parameters.read("WP_RADIUS") or 0.0
        return Arrival(radius, lambda: self.moves, self._vehicle.clock.monotonic)

    def setpoint(self, target: Target) -> Any:
        """The message of a setpoint, in the autopilot's local frame."""
        self._steady = self._steady and target.mask == ONLY_POSITION
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
            target.yaw,
            target.yaw_rate,
        )

    async def _give_up(self, order: Order) -> None:
        """Have the autopilot give up too, or the goal would be followed on when what is in its way has gone.

        A landing or a return goes on: there is nothing safer to do instead.
        """
        if order.command is not None or order.target is not None:
            with suppress(DeviceError):
                await self.hold()

    async def _check_underway(self, what: str, order: Order, start: float) -> None:
        """Raise when somebody else has taken over, or the motors are off, with what is said of that.

        A landing or a return goes on when a failsafe wants the same.
        """
        if self._stopped:
            raise self._vehicle.error(f"{what} was stopped, since {self._stopped}")
        state = self._state
        taken = self.failsafe.has_it and (order.command is not None or order.target is not None)
        if state.armed and state.mode in order.modes and not taken:
            return
        await self.failsafe.explains()
        chosen = ", which its failsafe chose" if self.failsafe.has_it else ""
        why = f"the vehicle went to {state.mode}{chosen}" if state.armed else "the motors are off"
        raise self._vehicle.error(f"{what} ended early: {why}{self._vehicle.reasons(start)}")

    # -- speed ----------------------------------------------------------------------------------------

    @property
    def wanted_speed(self) -> float | None:
        """What was asked for last, else the limit of the binding, else the autopilot's own."""
        return self._speed or self._vehicle.binding.limits.get("speed")

    @property
    def _told(self) -> float | None:
        """The speed of this motion, where it has one that is known."""
        return self._pace or self.wanted_speed

    async def set_speed(self, speed: float) -> None:
        """The speed over ground for this motion and those that follow. Raises DeviceError."""
        if self._takes_speed:
            await self._change_speed(speed)
            self._pace = speed
        self._speed = speed

    async def keep_speed(self) -> None:
        """Have the autopilot keep the wanted speed in what it flies by itself. Raises DeviceError."""
        if self.wanted_speed is not None:
            await self._change_speed(self.wanted_speed)

    async def slow_down(self, speed: float, why: str) -> None:
        """Have it fly slower, or, where setpoints say how fast, hold. Raises DeviceError."""
        if self._in_guided and not self._steady:
            await self.halt(why)
        else:
            self._slowed += 1
            await self._change_speed(speed)

    @property
    def faster(self) -> float | None:
        """What it may be told again after it was told to be slower, once in a motion; else None."""
        return self._told if self._slowed == 1 else None

    async def speed_up(self, speed: float) -> None:
        """Tell it a speed again after it was told to be slower. Raises DeviceError."""
        await self._change_speed(speed)

    @property
    def was_slowed(self) -> bool:
        """Whether it was told to be slower in this motion already."""
        return self._slowed > 0

    @property
    def _takes_speed(self) -> bool:
        """Whether a speed that is told now is kept: ArduPilot needs something that it is kept for.

        A rover refuses it otherwise, and a copter forgets it.
        """
        return self._vehicle.profile.px4 or self._steady or self._state.mode == self._vehicle.profile.mission

    async def _keep_pace(self, speed: float) -> None:
        """Have control of a position begin where it is, with its own speed, and then tell it the wanted one.

        So it never flies faster, also when the answer takes its time. While it runs it keeps what it is told.
        """
        for _ in range(0 if self._steady else STAYS):
            place = self._state.position
            assert place is not None, "the caller has looked"
            self._vehicle.send(self.setpoint(Target(ONLY_POSITION, place)))
            await asyncio.sleep(BEGINS)
        await self._change_speed(speed)
        self._steady = True

    def _on_heartbeat(self, _: object) -> None:
        """In another mode, or with its motors off, it forgets its speed."""
        if self._state.profile is not None and not (self._state.armed and self._in_guided):
            self._steady = False

    @property
    def _in_guided(self) -> bool:
        return self._state.mode == self._vehicle.profile.guided

    async def _change_speed(self, speed: float) -> None:
        told = self.orders.told_speed(self._state, speed)
        await self._vehicle.command("speed", dialect.MAV_CMD_DO_CHANGE_SPEED, 1.0, told, -1.0)
