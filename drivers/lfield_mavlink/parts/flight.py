"""Modes, arming, taking off, landing, and the safe states: each confirmed by the vehicle's state."""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress
from typing import Any

from lfield.driver import DeviceError
from lfield_mavlink.contact.contact import LINK_LOST, SHOWS, Contact
from lfield_mavlink.geo import Vector
from lfield_mavlink.limits import Limits
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.parts.motion import Motion
from lfield_mavlink.parts.progress import FAR, WayBack
from lfield_mavlink.parts.readiness import COMPLAINTS, Readiness
from lfield_mavlink.parts.rest import AT_HOME
from lfield_mavlink.parts.returns import Returns
from lfield_mavlink.services.parameters import Parameters
from lfield_mavlink.setpoints.orders import Order, Patience

#: Seconds for a heartbeat to come that is newer than a stop; one comes every second at least.
NEWS = 2.5
#: Seconds after a landing for the motors to go off, and to be seen off: ArduPilot takes half a second, PX4
#: 2 s, unless its parameter says another time; below 0 they stay on.
GOES_OFF = 6.0
DELAY_OFF = "COM_DISARM_LAND"
#: Of a landing, which may end below home, and of a return, which may hover for a while above it.
SINKS = Patience(words="it has come no lower for {seconds:g} s, and does not stand")
COMES_BACK = Patience(60.0, words="it has not moved for {seconds:g} s, and does not stand")
#: Modes that fly a part of the mission, beside the mode of missions.
BY_MISSION = ("AUTO_RTL",)
#: Seconds after which ArduPilot has noticed our heartbeats, and between two attempts to arm until then.
CLEARS, ARM_AGAIN = 1.5, 0.1
#: What it says as long as it has not.
STATION_FAILSAFE = "GCS failsafe on"
#: How often it is asked where home is, once it is armed.
HOMES = 5
#: Seconds for which an arming may be under way after it was sent last.
UNDER_WAY = 10.0


class Flight:
    """What brings a vehicle into the air and down, and what keeps others' hands free."""

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
        # The mode in which it was left to others last, '' when it was not.
        self._left_in = ""

    # -- instructions ---------------------------------------------------------------------------------

    async def do_arm(self) -> None:
        """In a mode that may be armed in, then armed; what it keeps for its binding is looked at before."""
        vehicle = self._vehicle
        self._motion.begin("arm")
        if self._state.armed:
            return
        await self._motion.monitor.settle()
        self._motion.monitor.check_begin("arm")
        vehicle.check_station("arm")
        await vehicle.check_alone()
        await vehicle.check_settings()
        if self._state.mode != vehicle.profile.arming:
            await self._motion.set_mode(vehicle.profile.arming)
        try:
            await self._arm()
        finally:
            self.may_be_arming()
        await self._hear_home()

    async def _arm(self) -> None:
        """Arm; again while ArduPilot has not yet noticed our heartbeats. Raises DeviceError with the reason.

        It raises its failsafe for the ground station while it is disarmed, too, and takes it back up to
        0.35 s after a heartbeat. Until then it refuses.
        """
        vehicle, start = self._vehicle, self._vehicle.clock.monotonic()
        await vehicle.seen(lambda: not self._state.critical, CLEARS)
        while True:
            begun = vehicle.clock.monotonic()
            try:
                return await vehicle.achieve(
                    "arm", lambda: self._state.armed, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0
                )
            except DeviceError as refusal:
                if STATION_FAILSAFE not in refusal.reason or begun - start > CLEARS:
                    raise await self._reasoned(refusal) from None
            await asyncio.sleep(ARM_AGAIN)

    async def _reasoned(self, refusal: DeviceError) -> DeviceError:
        """A refusal to arm with a reason: PX4 gives some of them without a word."""
        told = any(complaint in refusal.reason for complaint in COMPLAINTS)
        if told or refusal.kind == "DeviceTimeoutException":
            return refusal
        why = await self._readiness.do_why_not_ready()
        return self._vehicle.error(f"{refusal.reason}, {why}") if why else refusal

    async def _hear_home(self) -> None:
        """Home moves to where it is armed: it is heard anew, since the word of it may have been lost."""
        vehicle, since = self._vehicle, self._vehicle.clock.monotonic()
        home = float(dialect.MAVLINK_MSG_ID_HOME_POSITION)
        for _ in range(HOMES):
            answer = await vehicle.exchange.command(dialect.MAV_CMD_REQUEST_MESSAGE, home)
            if answer.result not in (None, dialect.MAV_RESULT_ACCEPTED):
                return
            if await vehicle.seen(lambda: self._home_at >= since, SHOWS / HOMES):
                return

    def _on_home(self, _: Any) -> None:
        self._home_at = self._vehicle.clock.monotonic()

    async def do_disarm(self) -> None:
        """Motors off."""
        self._motion.begin("disarm")
        if self._vehicle.unbeaten > NEWS and await self._disarmed():
            return
        await self._vehicle.achieve(
            "disarm", lambda: not self._state.armed, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0
        )

    async def do_takeoff(self, height: float) -> None:
        """Up to `height` above home."""
        state = self._state
        if not self._vehicle.profile.flies:
            raise self._vehicle.error(f"takeoff refused: a {state.kind} does not fly")
        self._limits.check_goal("takeoff", (0.0, 0.0, -height))
        if height <= 0.0:
            raise self._vehicle.error(f"takeoff needs a height above 0, not {height:g}")
        self._motion.begin("takeoff")
        if not state.armed:
            # PX4 would accept it, and fly off when it is armed later.
            raise self._vehicle.error("takeoff refused: the motors are off; call arm() first")
        stood = state.landed

        def climbing() -> bool:
            return bool(stood) and not state.landed

        if self._vehicle.profile.px4 and (state.home is None or state.position is None):
            raise self._vehicle.error("takeoff: the vehicle has not told where it is, or where home is")
        order = self._motion.orders.take_off(state, height)
        await self._motion.start("takeoff", order, taken=climbing)
        near = min(self._motion.tolerance, 0.1 * height)
        await self._motion.travel("takeoff", order, lambda place: abs(height + place[2]), near)

    async def do_land(self) -> None:
        """Down to the ground, here."""
        mode = await self._leave_for("land", "land", dialect.MAV_CMD_NAV_LAND)

        def height(place: Vector) -> float:
            return 0.0 if self._down else FAR - place[2]

        await self._motion.travel("land", Order(frozenset({mode})), height, 0.0, SINKS)
        await self._go_off("land")

    async def do_return_home(self) -> None:
        """Back to home or to a nearer rally point; what flies and can land is done when it stands there."""
        self._motion.check_bounded("returnHome", self._vehicle.profile.home)
        await self._returns.check("returnHome")
        copter = self._vehicle.profile.kind == "copter"
        ends = [] if copter else await self._returns.ends()
        mode = await self._leave_for("returnHome", "return", dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH)
        if copter:
            way = WayBack()
            await self._motion.travel(
                "returnHome",
                Order(frozenset({mode})),
                lambda place: 0.0 if self._down else way.left(place),
                0.0,
                COMES_BACK,
            )
            await self._go_off("returnHome")
            return
        arrival = await self._motion.arrival()
        if self._vehicle.profile.px4:
            # It would drive faster than its own parameter. One that takes no speed returns all the same.
            with suppress(DeviceError):
                await self._motion.speed.keep_wanted()

        def left(place: Vector) -> float:
            far = min(math.dist(place[:2], end[:2]) for end in ends)
            # PX4 switches a rover off that has returned.
            return 0.0 if not self._state.armed and far <= AT_HOME else arrival.left(far)

        motion, order = self._motion, Order(frozenset({mode}))
        await motion.travel("returnHome", order, left, motion.tolerance, motion.patience)

    async def do_hold(self) -> None:
        """Stop and stay."""
        self._motion.begin("hold")
        await self._motion.hold()

    async def do_set_mode(self, name: str) -> None:
        """Any mode of the autopilot, by its own name for it, but that of missions, which must be checked."""
        wanted, profile = name.upper(), self._vehicle.profile
        if profile.mode_values(wanted) is None:
            known = ", ".join(sorted(profile.modes.values()))
            raise self._vehicle.error(f"{profile.stack} has no mode '{name}'; it has {known}")
        if wanted in (profile.mission, *BY_MISSION):
            raise self._vehicle.error(
                f"setMode refused: {wanted} would fly the mission of the vehicle past the limits; "
                "call startMission(), which checks it"
            )
        self._motion.check_bounded(f"setMode to {wanted}", wanted)
        if wanted == profile.home:
            await self._returns.check("setMode")
        self._motion.begin(f"mode {wanted}")
        await self._motion.set_mode(wanted)

    # -- the safe state -------------------------------------------------------------------------------

    def may_be_arming(self) -> None:
        """An order to arm was sent, and may take effect although nobody waits for it any more."""
        self._arming_until = self._vehicle.clock.monotonic() + UNDER_WAY

    async def make_safe(self, state: str) -> None:
        """Into a safe state of the manifest, unless it is at rest or somebody else has it.

        Nothing is believed to be so that was only heard before. Raises DeviceError.
        """
        vehicle = self._vehicle
        self._motion.stream.stop()
        if self._state.heard is not None and vehicle.silence <= LINK_LOST:
            if self._is_not_to_be_moved:
                await self._look_again()
            if not self._state.armed:
                return
            if not self._motion.ours:
                self._leave()
                return
            if self._state.landed and vehicle.profile.flies and await self._disarmed():
                return
        self._left_in = ""
        await self._motion.set_mode(self._motion.monitor.safe_mode(state))

    @property
    def _is_not_to_be_moved(self) -> bool:
        """Whether nothing is to be done, as far as is known: its motors are off, or somebody else has it."""
        return not (self._state.armed and self._motion.ours)

    async def _look_again(self) -> None:
        """Hear it anew, after an arming that may be under way was called back. Raises DeviceError."""
        vehicle = self._vehicle
        if not self._state.armed and vehicle.clock.monotonic() < self._arming_until:
            answer = await vehicle.exchange.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
            if answer.result is None:
                raise vehicle.error("it may be arming, and does not answer a disarm", timeout=True)
        # An answer may be that to the arming: what is heard after it shows what became of that.
        since = vehicle.clock.monotonic()
        if await vehicle.seen(lambda: (self._state.heard or 0.0) > since, NEWS):
            return
        # Whoever says nothing at all answers no disarm either.
        if self._state.armed or vehicle.silence >= NEWS or not await self._disarmed():
            raise vehicle.error(f"no heartbeat for {vehicle.unbeaten:.1f} s", timeout=True)

    def _leave(self) -> None:
        """A pilot or the autopilot's own failsafe flies it: to take it from them would be less safe."""
        if self._left_in != self._state.mode:
            self._left_in = self._state.mode
            by = self._motion.failsafe.holder.rstrip(",")
            self._vehicle.note(f"in {self._state.mode}, by {by}: left to them")

    async def _disarmed(self) -> bool:
        """Try to switch the motors off on the ground; the autopilot refuses if it is not there.

        Without heartbeats its answer there is all that tells it: the bit of the motors in SYS_STATUS is the
        same whether they are on or off, by all recordings.
        """
        vehicle = self._vehicle
        answer = await vehicle.exchange.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
        if answer.result != dialect.MAV_RESULT_ACCEPTED:
            return False
        if vehicle.unbeaten > NEWS and self._state.landed:
            vehicle.publish(**self._state.switched_off(vehicle.clock.monotonic()))
            return True
        return await self._vehicle.seen(lambda: not self._state.armed, SHOWS)

    # -- steps ----------------------------------------------------------------------------------------

    @property
    def _down(self) -> bool:
        """Whether it stands on the ground, or does not move by itself."""
        return bool(self._state.landed) or not self._state.armed

    async def _go_off(self, what: str) -> None:
        """Wait until the autopilot has switched the motors off after a landing, or switch them off.

        An arming in between would find them on, and lose them when their time is over. A PX4 whose owner
        wants them to stay on keeps them on. Raises DeviceError, also when the landing was a crash.
        """
        vehicle = self._vehicle
        await self._motion.monitor.check_landed(what)
        if not vehicle.profile.flies or await vehicle.seen(lambda: not self._state.armed, GOES_OFF):
            return
        delay = await self._parameters.read(DELAY_OFF) if vehicle.profile.px4 else None
        if (delay is None or delay >= 0.0) and self._state.landed and self._motion.ours:
            vehicle.note(f"it has stood for {GOES_OFF:g} s with its motors on: they are switched off")
            await self.do_disarm()

    async def _leave_for(self, what: str, safe_state: str, command: int) -> str:
        """Enter the mode of a safe state by the command that there is for it, such as NAV_LAND; the mode.

        What does not fly knows no such command, or does what it would in the air: there the mode is set.
        """
        self._motion.begin(what)
        mode = self._vehicle.profile.safe(safe_state)
        if not self._vehicle.profile.flies:
            await self._motion.set_mode(mode)
            return mode
        await self._motion.enter(what, mode, command, done=lambda: self._down)
        return mode
