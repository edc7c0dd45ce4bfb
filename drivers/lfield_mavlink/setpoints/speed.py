"""The speed of one vehicle's motions over ground: what is wanted, what is commanded, and what it flies."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from lfield.driver import DeviceError
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.geo import Vector
from lfield_mavlink.limits import ROUNDED_SPEED
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.services.parameters import Parameters
from lfield_mavlink.setpoints.correction import ROVER_BY_ITSELF, SpeedCorrection
from lfield_mavlink.setpoints.stream import SetpointStream
from lfield_mavlink.setpoints.trajectory import ONLY_POSITION, Target

#: How often a vehicle is told to stay before it is told its speed, and the seconds after each: enough that
#: one arrives on a bad link, and that ArduPilot's control of a position has begun.
STAYS, BEGINS = 3, 0.1
#: The parameter of PX4's own speed to a place, by the kind of vehicle, and m/s where it does not tell.
CRUISE, CRUISES = {"copter": "MPC_XY_CRUISE", "rover": "RO_SPEED_LIM"}, 3.0
#: The share by which the speed of one velocity may differ from that of the one before it, so that what was
#: driven still says something of it.
SAME = 0.1
#: ArduRover's own speed, which it keeps within 3 % (2.05 of 2, ap-rover.c-speed); the share by which it may
#: be less than a speed that is wanted.
ROVER_SPEED, OWN = "WP_SPEED", 0.05


class Speed:
    """The speed of one vehicle: its binding's limit, or what setSpeed() asked for."""

    def __init__(self, vehicle: Contact, stream: SetpointStream, parameters: Parameters) -> None:
        self._vehicle, self._state = vehicle, vehicle.state
        self._stream, self._parameters = stream, parameters
        # What setSpeed() asked for last; the autopilot forgets it with every change of mode.
        self._asked: float | None = None
        # The speed of this motion, where it is not the wanted one, and how often it was told to be slower.
        self._pace: float | None = None
        self._slowed = 0
        # Whether ArduPilot's control of a position is running, which keeps the speed that it is commanded.
        self._steady = False
        self._correction = SpeedCorrection()
        self._corrections: asyncio.Queue[float] = asyncio.Queue()
        # The velocity that a rover was set last, when, and what is commanded of it.
        self._velocity: tuple[float, float] = (0.0, 0.0)
        self._velocity_at, self._of_velocity = -math.inf, SpeedCorrection()
        vehicle.on(dialect.MAVLINK_MSG_ID_HEARTBEAT, self._on_heartbeat)
        vehicle.on(dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, self._on_position)

    # -- what is wanted -------------------------------------------------------------------------------

    @property
    def wanted(self) -> float | None:
        """What was asked for last, else the limit of the binding, else the autopilot's own."""
        return self._asked or self._vehicle.binding.limits.get("speed")

    @property
    def of_motion(self) -> float | None:
        """The speed of this motion, where it has one that is known."""
        return self._pace or self.wanted

    async def of_goal(self) -> float | None:
        """The speed to a goal: that of PX4's own parameter where nothing is wanted. Raises DeviceError."""
        profile = self._vehicle.profile
        if self.wanted is not None or not profile.px4 or profile.kind not in CRUISE:
            return self.wanted
        own = await self._parameters.read(CRUISE[profile.kind])
        return own if own is not None and 0.0 < own < math.inf else CRUISES

    # -- motions --------------------------------------------------------------------------------------

    def begin(self) -> None:
        """A new motion begins, at the speed that is wanted."""
        self._slowed, self._pace = 0, None

    def begin_command(self) -> None:
        """A command moves it: ArduPilot's control of a position ends."""
        self._steady = False

    def sent(self, target: Target) -> None:
        """A setpoint was sent: ArduPilot's control of a position goes on with positions alone."""
        self._steady = self._steady and target.mask == ONLY_POSITION

    async def fly_at(self, speed: float | None, send: Callable[[Target], None]) -> None:
        """The speed of this motion, of which ArduPilot is told when it has begun. Raises DeviceError.

        Its control of a position begins where it is, with its own speed, and then is told the wanted one: so
        it never flies faster, also when the answer takes its time. While it runs it keeps what it is told.
        """
        self._pace = speed
        if speed is None or self._stream.trajectory is not None:
            return
        for _ in range(0 if self._steady else STAYS):
            place = self._state.position
            assert place is not None, "the caller has looked"
            send(Target(ONLY_POSITION, place))
            await asyncio.sleep(BEGINS)
        self._correction = SpeedCorrection.of(self._vehicle.profile)
        await self._change(speed)
        self._steady = True

    def of_velocity(self, velocity: Vector) -> Vector:
        """What a rover is commanded for a velocity: it would shoot over it."""
        vehicle, speed, now = self._vehicle, math.hypot(*velocity[:2]), self._vehicle.clock.monotonic()
        if vehicle.profile.kind != "rover" or speed == 0.0:
            return velocity
        differs = abs(speed - math.hypot(*self._velocity)) > SAME * speed
        if differs or now - self._velocity_at > vehicle.binding.ttl:
            self._of_velocity = SpeedCorrection.of(vehicle.profile)
        self._velocity, self._velocity_at = velocity[:2], now
        share = self._of_velocity.commanded(speed) / speed
        return velocity[0] * share, velocity[1] * share, velocity[2]

    async def set(self, speed: float) -> None:
        """The speed over ground for this motion and those that follow. Raises DeviceError."""
        if self._takes_speed:
            self._correction.reset()
            await self._change(speed)
            self._pace = speed
        self._asked = speed

    async def keep_wanted(self) -> None:
        """Have the autopilot keep the wanted speed in what it flies by itself. Raises DeviceError."""
        profile, wanted = self._vehicle.profile, self.wanted
        if wanted is None:
            return
        self._correction = SpeedCorrection.of(profile) if profile.px4 else SpeedCorrection()
        if profile.kind == "rover" and not profile.px4:
            # It speeds up anew after each turn of its mission: a correction would have it shoot over again.
            self._correction = SpeedCorrection(ROVER_BY_ITSELF)
            if await self._is_own(wanted):
                return
        await self._change(wanted)

    async def _is_own(self, speed: float) -> bool:
        """Whether ArduRover drives at a speed by its own parameter, which it does not shoot over."""
        own = await self._parameters.read(ROVER_SPEED)
        return own is not None and speed * (1.0 - OWN) <= own <= speed * (1.0 + ROUNDED_SPEED)

    @property
    def _takes_speed(self) -> bool:
        """Whether a speed that is told now is kept: ArduPilot needs something that it is kept for.

        A rover refuses it otherwise, and a copter forgets it.
        """
        follows = self._stream.trajectory is not None
        return follows or self._steady or self._state.mode == self._vehicle.profile.mission

    # -- limits ---------------------------------------------------------------------------------------

    @property
    def can_slow_down(self) -> bool:
        """Whether a lower speed can be commanded: setpoints of a velocity say themselves how fast."""
        return self._stream.trajectory is not None or self._steady or not self._in_guided

    async def slow_down(self, speed: float) -> None:
        """Have it be slower in this motion. Raises DeviceError."""
        self._slowed += 1
        self._correction.reset()
        await self._change(speed)

    @property
    def faster(self) -> float | None:
        """What it may be told again after it was told to be slower, once in a motion; else None."""
        return self.of_motion if self._slowed == 1 else None

    async def speed_up(self, speed: float) -> None:
        """Command a speed again after it was told to be slower. Raises DeviceError."""
        await self._change(speed)

    @property
    def was_slowed(self) -> bool:
        """Whether it was told to be slower in this motion already."""
        return self._slowed > 0

    def forget_slowing(self) -> None:
        """What it was told is forgotten with its mode."""
        self._slowed = 0

    # -- what it flies --------------------------------------------------------------------------------

    async def keep(self) -> None:
        """Correct the commanded speed by what is flown, until cancelled."""
        while True:
            speed = await self._corrections.get()
            if not self._is_corrected:
                continue
            try:
                await self._change(speed)
            except DeviceError as error:
                self._vehicle.note(f"speed correction failed: {error.reason}")

    @property
    def _is_corrected(self) -> bool:
        """Whether what is flown says something of the commanded speed, and may correct it."""
        moves = self._steady and self._in_guided and self._state.armed
        return moves and not self._vehicle.quiet and not self._slowed

    def _on_position(self, _: object) -> None:
        speed, now = self.of_motion, self._vehicle.clock.monotonic()
        if now - self._velocity_at <= self._vehicle.binding.ttl:
            self._follows_velocity(now)
        if speed is None or not self._is_corrected:
            self._correction.pause()
            return
        north, east, _down = self._state.velocity
        changed = self._correction.sample(math.hypot(north, east), speed, now)
        if changed and self._corrections.empty():
            self._corrections.put_nowait(speed)

    def _follows_velocity(self, now: float) -> None:
        """Correct what is commanded of a velocity by what is driven along it."""
        speed = math.hypot(*self._velocity)
        self._of_velocity.follow(self._state.velocity, self._velocity, speed, now)

    def _on_heartbeat(self, _: object) -> None:
        """In another mode, or with its motors off, it forgets its speed."""
        if self._state.profile is not None and not (self._state.armed and self._in_guided):
            self._steady = False

    @property
    def _in_guided(self) -> bool:
        return self._state.mode == self._vehicle.profile.guided

    async def _change(self, speed: float) -> None:
        if (trajectory := self._stream.trajectory) is not None:
            trajectory.speed = speed
            return
        commanded = self._correction.commanded(speed)
        await self._vehicle.command("speed", dialect.MAV_CMD_DO_CHANGE_SPEED, 1.0, commanded, -1.0)
