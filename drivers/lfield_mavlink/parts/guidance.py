"""Instructions for positions, headings, orbits, and velocity setpoints."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from contextlib import suppress

from lfield.driver import DeviceError
from lfield_mavlink import log_messages
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.geodesy import Place, Vector
from lfield_mavlink.limits import Limits
from lfield_mavlink.parts.motion_control import Motion
from lfield_mavlink.parts.progress import Following, Revolutions, Turning
from lfield_mavlink.setpoints.motion_orders import Circle, Order, ProgressPatience
from lfield_mavlink.setpoints.trajectory import ONLY_VELOCITY, VELOCITY_AND_YAW_RATE, Target

#: Tolerance of a heading in radians.
HEADING_TOLERANCE = math.radians(4.0)
#: Known only after an attempt.
CANNOT_TURN = "this frame can turn only while driving: use goTo or setVelocity"
TURN_PATIENCE = ProgressPatience(
    closer=0.05, message="no progress for {seconds:g} s, {left:.2f} rad from its heading"
)
TURN_IN_PLACE_PATIENCE = ProgressPatience(
    2.0, 0.05, message="its heading did not change for {seconds:g} s; " + CANNOT_TURN
)
#: Metres that PX4's rover may take to drive round, and the error after that.
TURN_CLEARANCE = 5.0
LOOP_PATIENCE = ProgressPatience(
    4.0, 0.05, clearance=TURN_CLEARANCE,
    message="driving round, it did not turn towards its heading for {seconds:g} s, or moved {clearance:g} m "
            "away, and is {left:.2f} rad off; use goTo to reach a position with more free space",
)  # fmt: skip
#: Metres ahead of a vehicle that does not follow a velocity, where its own fence is checked.
AHEAD = 5.0


class Guidance:
    """Motions within the limits of the binding."""

    def __init__(self, vehicle: Contact, motion: Motion, limits: Limits) -> None:
        self._vehicle, self._state = vehicle, vehicle.state
        self._motion, self._limits = motion, limits
        self._turning, self._following = Turning(), Following()
        # Positions to check against its own fence, with the message for it.
        self._fence_checks: asyncio.Queue[tuple[str, str, Vector]] = asyncio.Queue()
        motion.failsafe.set_engaged_handler(self._check_fence_here)

    async def run(self) -> None:
        """Logs which of the autopilot's own fences prevents a velocity or has triggered, until cancelled.

        setVelocity does not wait for the fence parameters, since it must be repeated in time.
        """
        while True:
            symptom, subject, place = await self._fence_checks.get()
            # A lost link is reported elsewhere.
            with suppress(DeviceError):
                if reason := await self._motion.fence.excess_reason(place, subject):
                    self._vehicle.note(log_messages.FENCE_SUSPECTED.line(symptom=symptom, reason=reason))

    # -- places ---------------------------------------------------------------------------------------

    async def do_go_to(self, north: float, east: float, down: float) -> None:
        """Moves to a position relative to home."""
        await self._go_to("goTo", (north, east, down))

    async def do_go_to_global(self, latitude: float, longitude: float, height: float) -> None:
        """Moves to a position in degrees, and metres above home, within the limits."""
        if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):  # refuses NaN as well
            raise self._vehicle.error(
                "goToGlobal requires a latitude from -90 to 90 and a longitude from -180 to 180"
            )
        home = self._state.home
        if home is None or not self._state.knows_frames:
            raise self._vehicle.error("goToGlobal: the home position is unknown")
        north, east, _ = home.vector_to(Place(latitude, longitude, home.altitude), self._state.radius)
        await self._go_to("goToGlobal", (north, east, -height))

    async def _go_to(self, action: str, goal: Vector) -> None:
        motion, vehicle = self._motion, self._vehicle
        self._limits.check_goal(action, goal)
        self._check_position_known(action)
        motion.start_motion(action)
        if vehicle.profile.by_trajectory and (reason := await motion.fence.excess_reason(goal)):
            # PX4 follows setpoints up to its fence, and then acts.
            raise vehicle.error(f"{action} refused: {reason}")
        speed = await motion.speed.goal_speed()
        order = motion.orders.go_to(self._state, goal, speed)
        await motion.start(action, order)
        motion.monitor.goes_to(goal)
        arrival = await motion.arrival()

        def distance(place: Vector) -> float:
            flies = vehicle.profile.flies
            return math.dist(goal, place) if flies else arrival.remaining(math.dist(goal[:2], place[:2]))

        await motion.travel(action, order, distance, motion.tolerance, motion.patience)
        if vehicle.profile.by_trajectory and not vehicle.profile.flies:
            await motion.hold()

    async def do_yaw(self, heading: float) -> None:
        """Turns to a heading: on the spot, but a PX4 rover drives round."""
        if not math.isfinite(heading):
            raise self._vehicle.error(f"yaw requires a finite heading, not {heading}")
        self._check_position_known("yaw")
        motion, state = self._motion, self._state
        motion.start_motion("yaw")
        order = motion.orders.turn(state, heading, motion.speed.target)

        def remaining(_: Vector) -> float:
            return math.inf if state.yaw is None else abs(math.remainder(state.yaw - heading, math.tau))

        if self._vehicle.profile.px4 and not self._vehicle.profile.flies:
            await self._drive_round(order, remaining)
            return
        await motion.start("yaw", order)
        patience = TURN_IN_PLACE_PATIENCE if order.target else TURN_PATIENCE
        await motion.travel("yaw", order, remaining, HEADING_TOLERANCE, patience)

    async def _drive_round(self, order: Order, remaining: Callable[[Vector], float]) -> None:
        """Follows a velocity until the heading is reached, within the permitted room; then holds."""
        motion, place = self._motion, self._state.position
        assert place is not None, "the caller has checked it"
        assert order.target is not None, "so the order is created"
        if remaining(place) <= HEADING_TOLERANCE:
            return
        farthest = Circle((place[0], place[1], 0.0), TURN_CLEARANCE, 1.0, clockwise=True).farthest
        self._limits.check_goal(f"yaw, which needs {TURN_CLEARANCE:g} m to drive round in,", farthest)
        if reason := await motion.fence.excess_reason(
            farthest, f"it needs {TURN_CLEARANCE:g} m to drive round in, up to"
        ):
            raise self._vehicle.error(f"yaw refused: {reason}")
        await self._follow("yaw", order.target(place))
        await motion.travel("yaw", order, remaining, HEADING_TOLERANCE, LOOP_PATIENCE)
        motion.stream.stop()
        await motion.hold()

    async def do_orbit(
        self, north: float, east: float, down: float, radius: float, speed: float, turns: float
    ) -> None:
        """Orbits a position `turns` times, clockwise if positive; then holds."""
        motion, limits, centre = self._motion, self._limits, (north, east, down)
        limits.check_goal("orbit", centre)
        if not (all(map(math.isfinite, (radius, speed, turns))) and radius > 0.0 and speed > 0.0 and turns):
            raise self._vehicle.error("orbit requires a radius and a speed above 0, and turns other than 0")
        if self._vehicle.profile.px4 and not self._vehicle.profile.flies:
            raise self._vehicle.error("orbit refused: PX4 orbits only with flying vehicles; use goTo")
        circle = Circle(centre, radius, speed, turns > 0.0)
        limits.check_goal("orbit", circle.farthest)
        limits.check_speed("orbit", speed)
        self._check_position_known("orbit")
        motion.start_motion("orbit")
        if reason := await motion.fence.excess_reason(circle.farthest, "the circle leads up to"):
            raise self._vehicle.error(f"orbit refused: {reason}")
        order = motion.orders.orbit(self._state, circle)
        await motion.start("orbit", order)
        await motion.travel("orbit", order, Revolutions(circle, abs(turns)).remaining, 0.0, motion.patience)
        await motion.hold()

    # -- speeds ---------------------------------------------------------------------------------------

    async def do_set_speed(self, speed: float) -> None:
        """Sets the horizontal speed of following motions, within the limit of the binding."""
        if not speed > 0.0:
            raise self._vehicle.error(f"setSpeed requires a speed above 0, not {speed:g}")
        self._limits.check_speed("setSpeed", speed)
        await self._motion.speed.set(speed)

    async def do_set_velocity(self, north: float, east: float, down: float) -> None:
        """Sets a velocity, valid for the time-to-live of the binding unless it is replaced."""
        velocity = (north, east, down)
        self._limits.check_speed("setVelocity", math.hypot(*velocity))
        self._limits.check_velocity(self._state.position, velocity)
        commanded = self._motion.speed.corrected_velocity(velocity)
        await self._follow("setVelocity", Target(ONLY_VELOCITY, velocity=commanded))
        self._check_fence_ahead(velocity)

    def _check_fence_ahead(self, velocity: Vector) -> None:
        """Schedules a check of the autopilot's own fence when the vehicle does not follow a velocity."""
        state, now, ttl = self._state, self._vehicle.clock.monotonic(), self._vehicle.binding.ttl
        place = state.position
        if self._following.fails(velocity, state.velocity, ttl, now) and place is not None:
            share = AHEAD / math.hypot(*velocity)
            north, east, down = (p + share * v for p, v in zip(place, velocity, strict=True))
            symptom = f"setVelocity has hardly moved the vehicle for {Following.JUDGED:g} s"
            self._fence_checks.put_nowait((symptom, f"{AHEAD:g} m ahead is", (north, east, down)))

    def _check_fence_here(self) -> None:
        """Schedules a check of the fence after its failsafe acted; its text names no parameter."""
        if (place := self._state.position) is not None and not self._vehicle.is_quiet:
            self._fence_checks.put_nowait(
                (f"its failsafe controls the vehicle in {self._state.mode}", "it is", place)
            )

    async def do_set_yaw_rate(self, rate: float) -> None:
        """Turns on the spot at this rate for the time-to-live."""
        if not math.isfinite(rate):
            raise self._vehicle.error(f"setYawRate requires a finite rate, not {rate}")
        now, ttl = self._vehicle.clock.monotonic(), self._vehicle.binding.ttl
        yaw = self._state.yaw
        if self._state.kind == "rover" and yaw is not None and self._turning.fails(rate, yaw, ttl, now):
            raise self._vehicle.error(f"setYawRate has not changed its heading for 2 s; {CANNOT_TURN}")
        await self._follow("setYawRate", Target(VELOCITY_AND_YAW_RATE, yaw_rate=rate))

    async def _follow(self, action: str, target: Target) -> None:
        """Sends a setpoint: once to ArduPilot, repeatedly to PX4 until its time-to-live."""
        motion, vehicle = self._motion, self._vehicle
        ttl, previous_mode = vehicle.binding.ttl, self._state.mode
        until = vehicle.clock.monotonic() + ttl
        motion.start_motion(action)
        if vehicle.profile.px4:
            motion.stream.start(target, until)
            try:
                await motion.guided.enter_offboard(action, until, f"the ttl of {ttl:g} s")
            except BaseException:
                # Failed or cancelled: stop sending.
                motion.brake()
                raise
            motion.claim(vehicle.profile.guided, self._state.mode)
            return
        if not motion.guided.is_entered:
            if not await motion.guided.enter_guided(until):
                await motion.set_mode(vehicle.profile.guided)
            # Earlier heartbeats may arrive on another link.
            motion.claim(vehicle.profile.guided, previous_mode)
        motion.send(target)

    def _check_position_known(self, action: str) -> None:
        needs_home = self._vehicle.profile.px4
        if self._state.position is None or (needs_home and self._state.home is None):
            raise self._vehicle.error(f"{action}: its position or its home is unknown")
