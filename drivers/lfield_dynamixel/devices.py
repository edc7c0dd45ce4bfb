"""The two device types: one servo, and servos that move together.

A motion is checked before anything is sent, and done when the state confirms it.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Collection, Mapping

from lfield_dynamixel.bus.half_duplex_bus import COMMAND
from lfield_dynamixel.bus.servo_chain import NoAnswer, ServoRefusal
from lfield_dynamixel.members import POLL_INTERVAL, STILL, Members, Readings
from lfield_dynamixel.servo import POSITION_MODES, ROUNDED, WATCHDOG_FIRED, Servo

#: Seconds without progress after which a motion has failed, and the least progress in rad.
STUCK_TIME, MIN_PROGRESS = 1.5, 0.01
#: Rounding tolerance of an angle bound in rad.
ROUNDING = 1e-9
#: It pushes with the commanded force at this share of the current, for so many seconds.
PUSHING_SHARE, PUSHING_TIME = 0.85, 0.1

Angles = Mapping[int, float]


class MovingMembers(Members):
    """Members that move together."""

    async def do_torque(self, on: bool) -> None:
        """Torque on at the present position, or off."""
        await self.read_conditions()
        if on:
            for servo in self.servos.values():
                self._check_healthy(servo)
            await self.for_each(self.servos.values(), Servo.stiffen)
        else:
            await self.release_torque(COMMAND)
        await self.read_conditions()

    async def do_set_profile(self, velocity: float, acceleration: float) -> None:
        """The profile of later motions; sent with every goal, so that a restart cannot lose it."""
        if not (0.0 <= velocity < math.inf and 0.0 <= acceleration < math.inf):
            raise self.error(
                f"setProfile requires finite numbers of at least 0, not {velocity:g} and {acceleration:g}"
            )
        self._check_speed("setProfile", velocity)
        self.profile = velocity, acceleration

    async def do_stop(self) -> None:
        """Stops and holds; confirmed at rest. Members without torque stay limp."""
        await self._make_safe("torque_hold")
        # It overshot that position while it slowed down, and would return to it.
        await self._make_safe("torque_hold")
        self.publish_readings(await self.observe())

    async def travel(self, what: str, angles: Angles) -> None:
        """Moves each to its angle so that all arrive together. Raises DeviceError."""
        self.check_angles(what, angles)
        await self.read_conditions()
        self.check_ready(what, POSITION_MODES)
        start = await self.observe()
        self._check_present(angles, start)
        writes = self.goals(angles, start)
        await self.send(writes, COMMAND)
        # A packet to several is not confirmed: repeat wrong goals one by one.
        await self.for_each([self.servos[number] for number in angles], lambda s: self._confirm(s, writes[s]))
        await self._await_arrival(what, angles)

    def goals(self, angles: Angles, start: Readings) -> dict[Servo, tuple[int, bytes]]:
        """The writes that send each to its angle; profiles are scaled by distance for equal durations."""
        ways = {number: abs(angle - start[number].position) for number, angle in angles.items()}
        longest = max(ways.values())
        speed = min([self._speed(), *(self.servos[number].top_speed for number in angles)])
        writes = {}
        for number, angle in angles.items():
            part = ways[number] / longest if longest > 0.0 else 1.0
            servo = self.servos[number]
            servo.set_pushing(False)
            servo.check_profile(ways[number], speed * part, self.profile[1] * part)
            writes[servo] = servo.motion(angle, ways[number], speed * part, self.profile[1] * part)
        return writes

    def _speed(self) -> float:
        """The speed of a profile: set by the program, within the limit of the binding."""
        return min(self.profile[0] or math.inf, self.binding.limits.get("speed", math.inf))

    async def _confirm(self, servo: Servo, write: tuple[int, bytes]) -> None:
        address, data = write
        observed = await self.chain.read(servo.node, address, len(data))
        if observed.data != data:
            await self.chain.write(servo.node, address, data)

    async def _await_arrival(self, what: str, angles: Angles) -> None:
        """Waits until all are at rest at their angles. Members without progress are stopped."""
        tolerance: float = self.binding.option("tolerance")
        best, best_at = math.inf, self.clock.monotonic()
        while True:
            observed = await self.observe()
            self.publish_readings(observed)
            self._check_present(angles, observed)
            if any(value.alert for value in observed.values()):
                await self.check_shut_down(what)
            short = {number: abs(angle - observed[number].position) for number, angle in angles.items()}
            if max(short.values()) <= tolerance and all(abs(v.velocity) <= STILL for v in observed.values()):
                return
            if sum(short.values()) < best - MIN_PROGRESS:
                best, best_at = sum(short.values()), self.clock.monotonic()
            if self.clock.monotonic() - best_at > STUCK_TIME:
                await self._stop_stalled(what, short, tolerance, observed)
            await asyncio.sleep(POLL_INTERVAL)

    async def _stop_stalled(self, what: str, short: Angles, tolerance: float, readings: Readings) -> None:
        """Stops blocked members, which would keep pushing. Raises DeviceError."""
        await self.check_shut_down(what)
        hanging = [number for number, left in short.items() if left > tolerance]
        await self.for_each(
            [self.servos[n] for n in hanging], lambda s: s.write_hold_goal(readings[s.node.number])
        )
        stalled = ", ".join(f"servo {number} stopped {short[number]:.3f} rad short" for number in hanging)
        raise self.error(
            f"{what}: {stalled or 'it does not come to rest'}; something is in the way or too heavy"
        )

    # -- checks -----------------------------------------------------------------------------------------

    def check_angles(self, what: str, angles: Angles) -> None:
        """Refuses angles that are not finite, or outside the bounds of the binding or the servo."""
        low, high = self.binding.option("lowest"), self.binding.option("highest")
        for number, angle in angles.items():
            servo = self.servos[number]
            if not low - ROUNDING <= angle <= high + ROUNDING:  # refuses NaN as well
                raise self.error(f"{what} refused: {angle:g} rad is outside {low:g} to {high:g} rad")
            least, greatest = servo.reach
            if servo.mode == "position" and not least - 1e-3 <= angle <= greatest + 1e-3:
                raise self.error(
                    f"{what} refused: servo {number} only moves from {least:.3f} to {greatest:.3f} rad (its "
                    f"position limits), not to {angle:g}"
                )

    def check_ready(self, what: str, modes: Collection[str]) -> None:
        """Refuses what a servo would not follow, naming the call that is needed."""
        for servo in self.servos.values():
            number = servo.node.number
            if servo.mode not in modes:
                raise self.error(
                    f"{what} requires the mode {' or '.join(modes)}; servo {number} is in {servo.mode} mode"
                )
            if servo.is_slave:
                raise self.error(
                    f"{what} refused: servo {number} is a slave (bit 1 of its drive mode) and only follows "
                    "the cable of its master; bind the master"
                )
            self._check_healthy(servo)
            if not self.conditions[number].torque:
                raise self.error(f"{what}: the torque of servo {number} is off; call torque(true) first")

    def _check_healthy(self, servo: Servo) -> None:
        number = servo.node.number
        if number in self.conflicts:
            raise self.error(self.conflicts[number])
        now = self.conditions.get(number)
        if now is None:
            raise NoAnswer(number)
        # An AX keeps reporting its fault until its torque is on again, which is the remedy.
        if now.faults and not now.torque and servo.node.protocol == 2:
            raise self.error(f"servo {number} has shut down: {now.faults}; {servo.cure}")
        if now.watchdog == WATCHDOG_FIRED:
            raise self.error(f"servo {number} was stopped by its own watchdog; call release() first")

    def _check_present(self, angles: Angles, readings: Readings) -> None:
        missing = [number for number in angles if number not in readings]
        doubled = [number for number in missing if number in self.conflicts]
        if doubled:
            raise self.error(self.conflicts[doubled[0]])
        if missing:
            names = ", ".join(f"servo {number}" for number in missing)
            raise self.error(f"{names} {'does' if len(missing) == 1 else 'do'} not answer", timeout=True)

    async def check_shut_down(self, what: str) -> None:
        """Fails when a servo has switched itself off meanwhile. An AX reports the reason only while it
        applies.
        """
        await self.read_conditions()
        for number, now in self.conditions.items():
            if not now.torque:
                why, cure = now.faults or "it has switched its torque off", self.servos[number].cure
                raise self.error(f"{what}: servo {number} has shut down: {why}; {cure}")

    def _check_speed(self, what: str, speed: float) -> None:
        limit = self.binding.limits.get("speed", math.inf)
        if not abs(speed) <= limit * ROUNDED:  # refuses NaN as well
            raise self.error(f"{what} of {speed:g} rad/s is above the limit of {limit:g} rad/s")


class Dynamixel(MovingMembers):
    """One servo, by its id."""

    @property
    def servo(self) -> Servo:
        return next(iter(self.servos.values()))

    def publish_readings(self, readings: Readings) -> None:
        for value in readings.values():
            self.publish(
                position=value.position,
                velocity=value.velocity,
                current=value.current,
                effort=value.effort,
                voltage=value.voltage,
                temperature=value.temperature,
                moving=value.moving,
            )

    async def do_mode(self, name: str) -> None:
        """Changes the operating mode; torque and position are kept."""
        await self.servo.switch(name)
        await self.read_conditions()

    async def do_move_to(self, angle: float) -> None:
        await self.travel("moveTo", {self.servo.node.number: angle})

    async def do_move_until(self, angle: float, current: float) -> None:
        """Moves until it arrives or is blocked with that current; it keeps pushing."""
        number = self.servo.node.number
        self.check_angles("moveUntil", {number: angle})
        self._check_current("moveUntil", current)
        if current <= 0.0:
            raise self.error(f"moveUntil requires a current above 0, not {current:g} A")
        await self.read_conditions()
        self.check_ready("moveUntil", ["currentPosition"])
        await self.servo.write_item("goal_current", round(current / self.servo.model.current))
        start = await self.observe()
        self._check_present({number: angle}, start)
        await self.send(self.goals({number: angle}, start))
        await self._close(angle, current)

    async def _close(self, angle: float, current: float) -> None:
        """Waits until it has arrived or pushes; otherwise it is blocked by something else."""
        number, tolerance = self.servo.node.number, self.binding.option("tolerance")
        moved_at, pushes_since = self.clock.monotonic(), math.inf
        while True:
            observed = await self.observe()
            self.publish_readings(observed)
            self._check_present({number: angle}, observed)
            if observed[number].alert:
                await self.check_shut_down("moveUntil")
            value, now = observed[number], self.clock.monotonic()
            rests = abs(value.velocity) <= STILL
            if rests and abs(angle - value.position) <= tolerance:
                return
            pushes = rests and abs(value.current) >= PUSHING_SHARE * current
            pushes_since = min(pushes_since, now) if pushes else math.inf
            if now - pushes_since >= PUSHING_TIME:
                self.servo.set_pushing(True)
                return
            moved_at = moved_at if rests else now
            if now - moved_at > STUCK_TIME:
                await self._stop_stalled(
                    "moveUntil", {number: abs(angle - value.position)}, tolerance, observed
                )
            await asyncio.sleep(POLL_INTERVAL)

    async def do_set_position(self, angle: float) -> None:
        """A position setpoint, with the profile."""
        number = self.servo.node.number
        self.check_angles("setPosition", {number: angle})
        self.check_ready("setPosition", POSITION_MODES)
        start = self.last_readings if number in self.last_readings else await self.observe()
        self._check_present({number: angle}, start)
        await self._command("setPosition", *self.goals({number: angle}, start)[self.servo])

    async def do_set_velocity(self, velocity: float) -> None:
        """A velocity setpoint."""
        self._check_speed("setVelocity", velocity)
        limit = self.binding.limits.get("speed", math.inf)
        await self._set_goal("setVelocity", "velocity", velocity, self.servo.model.velocity, limit)

    async def do_set_current(self, current: float) -> None:
        """A current setpoint."""
        self._check_current("setCurrent", current)
        limit = self.binding.limits.get("current", math.inf)
        await self._set_goal("setCurrent", "current", current, self.servo.model.current, limit)

    async def _set_goal(self, what: str, mode: str, value: float, unit: float, limit: float) -> None:
        """Sends a goal in the nearest count within the limit."""
        self.check_ready(what, [mode])
        counts = round(value / unit)
        if abs(counts) * unit > limit * ROUNDED:
            counts -= 1 if counts > 0 else -1
        item = self.servo.item(f"goal_{mode}")
        await self._command(what, item.address, item.encode(counts))

    async def _command(self, what: str, address: int, data: bytes) -> None:
        """Writes a goal. The condition explains a refusal better than the error byte."""
        try:
            await self.chain.write(self.servo.node, address, data)
        except ServoRefusal:
            await self.read_conditions()
            self.check_ready(what, [self.servo.mode])
            raise

    async def do_calibrate(self, angle: float) -> None:
        """Defines the present angle as `angle`: sets the homing offset, confirmed by the measured angle."""
        if not math.isfinite(angle):
            raise self.error(f"calibrate requires a finite angle, not {angle}")
        servo, offset = self.servo, await self.servo.read_item("homing_offset")
        offset_counts = offset + servo.model.to_counts(angle) - (await servo.present()).counts
        await servo.write_eeprom(homing_offset=offset_counts)
        observed = (await servo.present()).position
        if abs(observed - angle) > self.binding.option("tolerance"):
            await servo.write_eeprom(homing_offset=offset)
            raise self.error(
                f"calibrate({angle:g}): it would report {observed:.3f} rad, so its old homing offset was "
                "restored; in position mode an offset is at most a quarter turn"
            )

    async def do_set_range(self, lowest: float, highest: float) -> None:
        """Sets the position limits in the servo."""
        if not -math.inf < lowest < highest < math.inf:
            raise self.error(f"setRange requires a lower and a higher angle, not {lowest:g} and {highest:g}")
        low, high = (self.servo.model.to_counts(angle) for angle in (lowest, highest))
        if high == 2 * self.servo.model.centre and self.servo.model.protocol == 2:
            high -= 1  # a half turn equals minus a half turn; take the last count of the turn
        if low < 0:
            raise self.error(f"setRange: {lowest:g} rad is below {self.servo.model.to_angle(0):.3f} rad")
        await self.servo.write_eeprom(min_position_limit=low, max_position_limit=high)

    def _check_current(self, what: str, current: float) -> None:
        limit = self.binding.limits.get("current", math.inf)
        if not abs(current) <= limit * ROUNDED or math.isinf(current):  # refuses NaN as well
            raise self.error(f"{what} of {current:g} A is above the limit of {limit:g} A")
        if not self.servo.model.current:
            raise self.error(f"{what}: a {self.servo.model.name} does not measure its current")


class DynamixelGroup(MovingMembers):
    """Several servos; arrays are in the order of the ids in the binding."""

    def publish_readings(self, readings: Readings) -> None:
        def each(quantity: str) -> list[float]:
            return [getattr(readings[n], quantity) if n in readings else math.nan for n in self.servos]

        self.publish(
            positions=each("position"),
            velocities=each("velocity"),
            currents=each("current"),
            temperatures=each("temperature"),
            missing=[number for number in self.servos if number not in readings],
            moving=any(value.moving for value in readings.values()),
        )

    async def do_move_to(self, angles: list[float]) -> None:
        """Moves all, with simultaneous arrival."""
        await self.travel("moveTo", self._by_id("moveTo", angles))

    async def do_set_positions(self, angles: list[float]) -> None:
        """A setpoint for all in one packet without confirmation; a missing member is an error."""
        goals = self._by_id("setPositions", angles)
        self.check_angles("setPositions", goals)
        self.check_ready("setPositions", POSITION_MODES)
        await self.send(self.goals(goals, self.last_readings), COMMAND)

    def _by_id(self, what: str, angles: list[float]) -> dict[int, float]:
        if len(angles) != len(self.servos):
            raise self.error(f"{what} requires {len(self.servos)} angles, one for each id, not {len(angles)}")
        return dict(zip(self.servos, angles, strict=True))
