"""Going to places, turning, circling, and setpoints of velocity."""

from __future__ import annotations

import math

from lfield_mavlink.dialect import dialect, result_words
from lfield_mavlink.flight import Flight
from lfield_mavlink.geo import Place, Vector
from lfield_mavlink.orders import ONLY_VELOCITY, VELOCITY_AND_YAW_RATE, Circle, Target

#: How exactly a heading is reached, in radians, and how long that may take, in seconds.
HEADING_TOLERANCE, TURNING = math.radians(4.0), 30.0
#: Seconds after which PX4 is told again to enter OFFBOARD.
NOTICED = 0.2


class Guidance(Flight):
    """Motions in the air, on the ground or in the water, within the limits of the binding."""

    def _set_up(self) -> None:
        super()._set_up()
        # What setSpeed() asked for last; the autopilot forgets it with every change of mode.
        self._speed: float | None = None

    # -- places ---------------------------------------------------------------------------------------

    async def do_go_to(self, north: float, east: float, down: float) -> None:
        """To a place relative to home."""
        await self._go_to("goTo", (north, east, down))

    async def do_go_to_global(self, latitude: float, longitude: float, height: float) -> None:
        """To a place in degrees, and metres above home; the limits are those about home."""
        if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):  # so that NaN is refused too
            raise self.error("goToGlobal needs a latitude from -90 to 90 and a longitude from -180 to 180")
        home = self.state.home
        if home is None or not self.state.knows_frames:
            raise self.error("goToGlobal needs to know where home is, and the vehicle has not told")
        north, east, _ = home.to(Place(latitude, longitude, home.altitude))
        await self._go_to("goToGlobal", (north, east, -height))

    async def _go_to(self, what: str, goal: Vector) -> None:
        self._check_goal(what, goal)
        self._check_placed(what)
        self._begin(what)
        order = self._orders.go_to(self.state, goal, self._wanted_speed)
        await self._start(what, order)

        def distance(place: Vector) -> float:
            return math.dist(goal, place) if self.profile.flies else math.dist(goal[:2], place[:2])

        await self._travel(what, order, distance, self._tolerance)

    async def do_yaw(self, heading: float) -> None:
        """Turn on the spot to a heading."""
        if not math.isfinite(heading):
            raise self.error(f"yaw needs a finite heading, not {heading}")
        self._check_placed("yaw")
        self._begin("yaw")
        order = self._orders.turn(self.state, heading)
        await self._start("yaw", order)

        def there() -> bool:
            yaw = self.state.yaw
            return yaw is not None and abs(math.remainder(yaw - heading, math.tau)) < HEADING_TOLERANCE

        await self._until(there, TURNING, "yaw")

    async def do_orbit(
        self, north: float, east: float, down: float, radius: float, speed: float, turns: float
    ) -> None:
        """Around a place, so many times; clockwise when `turns` is above 0. Then it holds."""
        self._check_goal("orbit", (north, east, down))
        if not (all(map(math.isfinite, (radius, speed, turns))) and radius > 0.0 and speed > 0.0 and turns):
            raise self.error("orbit needs a radius and a speed above 0, and turns other than 0")
        self._check_goal("orbit", _stretched((north, east, down), radius))
        self._check_speed("orbit", speed)
        self._check_placed("orbit")
        self._begin("orbit")
        circle = Circle((north, east, down), radius, speed, turns > 0.0)
        order = self._orders.orbit(self.state, circle)
        await self._start("orbit", order)
        await self._travel("orbit", order, Revolutions(circle, abs(turns)).left, 0.0)
        await self._set_mode(self.profile.hold)

    # -- speeds ---------------------------------------------------------------------------------------

    async def do_set_speed(self, speed: float) -> None:
        """The speed over ground for what follows, within the limit of the binding."""
        if not speed > 0.0:
            raise self.error(f"setSpeed needs a speed above 0, not {speed:g}")
        self._check_speed("setSpeed", speed)
        await self._change_speed(speed)
        self._speed = speed

    async def do_set_velocity(self, north: float, east: float, down: float) -> None:
        """One velocity setpoint: it acts until the time-to-live of the binding, unless it is replaced."""
        velocity = (north, east, down)
        self._check_speed("setVelocity", math.hypot(*velocity))
        self._check_way_out(velocity)
        await self._follow("setVelocity", Target(ONLY_VELOCITY, velocity=velocity))

    async def do_set_yaw_rate(self, rate: float) -> None:
        """One setpoint: it turns on the spot at this rate until the time-to-live."""
        if not math.isfinite(rate):
            raise self.error(f"setYawRate needs a finite rate, not {rate}")
        await self._follow("setYawRate", Target(VELOCITY_AND_YAW_RATE, yaw_rate=rate))

    async def _follow(self, what: str, target: Target) -> None:
        """Send a setpoint, once to ArduPilot; to PX4 again and again until its time-to-live and no longer."""
        until = self.clock.monotonic() + self.binding.ttl
        self._begin(what)
        guided = self.profile.guided
        if self.profile.px4:
            self._stream.start(self._setpoint(target), until)
            try:
                await self._enter_offboard(what, until)
            except BaseException:
                # Failed or called off: what nobody waits for any more is not sent any more.
                self._stream.stop()
                raise
            return
        if self.state.mode != guided:
            await self._set_mode(guided)
        self._send(self._setpoint(target))

    async def _enter_offboard(self, what: str, until: float) -> None:
        """PX4 enters OFFBOARD when it has noticed the setpoints; before that it may just accept it."""
        guided, start = self.profile.guided, self.clock.monotonic()
        self._commanded = frozenset({guided})
        values = self._mode_values(guided)
        while self.state.mode != guided:
            answer = await self._exchange.command(dialect.MAV_CMD_DO_SET_MODE, *values, once=True)
            if await self._seen(lambda: self.state.mode == guided, NOTICED):
                return
            if self.clock.monotonic() >= until:
                self._check_link()
                result = "no answer" if answer.result is None else result_words(answer.result)
                raise self.error(
                    f"{what}: {guided} was not entered within the time-to-live of {self.binding.ttl:g} s "
                    f"({result}){self._reasons(start)}"
                )

    async def _change_speed(self, speed: float) -> None:
        await self._command("speed", dialect.MAV_CMD_DO_CHANGE_SPEED, 1.0, speed, -1.0)

    @property
    def _wanted_speed(self) -> float | None:
        """What was asked for last, else the limit of the binding, else the autopilot's own."""
        return self._speed or self.binding.limits.get("speed")

    async def _keep_speed(self) -> None:
        """Have the autopilot keep the wanted speed in what it flies by itself."""
        if self._wanted_speed is not None:
            await self._change_speed(self._wanted_speed)

    # -- limits ---------------------------------------------------------------------------------------

    def _check_speed(self, what: str, speed: float) -> None:
        limit = self.binding.limits.get("speed", math.inf)
        if not (math.isfinite(speed) and speed <= limit):
            raise self.error(f"{what} of {speed:g} m/s is above the limit of {limit:g} m/s")

    def _check_way_out(self, velocity: Vector) -> None:
        """Refuse a velocity that leads out of the limits before its time-to-live is over, or farther out."""
        place = self.state.position
        if place is None:
            return
        ahead = tuple(p + v * self.binding.ttl for p, v in zip(place, velocity, strict=True))
        limits = self.binding.limits
        if math.hypot(*ahead[:2]) > max(limits.get("radius", math.inf), math.hypot(*place[:2])):
            raise self.error(f"setVelocity refused: it leads beyond the limit of {limits['radius']:g} m")
        if -ahead[2] > max(limits.get("altitude", math.inf), -place[2]):
            raise self.error(f"setVelocity refused: it leads above the limit of {limits['altitude']:g} m")

    def _check_placed(self, what: str) -> None:
        state = self.state
        if state.position is None or (self.profile.px4 and state.home is None):
            raise self.error(f"{what}: the vehicle has not told where it is, or where home is")


class Revolutions:
    """Counts the turns around a circle; `left` is the way still to go, in metres."""

    def __init__(self, circle: Circle, turns: float) -> None:
        self._circle, self._wanted = circle, turns * math.tau
        self._turned = 0.0
        self._last: float | None = None

    def left(self, place: Vector) -> float:
        """Metres to go, with the way onto the circle."""
        north, east = place[0] - self._circle.centre[0], place[1] - self._circle.centre[1]
        off = abs(math.hypot(north, east) - self._circle.radius)
        angle = math.atan2(east, north)
        if off > 0.5 * self._circle.radius:
            self._last = None
            return off + self._wanted * self._circle.radius
        if self._last is not None:
            step = math.remainder(angle - self._last, math.tau)
            self._turned += step if self._circle.clockwise else -step
        self._last = angle
        return (self._wanted - self._turned) * self._circle.radius


def _stretched(centre: Vector, radius: float) -> Vector:
    """The place of a circle that is farthest from home."""
    far = math.hypot(*centre[:2])
    if far == 0.0:
        return (radius, 0.0, centre[2])
    share = (far + radius) / far
    return (centre[0] * share, centre[1] * share, centre[2])
