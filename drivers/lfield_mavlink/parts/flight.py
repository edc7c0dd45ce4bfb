"""Modes, arming, takeoff, landing and safe states, each confirmed by the vehicle's state."""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress
from typing import Any

from lfield.driver import DeviceError
from lfield_mavlink import log_messages
from lfield_mavlink.contact.contact import LINK_LOST, STATE_TIMEOUT, Contact
from lfield_mavlink.geodesy import Vector
from lfield_mavlink.limits import Limits
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.parts.motion_control import Motion
from lfield_mavlink.parts.progress import FAR, ReturnProgress
from lfield_mavlink.parts.readiness import COMPLAINTS, Readiness
from lfield_mavlink.parts.returns import Returns
from lfield_mavlink.parts.standstill import AT_HOME
from lfield_mavlink.services.parameters import Parameters
from lfield_mavlink.setpoints.motion_orders import Order, ProgressPatience

#: Seconds to wait for a heartbeat that is newer than a stop; they come at least every second.
HEARTBEAT_WAIT = 2.5
#: Seconds after a landing for the motors to be seen off: ArduPilot takes half a second, PX4 2 s unless its
#: parameter differs; below 0 they stay on.
MOTORS_OFF_TIMEOUT = 6.0
DELAY_OFF = "COM_DISARM_LAND"
#: For a landing, which may end below home, and for a return, which may hover above it for a while.
LANDING_PATIENCE = ProgressPatience(message="it has not descended for {seconds:g} s, and is not at rest")
RETURN_PATIENCE = ProgressPatience(60.0, message="it has not moved for {seconds:g} s, and is not at rest")
#: Modes that fly a part of the mission, in addition to the mission mode.
BY_MISSION = ("AUTO_RTL",)
#: Seconds after which ArduPilot has received our heartbeats, and between two attempts to arm until then.
STATION_TIMEOUT, ARM_RETRY_INTERVAL = 1.5, 0.1
#: ArduPilot's reason until then.
STATION_FAILSAFE = "GCS failsafe on"
#: Requests for the home position after arming.
HOME_REQUESTS = 5
#: Seconds for which an arming may be pending after it was last sent.
ARMING_PENDING = 10.0


class Flight:
    """Instructions that bring a vehicle into the air and down, and the handover to others."""

    def __init__(
        self,
        vehicle: Contact,
        motion: Motion,
        limits: Limits,
        readiness: Readiness,
        parameters: Parameters,
        returns: Returns,
    ) -> None:
        self._vehicle, self._state, self._motion = vehicle, vehicle.state, motion
        self._limits, self._readiness, self._parameters = limits, readiness, parameters
        self._returns = returns
        self._arming_until = self._home_at = -math.inf
        vehicle.on(dialect.MAVLINK_MSG_ID_HOME_POSITION, self._on_home)
        # The mode in which the vehicle was last left under foreign control, '' for none.
        self._foreign_mode = ""

    # -- instructions ---------------------------------------------------------------------------------

    async def do_arm(self) -> None:
        """Arms, in a mode that permits it, after a check of its settings."""
        vehicle = self._vehicle
        self._motion.start_motion("arm")
        if self._state.armed:
            return
        await self._motion.monitor.settle()
        self._motion.monitor.check_start("arm")
        vehicle.check_station("arm")
        await vehicle.check_alone()
        await vehicle.check_settings()
        if self._state.mode != vehicle.profile.arming:
            await self._motion.set_mode(vehicle.profile.arming)
        try:
            await self._arm()
        finally:
            self.may_be_arming()
        await self._await_home()

    async def _arm(self) -> None:
        """Arms; repeats until ArduPilot has received our heartbeats. Raises DeviceError with the reason.

        Its ground station failsafe is also active while disarmed, and ends up to 0.35 s after a heartbeat.
        Until then it refuses.
        """
        vehicle, start = self._vehicle, self._vehicle.clock.monotonic()
        await vehicle.wait_for(lambda: not self._state.critical, STATION_TIMEOUT)
        while True:
            now = vehicle.clock.monotonic()
            try:
                return await vehicle.achieve(
                    "arm", lambda: self._state.armed, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0
                )
            except DeviceError as refusal:
                if STATION_FAILSAFE not in refusal.reason or now - start > STATION_TIMEOUT:
                    raise await self._reasoned(refusal) from None
            await asyncio.sleep(ARM_RETRY_INTERVAL)

    async def _reasoned(self, refusal: DeviceError) -> DeviceError:
        """A refusal to arm, with a reason: PX4 gives none for some."""
        is_complaint = any(complaint in refusal.reason for complaint in COMPLAINTS)
        if is_complaint or refusal.kind == "DeviceTimeoutException":
            return refusal
        reason = await self._readiness.do_why_not_ready()
        return self._vehicle.error(f"{refusal.reason}, {reason}") if reason else refusal

    async def do_foreign_control(self) -> str:
        """The controller that has replaced this program, '' for none."""
        return self._motion.foreign_control

    async def _await_home(self) -> None:
        """Requests home again, which moves to where the vehicle is armed: the message may have been lost."""
        vehicle, since = self._vehicle, self._vehicle.clock.monotonic()
        home = float(dialect.MAVLINK_MSG_ID_HOME_POSITION)
        for _ in range(HOME_REQUESTS):
            answer = await vehicle.exchange.command(dialect.MAV_CMD_REQUEST_MESSAGE, home)
            if answer.result not in (None, dialect.MAV_RESULT_ACCEPTED):
                return
            if await vehicle.wait_for(lambda: self._home_at >= since, STATE_TIMEOUT / HOME_REQUESTS):
                return

    def _on_home(self, _: Any) -> None:
        self._home_at = self._vehicle.clock.monotonic()

    async def do_disarm(self) -> None:
        """Switches the motors off."""
        self._motion.start_motion("disarm")
        if self._vehicle.heartbeat_age > HEARTBEAT_WAIT and await self._disarmed():
            return
        await self._vehicle.achieve(
            "disarm", lambda: not self._state.armed, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0
        )

    async def do_takeoff(self, height: float) -> None:
        """Climbs to `height` above home."""
        state = self._state
        if not self._vehicle.profile.flies:
            raise self._vehicle.error(f"takeoff refused: a {state.kind} does not fly")
        self._limits.check_goal("takeoff", (0.0, 0.0, -height))
        if height <= 0.0:
            raise self._vehicle.error(f"takeoff requires a height above 0, not {height:g}")
        self._motion.start_motion("takeoff")
        if not state.armed:
            # PX4 would accept the takeoff, and fly when it is armed later.
            raise self._vehicle.error("takeoff refused: the motors are off; call arm() first")
        was_landed = state.landed

        def is_climbing() -> bool:
            return bool(was_landed) and not state.landed

        if self._vehicle.profile.px4 and (state.home is None or state.position is None):
            raise self._vehicle.error("takeoff: its position or its home is unknown")
        order = self._motion.orders.take_off(state, height)
        await self._motion.start("takeoff", order, is_accepted=is_climbing)
        tolerance = min(self._motion.tolerance, 0.1 * height)
        await self._motion.travel("takeoff", order, lambda place: abs(height + place[2]), tolerance)

    async def do_land(self) -> None:
        """Lands at the present position."""
        mode = await self._enter_safe_mode("land", "land", dialect.MAV_CMD_NAV_LAND)

        def height(place: Vector) -> float:
            return 0.0 if self._is_down else FAR - place[2]

        await self._motion.travel("land", Order(frozenset({mode})), height, 0.0, LANDING_PATIENCE)
        await self._await_motors_off("land")

    async def do_return_home(self) -> None:
        """Returns to home or a nearer rally point; done at rest there, after a landing if possible."""
        self._motion.check_bounded("returnHome", self._vehicle.profile.home)
        await self._returns.check("returnHome")
        is_copter = self._vehicle.profile.kind == "copter"
        ends = [] if is_copter else await self._returns.ends()
        mode = await self._enter_safe_mode("returnHome", "return", dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH)
        if is_copter:
            progress = ReturnProgress()
            await self._motion.travel(
                "returnHome",
                Order(frozenset({mode})),
                lambda place: 0.0 if self._is_down else progress.remaining(place),
                0.0,
                RETURN_PATIENCE,
            )
            await self._await_motors_off("returnHome")
            return
        arrival = await self._motion.arrival()
        if self._vehicle.profile.px4:
            # PX4 would return at its own, faster speed. A vehicle that refuses a speed still returns.
            with suppress(DeviceError):
                await self._motion.speed.apply_target()

        def remaining(place: Vector) -> float:
            distance = min(math.dist(place[:2], end[:2]) for end in ends)
            # PX4 switches off a rover that has returned.
            return 0.0 if not self._state.armed and distance <= AT_HOME else arrival.remaining(distance)

        motion, order = self._motion, Order(frozenset({mode}))
        await motion.travel("returnHome", order, remaining, motion.tolerance, motion.patience)

    async def do_hold(self) -> None:
        """Stops and holds the position."""
        self._motion.start_motion("hold")
        await self._motion.hold()

    async def do_set_mode(self, name: str) -> None:
        """Enters a mode by the autopilot's name; not a mission mode, whose mission must be checked."""
        mode, profile = name.upper(), self._vehicle.profile
        if profile.mode_values(mode) is None:
            names = ", ".join(sorted(profile.modes.values()))
            raise self._vehicle.error(f"{profile.stack} has no mode '{name}'; it has {names}")
        if mode in (profile.mission, *BY_MISSION):
            raise self._vehicle.error(
                f"setMode refused: {mode} would fly the vehicle's mission without a check of the limits; "
                "call startMission()"
            )
        self._motion.check_bounded(f"setMode to {mode}", mode)
        if mode == profile.home:
            await self._returns.check("setMode")
        self._motion.start_motion(f"mode {mode}")
        await self._motion.set_mode(mode)

    # -- the safe state -------------------------------------------------------------------------------

    def may_be_arming(self) -> None:
        """Records that a command to arm was sent, which may take effect although it is no longer awaited."""
        self._arming_until = self._vehicle.clock.monotonic() + ARMING_PENDING

    async def make_safe(self, state: str) -> None:
        """Enters a safe state of the manifest, unless the vehicle is at rest or under foreign control.

        The decision requires up-to-date messages. Raises DeviceError.
        """
        vehicle = self._vehicle
        self._motion.stream.stop()
        if self._state.heartbeat_at is not None and vehicle.silence <= LINK_LOST:
            if self._is_not_to_be_moved:
                await self._refresh_state()
            if not self._state.armed:
                return
            if not self._motion.is_ours:
                self._leave_alone()
                return
            if self._state.landed and vehicle.profile.flies and await self._disarmed():
                return
        self._foreign_mode = ""
        await self._motion.set_mode(self._motion.monitor.safe_mode(state))

    @property
    def _is_not_to_be_moved(self) -> bool:
        """Whether no action is needed, as far as known: motors off, or foreign control."""
        return not (self._state.armed and self._motion.is_ours)

    async def _refresh_state(self) -> None:
        """Waits for new messages, after cancelling an arming that may be pending. Raises DeviceError."""
        vehicle = self._vehicle
        if not self._state.armed and vehicle.clock.monotonic() < self._arming_until:
            answer = await vehicle.exchange.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
            if answer.result is None:
                raise vehicle.error("it may be arming, and does not answer a disarm command", timeout=True)
        # An answer may belong to the arming: later messages show its result.
        since = vehicle.clock.monotonic()
        if await vehicle.wait_for(lambda: (self._state.heartbeat_at or 0.0) > since, HEARTBEAT_WAIT):
            return
        # A silent vehicle does not answer a disarm command either.
        if self._state.armed or vehicle.silence >= HEARTBEAT_WAIT or not await self._disarmed():
            raise vehicle.error(f"no heartbeat for {vehicle.heartbeat_age:.1f} s", timeout=True)

    def _leave_alone(self) -> None:
        """Leaves the control to a pilot or the autopilot's own failsafe: taking over would be less safe."""
        if self._foreign_mode != self._state.mode:
            self._foreign_mode = self._state.mode
            holder = self._motion.failsafe.holder.rstrip(",")
            self._vehicle.note(log_messages.LEFT_ALONE.line(mode=self._state.mode, holder=holder))

    async def _disarmed(self) -> bool:
        """Tries to switch the motors off; the autopilot refuses in the air.

        Without heartbeats its answer is the only evidence: in all recordings the motor bit in SYS_STATUS is
        independent of the motors.
        """
        vehicle = self._vehicle
        answer = await vehicle.exchange.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
        if answer.result != dialect.MAV_RESULT_ACCEPTED:
            return False
        if vehicle.heartbeat_age > HEARTBEAT_WAIT and self._state.landed:
            vehicle.publish(**self._state.on_switched_off(vehicle.clock.monotonic()))
            return True
        return await self._vehicle.wait_for(lambda: not self._state.armed, STATE_TIMEOUT)

    # -- steps ----------------------------------------------------------------------------------------

    @property
    def _is_down(self) -> bool:
        """Whether the vehicle is on the ground, or cannot move by itself."""
        return bool(self._state.landed) or not self._state.armed

    async def _await_motors_off(self, action: str) -> None:
        """Waits until the autopilot has switched the motors off after a landing, or switches them off.

        Otherwise a later arm() would find them on and lose them afterwards. A PX4 that is configured to keep
        them on does so. Raises DeviceError, also when the landing was a crash.
        """
        vehicle = self._vehicle
        await self._motion.monitor.check_landed(action)
        if not vehicle.profile.flies or await vehicle.wait_for(
            lambda: not self._state.armed, MOTORS_OFF_TIMEOUT
        ):
            return
        delay = await self._parameters.read(DELAY_OFF) if vehicle.profile.px4 else None
        if (delay is None or delay >= 0.0) and self._state.landed and self._motion.is_ours:
            vehicle.note(log_messages.MOTORS_ON.line(seconds=MOTORS_OFF_TIMEOUT))
            await self.do_disarm()

    async def _enter_safe_mode(self, action: str, safe_state: str, command: int) -> str:
        """Enters the mode of a safe state by its command, such as NAV_LAND; returns the mode.

        A vehicle that does not fly lacks these commands, or executes them as in the air: there the mode is
        set.
        """
        self._motion.start_motion(action)
        mode = self._vehicle.profile.safe(safe_state)
        if not self._vehicle.profile.flies:
            await self._motion.set_mode(mode)
            return mode
        await self._motion.enter(action, mode, command, is_done=lambda: self._is_down)
        return mode
