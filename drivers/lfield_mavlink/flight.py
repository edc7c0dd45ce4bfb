"""Flying and driving: each instruction is confirmed by the vehicle's state, not by its word."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from lfield.clock import Clock
from lfield.driver import DeviceBinding, Manifest, Reports
from lfield_mavlink.contact import LINK_LOST, SHOWS, Contact
from lfield_mavlink.dialect import AUTOPILOT, dialect
from lfield_mavlink.state import Vector

#: Seconds without coming closer after which a flight has failed, and what counts as closer, in metres.
STUCK, CLOSER = 10.0, 0.1
#: How often a position goal is sent again while its call runs: a packet may have been lost.
RESEND = 1.0
#: How exactly a heading is reached, in radians.
HEADING_TOLERANCE = math.radians(4.0)

# type_mask of SET_POSITION_TARGET_LOCAL_NED: everything ignored but the position, or but the velocity.
ONLY_POSITION, ONLY_VELOCITY = 0x0DF8, 0x0DC7


class Flight(Contact):
    """What moves a vehicle, and its safe states."""

    def __init__(
        self,
        binding: DeviceBinding,
        manifest: Manifest,
        clock: Clock,
        reports: Reports,
        send: Callable[[Any], None],
    ) -> None:
        super().__init__(binding, manifest, clock, reports, send)
        # The mode we put it in last; any other but GUIDED is somebody else's.
        self._commanded = "GUIDED"

    # -- instructions ---------------------------------------------------------------------------------

    async def do_arm(self) -> None:
        """GUIDED, then armed: ArduPilot refuses to be armed in some modes, and to take off in most."""
        await self._check_failsafe()
        await self._be_guided()
        await self._achieve("arm", lambda: self.state.armed, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    async def do_disarm(self) -> None:
        """Motors off."""
        await self._achieve("disarm", lambda: not self.state.armed, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)

    async def do_takeoff(self, height: float) -> None:
        """Up to `height` above home."""
        self._check_goal("takeoff", 0.0, 0.0, height)
        if height <= 0.0:
            raise self.error(f"takeoff needs a height above 0, not {height:g}")
        await self._be_guided()
        stood = self.state.landed

        def climbing() -> bool:
            return bool(stood) and not self.state.landed

        values = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height)
        await self._command("takeoff", dialect.MAV_CMD_NAV_TAKEOFF, *values, taken=climbing)
        near = min(self._tolerance, 0.1 * height)
        await self._travel("takeoff", lambda place: abs(height + place[2]), near)

    async def do_go_to(self, north: float, east: float, down: float) -> None:
        """To a place relative to home; the goal is repeated until it is reached."""
        self._check_goal("goTo", north, east, -down)
        await self._be_guided()
        await self._set_speed()
        goal = (north, east, down)
        level = self._kind.name == "rover"

        def distance(place: Vector) -> float:
            return math.dist(goal[:2], place[:2]) if level else math.dist(goal, place)

        await self._travel("goTo", distance, self._tolerance, lambda: self._send_position(goal))

    async def do_yaw(self, heading: float) -> None:
        """Turn on the spot to a heading."""
        if not math.isfinite(heading):
            raise self.error(f"yaw needs a finite heading, not {heading}")
        await self._be_guided()
        await self._command("yaw", dialect.MAV_CMD_CONDITION_YAW, math.degrees(heading) % 360.0)

        def there() -> bool:
            yaw = self.state.yaw
            return yaw is not None and abs(math.remainder(yaw - heading, math.tau)) < HEADING_TOLERANCE

        await self._until(there, 30.0, "yaw")

    async def do_set_velocity(self, north: float, east: float, down: float) -> None:
        """One velocity setpoint; it is sent once, and the guard sees to its end."""
        limit = self.binding.limits.get("speed", math.inf)
        speed = math.hypot(north, east, down)
        if not speed <= limit:  # so that NaN is refused too
            raise self.error(f"setVelocity of {speed:g} m/s is above the limit of {limit:g} m/s")
        await self._be_guided()
        self._send_target(ONLY_VELOCITY, (0.0, 0.0, 0.0), (north, east, down))

    async def do_hold(self) -> None:
        """Stop and stay."""
        self._check_ours("hold")
        await self._set_mode(self._kind.hold)

    async def do_land(self) -> None:
        """Down to the ground, here."""
        self._check_ours("land")
        self._commanded = "LAND"
        await self._achieve("land", lambda: self.state.mode == "LAND", dialect.MAV_CMD_NAV_LAND)

        def height(place: Vector) -> float:
            down_yet = self.state.landed or not self.state.armed
            return 0.0 if down_yet else max(-place[2], CLOSER) + 1.0

        await self._travel("land", height, 0.0, mode="LAND")

    async def do_release(self) -> None:
        """Whatever mode it is in, the program takes the vehicle back."""
        self._commanded = self.state.mode

    async def _make_safe(self, state: str) -> None:
        if self.state.heard is not None and self._silence() <= LINK_LOST:
            if not self.state.armed:
                return
            if not self._ours:
                # A pilot or the autopilot's own failsafe flies it: to take it from them would be less safe.
                self.note(f"in {self.state.mode}, by a pilot or a failsafe: left to them")
                return
            if self.state.landed and self._kind.name == "copter" and await self._disarmed():
                return
        await self._set_mode(self._kind.safe[state])

    async def _disarmed(self) -> bool:
        """Try to switch the motors off on the ground; the autopilot refuses if it is not there."""
        answer = await self._exchange.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
        if answer.result != dialect.MAV_RESULT_ACCEPTED:
            return False
        return await self._seen(lambda: not self.state.armed, SHOWS)

    # -- parts of instructions ------------------------------------------------------------------------

    @property
    def _tolerance(self) -> float:
        tolerance: float = self.binding.option("tolerance")
        return tolerance

    @property
    def _ours(self) -> bool:
        """Whether the mode is one that this program chose; of a vehicle at rest it does not matter."""
        return not self.state.armed or self.state.mode in ("GUIDED", self._commanded)

    def _check_ours(self, what: str) -> None:
        if not self._ours:
            raise self.error(
                f"{what} refused: the vehicle is in {self.state.mode}, which this program did not choose; "
                "a pilot or a failsafe has it. release() takes it back"
            )

    async def _be_guided(self) -> None:
        self._check_link()
        self._check_ours("GUIDED")
        if self.state.mode != "GUIDED":
            await self._set_mode("GUIDED")

    async def _set_mode(self, name: str) -> None:
        # Noted before it is known to have worked: a safe state that is tried again must count as ours.
        self._commanded = name
        custom = float(dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        number = float(self._kind.mode_number(name))
        set_mode = dialect.MAV_CMD_DO_SET_MODE
        await self._achieve(f"mode {name}", lambda: self.state.mode == name, set_mode, custom, number)

    async def _set_speed(self) -> None:
        """Have the autopilot keep the binding's speed; it forgets it with every change of mode."""
        if (speed := self.binding.limits.get("speed")) is not None:
            await self._command("speed limit", dialect.MAV_CMD_DO_CHANGE_SPEED, 1.0, speed, -1.0)

    def _check_goal(self, what: str, north: float, east: float, height: float) -> None:
        """Refuse a goal that is no place, or outside the limits of the binding."""
        if not all(map(math.isfinite, (north, east, height))):
            raise self.error(f"{what} needs finite numbers")
        ceiling = self.binding.limits.get("altitude", math.inf)
        if height > ceiling:
            raise self.error(f"{what} refused: {height:g} m is above the limit of {ceiling:g} m")
        radius, far = self.binding.limits.get("radius", math.inf), math.hypot(north, east)
        if far > radius:
            raise self.error(f"{what} refused: {far:.1f} m from home is beyond the limit of {radius:g} m")

    async def _travel(
        self,
        what: str,
        distance: Callable[[Vector], float],
        near: float,
        resend: Callable[[], None] | None = None,
        *,
        mode: str = "GUIDED",
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
            self._check_underway(what, mode, start)
            if left < best - CLOSER:
                best, best_at = left, now
            if now - best_at > STUCK:
                raise self.error(f"{what} gave up: no progress for {STUCK:g} s, {left:.1f} m from its goal")
            if resend is not None and now - sent_at >= RESEND:
                resend()
                sent_at = now
            await self._next_news(0.25)

    def _check_underway(self, what: str, mode: str, start: float) -> None:
        """Raise when somebody else has taken over, or the motors are off."""
        if self.state.armed and self.state.mode == mode:
            return
        why = "the vehicle was disarmed" if not self.state.armed else f"the vehicle went to {self.state.mode}"
        raise self.error(f"{what} ended early: {why}{self._reasons(start)}")

    def _send_position(self, goal: Vector) -> None:
        north, east, down = (g + h for g, h in zip(goal, self.state.home_offset, strict=True))
        self._send_target(ONLY_POSITION, (north, east, down), (0.0, 0.0, 0.0))

    def _send_target(self, mask: int, place: Vector, velocity: Vector) -> None:
        frame, rest = dialect.MAV_FRAME_LOCAL_NED, (0.0, 0.0, 0.0)
        self._send(
            dialect.MAVLink_set_position_target_local_ned_message(
                0, self.system, AUTOPILOT, frame, mask, *place, *velocity, *rest, 0.0, 0.0
            )
        )
