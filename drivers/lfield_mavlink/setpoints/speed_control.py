"""Horizontal speed of one vehicle's motions: target, commanded and actual."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from lfield.driver import DeviceError
from lfield_mavlink import log_messages
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.geodesy import Vector
from lfield_mavlink.limits import ROUNDED_SPEED
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.services.parameters import Parameters
from lfield_mavlink.setpoints.setpoint_stream import SetpointStream
from lfield_mavlink.setpoints.speed_correction import ROVER_BY_ITSELF, SpeedCorrection
from lfield_mavlink.setpoints.trajectory import ONLY_POSITION, Target

#: Setpoints to stay before a speed is commanded, and the seconds after each: one must arrive on a bad link,
#: and start ArduPilot's position controller.
STAY_REPEATS, STAY_INTERVAL = 3, 0.1
#: The parameter of PX4's own speed to a goal, by kind of vehicle, and m/s if it is unknown.
CRUISE, CRUISES = {"copter": "MPC_XY_CRUISE", "rover": "RO_SPEED_LIM"}, 3.0
#: Relative difference of consecutive velocities up to which the actual speed still corrects the commanded
#: one.
SAME = 0.1
#: ArduRover's own speed, which it keeps within 3 % (2.05 of 2, ap-rover.c-speed); the share by which it may
#: be below a target.
ROVER_SPEED, OWN = "WP_SPEED", 0.05


class SpeedControl:
    """The speed of one vehicle: its binding's limit, or that of setSpeed()."""

    def __init__(self, vehicle: Contact, stream: SetpointStream, parameters: Parameters) -> None:
        self._vehicle, self._state = vehicle, vehicle.state
        self._stream, self._parameters = stream, parameters
        # The last speed of setSpeed(); the autopilot forgets it with every change of mode.
        self._requested: float | None = None
        # The speed of this motion if it differs from the target, and how often it was reduced.
        self._motion_speed: float | None = None
        self._slowed = 0
        # Whether ArduPilot's position controller is running, which keeps the commanded speed.
        self._is_steady = False
        self._correction = SpeedCorrection()
        self._corrections: asyncio.Queue[float] = asyncio.Queue()
        # The last velocity of a rover, its time, and its correction.
        self._velocity: tuple[float, float] = (0.0, 0.0)
        self._velocity_at, self._velocity_correction = -math.inf, SpeedCorrection()
        vehicle.on(dialect.MAVLINK_MSG_ID_HEARTBEAT, self._on_heartbeat)
        vehicle.on(dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, self._on_position)

    # -- target ---------------------------------------------------------------------------------------

    @property
    def target(self) -> float | None:
        """The last requested speed, else the limit of the binding, else the autopilot's own."""
        return self._requested or self._vehicle.binding.limits.get("speed")

    @property
    def motion_speed(self) -> float | None:
        """The speed of this motion, if known."""
        return self._motion_speed or self.target

    async def goal_speed(self) -> float | None:
        """The speed to a goal: PX4's own parameter without a target. Raises DeviceError."""
        profile = self._vehicle.profile
        if self.target is not None or not profile.px4 or profile.kind not in CRUISE:
            return self.target
        own_speed = await self._parameters.read(CRUISE[profile.kind])
        return own_speed if own_speed is not None and 0.0 < own_speed < math.inf else CRUISES

    # -- motions --------------------------------------------------------------------------------------

    def on_motion_started(self) -> None:
        """Sets the target speed for a new motion."""
        self._slowed, self._motion_speed = 0, None

    def on_command_started(self) -> None:
        """Records a command that moves the vehicle: ArduPilot's position controller ends."""
        self._is_steady = False

    def on_sent(self, target: Target) -> None:
        """Records a setpoint: ArduPilot's position controller continues with positions only."""
        self._is_steady = self._is_steady and target.mask == ONLY_POSITION

    async def fly_at(self, speed: float | None, send: Callable[[Target], None]) -> None:
        """Sets the speed of this motion, for ArduPilot after its start. Raises DeviceError.

        ArduPilot's position controller starts at the present position with its own speed before the target is
        commanded, so the vehicle never flies faster even if the answer is slow. While the controller runs, it
        keeps the commanded speed.
        """
        self._motion_speed = speed
        if speed is None or self._stream.trajectory is not None:
            return
        for _ in range(0 if self._is_steady else STAY_REPEATS):
            place = self._state.position
            assert place is not None, "the caller has checked it"
            send(Target(ONLY_POSITION, place))
            await asyncio.sleep(STAY_INTERVAL)
        self._correction = SpeedCorrection.for_profile(self._vehicle.profile)
        await self._change(speed)
        self._is_steady = True

    def corrected_velocity(self, velocity: Vector) -> Vector:
        """The commanded velocity for a rover, which would overshoot."""
        vehicle, speed, now = self._vehicle, math.hypot(*velocity[:2]), self._vehicle.clock.monotonic()
        if vehicle.profile.kind != "rover" or speed == 0.0:
            return velocity
        has_changed = abs(speed - math.hypot(*self._velocity)) > SAME * speed
        if has_changed or now - self._velocity_at > vehicle.binding.ttl:
            self._velocity_correction = SpeedCorrection.for_profile(vehicle.profile)
        self._velocity, self._velocity_at = velocity[:2], now
        share = self._velocity_correction.commanded(speed) / speed
        return velocity[0] * share, velocity[1] * share, velocity[2]

    async def set(self, speed: float) -> None:
        """Sets the horizontal speed of this and following motions. Raises DeviceError."""
        if self._keeps_commanded_speed:
            self._correction.reset()
            await self._change(speed)
            self._motion_speed = speed
        self._requested = speed

    async def apply_target(self) -> None:
        """Commands the target speed for autonomous motions. Raises DeviceError."""
        profile, target = self._vehicle.profile, self.target
        if target is None:
            return
        self._correction = SpeedCorrection.for_profile(profile) if profile.px4 else SpeedCorrection()
        if profile.kind == "rover" and not profile.px4:
            # A rover accelerates after each turn of its mission: a correction would cause it to overshoot
            # again.
            self._correction = SpeedCorrection(ROVER_BY_ITSELF)
            if await self._is_own(target):
                return
        await self._change(target)

    async def _is_own(self, speed: float) -> bool:
        """Whether ArduRover has this speed by its own parameter, without overshoot."""
        own_speed = await self._parameters.read(ROVER_SPEED)
        return own_speed is not None and speed * (1.0 - OWN) <= own_speed <= speed * (1.0 + ROUNDED_SPEED)

    @property
    def _keeps_commanded_speed(self) -> bool:
        """Whether a commanded speed is kept: ArduPilot needs a running motion.

        Without a motion, a rover refuses the speed, and a copter forgets it.
        """
        follows_trajectory = self._stream.trajectory is not None
        return follows_trajectory or self._is_steady or self._state.mode == self._vehicle.profile.mission

    # -- limits ---------------------------------------------------------------------------------------

    @property
    def can_slow_down(self) -> bool:
        """Whether a lower speed can be commanded: velocity setpoints contain their speed."""
        return self._stream.trajectory is not None or self._is_steady or not self._in_guided

    async def slow_down(self, speed: float) -> None:
        """Reduces the speed of this motion. Raises DeviceError."""
        self._slowed += 1
        self._correction.reset()
        await self._change(speed)

    @property
    def speed_to_restore(self) -> float | None:
        """The speed to restore after a reduction, once per motion; else None."""
        return self.motion_speed if self._slowed == 1 else None

    async def speed_up(self, speed: float) -> None:
        """Restores a speed after a reduction. Raises DeviceError."""
        await self._change(speed)

    @property
    def was_slowed(self) -> bool:
        """Whether the speed of this motion was reduced."""
        return self._slowed > 0

    def forget_slowing(self) -> None:
        """Discards a reduction: the autopilot has forgotten the speed with its mode."""
        self._slowed = 0

    # -- actual speed ---------------------------------------------------------------------------------

    async def run(self) -> None:
        """Corrects the commanded speed by the actual one, until cancelled."""
        while True:
            speed = await self._corrections.get()
            if not self._is_corrected:
                continue
            try:
                await self._change(speed)
            except DeviceError as error:
                self._vehicle.note(log_messages.SPEED_NOT_CORRECTED.line(reason=error.reason))

    @property
    def _is_corrected(self) -> bool:
        """Whether the actual speed depends on the commanded one, and may correct it."""
        is_moving = self._is_steady and self._in_guided and self._state.armed
        return is_moving and not self._vehicle.is_quiet and not self._slowed

    def _on_position(self, _: object) -> None:
        speed, now = self.motion_speed, self._vehicle.clock.monotonic()
        if now - self._velocity_at <= self._vehicle.binding.ttl:
            self._correct_velocity(now)
        if speed is None or not self._is_corrected:
            self._correction.pause()
            return
        north, east, _down = self._state.velocity
        has_changed = self._correction.sample(math.hypot(north, east), speed, now)
        if has_changed and self._corrections.empty():
            self._corrections.put_nowait(speed)

    def _correct_velocity(self, now: float) -> None:
        """Corrects the commanded velocity by the actual speed along it."""
        speed = math.hypot(*self._velocity)
        self._velocity_correction.follow(self._state.velocity, self._velocity, speed, now)

    def _on_heartbeat(self, _: object) -> None:
        """Handles another mode or motors off, with which the autopilot forgets the speed."""
        if self._state.profile is not None and not (self._state.armed and self._in_guided):
            self._is_steady = False

    @property
    def _in_guided(self) -> bool:
        return self._state.mode == self._vehicle.profile.guided

    async def _change(self, speed: float) -> None:
        if (trajectory := self._stream.trajectory) is not None:
            trajectory.speed = speed
            return
        commanded = self._correction.commanded(speed)
        await self._vehicle.command("speed", dialect.MAV_CMD_DO_CHANGE_SPEED, 1.0, commanded, -1.0)
