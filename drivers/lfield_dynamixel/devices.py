"""The two device types: one servo, and servos that move together."""

from __future__ import annotations

import asyncio
import math

from lfield_dynamixel.bus.half_duplex_bus import COMMAND
from lfield_dynamixel.bus.servo_chain import ServoRefusal
from lfield_dynamixel.members import POLL_INTERVAL, STILL, Readings
from lfield_dynamixel.motion import STUCK_TIME, MovingMembers
from lfield_dynamixel.servo import POSITION_MODES, ROUNDED, Servo

#: A servo pushes with the commanded force at this share of the current, for so many seconds.
PUSHING_SHARE, PUSHING_TIME = 0.85, 0.1


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
        """Moves until the servo arrives or is blocked with that current; it keeps pushing."""
        number = self.servo.node.number
        self.check_angles("moveUntil", {number: angle})
        self._check_current("moveUntil", current)
        if current <= 0.0:
            raise self.error(f"moveUntil requires a current above 0, not {current:g} A")
        await self.read_conditions()
        self.check_ready("moveUntil", ["currentPosition"])
        await self.servo.limit_force(current)
        start = await self.observe()
        self._check_present({number: angle}, start)
        await self.send(self.goals({number: angle}, start))
        await self._await_contact(angle, current)

    async def _await_contact(self, angle: float, current: float) -> None:
        """Waits until the servo has arrived or pushes; otherwise another object blocks it."""
        number, tolerance = self.servo.node.number, self.binding.option("tolerance")
        last_motion, pushing_since = self.clock.monotonic(), math.inf
        while True:
            observed = await self.observe()
            self.publish_readings(observed)
            self._check_present({number: angle}, observed)
            if observed[number].alert:
                await self.check_shut_down("moveUntil")
            value, now = observed[number], self.clock.monotonic()
            is_at_rest = abs(value.velocity) <= STILL
            if is_at_rest and abs(angle - value.position) <= tolerance:
                return
            is_pushing = is_at_rest and abs(value.current) >= PUSHING_SHARE * current
            pushing_since = min(pushing_since, now) if is_pushing else math.inf
            if now - pushing_since >= PUSHING_TIME:
                self.servo.set_pushing(True)
                return
            last_motion = last_motion if is_at_rest else now
            if now - last_motion > STUCK_TIME:
                await self._stop_stalled(
                    "moveUntil", {number: abs(angle - value.position)}, tolerance, observed
                )
            await asyncio.sleep(POLL_INTERVAL)

    async def do_set_position(self, angle: float) -> None:
        """Sends a position setpoint, with the profile."""
        number = self.servo.node.number
        self.check_angles("setPosition", {number: angle})
        self.check_ready("setPosition", POSITION_MODES)
        start = self.last_readings if number in self.last_readings else await self.observe()
        self._check_present({number: angle}, start)
        await self._command("setPosition", *self.goals({number: angle}, start)[self.servo])

    async def do_set_velocity(self, velocity: float) -> None:
        """Sends a velocity setpoint."""
        self._check_speed("setVelocity", velocity)
        limit = self.binding.limits.get("speed", math.inf)
        await self._set_goal("setVelocity", "velocity", velocity, self.servo.model.velocity, limit)

    async def do_set_current(self, current: float) -> None:
        """Sends a current setpoint."""
        self._check_current("setCurrent", current)
        limit = self.binding.limits.get("current", math.inf)
        await self._set_goal("setCurrent", "current", current, self.servo.model.current, limit)

    async def _set_goal(self, instruction: str, mode: str, value: float, unit: float, limit: float) -> None:
        """Sends a goal in the nearest count within the limit."""
        self.check_ready(instruction, [mode])
        counts = round(self.servo.joint.direction * value / unit)
        if abs(counts) * unit > limit * ROUNDED:
            counts -= 1 if counts > 0 else -1
        await self._command(instruction, *self.servo.write_of(f"goal_{mode}", counts))

    async def _command(self, instruction: str, address: int, data: bytes) -> None:
        """Writes a goal. The condition explains a refusal better than the error byte."""
        try:
            await self.chain.write(self.servo.node, address, data)
        except ServoRefusal:
            await self.read_conditions()
            self.check_ready(instruction, [self.servo.mode])
            raise

    async def do_calibrate(self, angle: float) -> None:
        """Defines the present angle as `angle`: sets the homing offset, confirmed by the measured angle."""
        if not math.isfinite(angle):
            raise self.error(f"calibrate requires a finite angle, not {angle}")
        servo, offset = self.servo, await self.servo.read_item("homing_offset")
        change = servo.model.to_counts(servo.joint.to_servo(angle)) - (await servo.present()).counts
        offset_counts = servo.model.homing_within(offset + servo.model.homing * change)
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
        servo, joint = self.servo, self.servo.joint
        low, high = sorted(servo.model.to_counts(joint.to_servo(angle)) for angle in (lowest, highest))
        if high == 2 * servo.model.centre and servo.model.protocol != 1:
            high -= 1  # a half turn equals minus a half turn; use the last count of the turn
        if low < 0:
            edge = joint.to_joint(servo.model.to_angle(0))
            raise self.error(f"setRange: {lowest:g} to {highest:g} rad is beyond {edge:.3f} rad")
        await servo.write_eeprom(min_position_limit=low, max_position_limit=high)

    def _check_current(self, instruction: str, current: float) -> None:
        limit = self.binding.limits.get("current", math.inf)
        if not abs(current) <= limit * ROUNDED or math.isinf(current):  # refuses NaN as well
            raise self.error(f"{instruction} of {current:g} A is above the limit of {limit:g} A")
        if not self.servo.model.current:
            raise self.error(f"{instruction}: a {self.servo.model.name} does not measure its current")


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
        """Moves all members, with simultaneous arrival."""
        await self.travel("moveTo", self._by_id("moveTo", angles))

    async def do_move_joint(self, name: str, angle: float) -> None:
        """Moves the joint of that name."""
        numbers = {servo.joint.name: number for number, servo in self.servos.items() if servo.joint.name}
        if name not in numbers:
            names = ", ".join(numbers) or "none: write 'names' in its binding"
            raise self.error(f"moveJoint: there is no joint '{name}'; there are: {names}")
        await self.travel("moveJoint", {numbers[name]: angle})

    async def do_set_positions(self, angles: list[float]) -> None:
        """Sends a setpoint for all in one packet without confirmation; a missing member is an error."""
        goals = self._by_id("setPositions", angles)
        self.check_angles("setPositions", goals)
        self.check_ready("setPositions", POSITION_MODES)
        await self.send(self.goals(goals, self.last_readings), COMMAND)

    def _by_id(self, instruction: str, angles: list[float]) -> dict[int, float]:
        if len(angles) != len(self.servos):
            raise self.error(
                f"{instruction} requires {len(self.servos)} angles, one for each id, not {len(angles)}"
            )
        return dict(zip(self.servos, angles, strict=True))
