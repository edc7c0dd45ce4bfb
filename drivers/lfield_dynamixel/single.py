"""One servo: the device type `Dynamixel`."""

from __future__ import annotations

import asyncio
import math

from lfield_dynamixel.chain import Refusal
from lfield_dynamixel.members import LOOK, STILL, Seen
from lfield_dynamixel.movers import STUCK, Movers
from lfield_dynamixel.servo import POSITION_MODES, Servo

#: It pushes as hard as it was told when it takes this share of the current, and does so for so long (s).
PUSHES, LASTING = 0.85, 0.1


class Dynamixel(Movers):
    """One servo, by its id."""

    @property
    def servo(self) -> Servo:
        """The servo."""
        return next(iter(self.servos.values()))

    def _tell(self, seen: Seen) -> None:
        for value in seen.values():
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
        """Change the operating mode; the torque is as before, and the servo stays."""
        await self.servo.switch(name)
        await self.look()

    async def do_move_to(self, angle: float) -> None:
        """Turn there."""
        await self.travel("moveTo", {self.servo.node.number: angle})

    async def do_move_until(self, angle: float, current: float) -> None:
        """Turn until it is there or something resists with that current; it goes on pushing."""
        number = self.servo.node.number
        self.check_angles("moveUntil", {number: angle})
        self._check_current("moveUntil", current)
        if current <= 0.0:
            raise self.error(f"moveUntil needs a current above 0, not {current:g} A")
        await self.look()
        self.check_ready("moveUntil", ["currentPosition"])
        await self.servo.put("goal_current", round(current / self.servo.model.current))
        start = await self.observe()
        self._check_present({number: angle}, start)
        await self._send(self.goals({number: angle}, start))
        await self._close(angle, current)

    async def _close(self, angle: float, current: float) -> None:
        """Wait until it is there, or pushes; a servo that does neither is held up by something else."""
        number, tolerance = self.servo.node.number, self.binding.option("tolerance")
        moved_at, pushes_since = self.clock.monotonic(), math.inf
        while True:
            seen = await self.observe()
            self._tell(seen)
            self._check_present({number: angle}, seen)
            if seen[number].alert:
                await self.check_shut_down("moveUntil")
            value, now = seen[number], self.clock.monotonic()
            rests = abs(value.velocity) <= STILL
            if rests and abs(angle - value.position) <= tolerance:
                return
            pushes = rests and abs(value.current) >= PUSHES * current
            pushes_since = min(pushes_since, now) if pushes else math.inf
            if now - pushes_since >= LASTING:
                self.servo.pushing = True
                return
            moved_at = moved_at if rests else now
            if now - moved_at > STUCK:
                await self._give_up("moveUntil", {number: abs(angle - value.position)}, tolerance, seen)
            await asyncio.sleep(LOOK)

    async def do_set_position(self, angle: float) -> None:
        """A position setpoint, with the profile."""
        number = self.servo.node.number
        self.check_angles("setPosition", {number: angle})
        self.check_ready("setPosition", POSITION_MODES)
        start = {number: self._seen[number][1]} if number in self._seen else await self.observe()
        self._check_present({number: angle}, start)
        await self._command("setPosition", *self.goals({number: angle}, start)[self.servo])

    async def do_set_velocity(self, velocity: float) -> None:
        """A velocity setpoint."""
        self._check_speed("setVelocity", velocity)
        await self._set_goal("setVelocity", "velocity", velocity / self.servo.model.velocity)

    async def do_set_current(self, current: float) -> None:
        """A current setpoint."""
        self._check_current("setCurrent", current)
        await self._set_goal("setCurrent", "current", current / self.servo.model.current)

    async def _set_goal(self, what: str, mode: str, counts: float) -> None:
        self.check_ready(what, [mode])
        item = self.servo.item(f"goal_{mode}")
        await self._command(what, item.address, item.encode(round(counts)))

    async def _command(self, what: str, address: int, data: bytes) -> None:
        """Write a goal. A refusal has a reason that the condition tells better than the error byte."""
        try:
            await self.chain.write(self.servo.node, address, data)
        except Refusal:
            await self.look()
            self.check_ready(what, [self.servo.mode])
            raise

    async def do_calibrate(self, angle: float) -> None:
        """Call the present angle `angle`: the homing offset, seen in what it measures afterwards."""
        if not math.isfinite(angle):
            raise self.error(f"calibrate needs a finite angle, not {angle}")
        servo, offset = self.servo, await self.servo.get("homing_offset")
        wanted = offset + servo.model.to_counts(angle) - (await servo.present()).counts
        await servo.put_eeprom(homing_offset=wanted)
        seen = (await servo.present()).position
        if abs(seen - angle) > self.binding.option("tolerance"):
            await servo.put_eeprom(homing_offset=offset)
            raise self.error(
                f"calibrate({angle:g}): it would say {seen:.3f} rad, so its old homing offset is back; in "
                "position mode an offset of a quarter turn is the most, and a reversed servo counts backwards"
            )

    async def do_set_range(self, lowest: float, highest: float) -> None:
        """The position limits in the servo itself."""
        if not -math.inf < lowest < highest < math.inf:
            raise self.error(f"setRange needs a lower and a higher angle, not {lowest:g} and {highest:g}")
        low, high = (self.servo.model.to_counts(angle) for angle in (lowest, highest))
        if low < 0:
            raise self.error(f"setRange: {lowest:g} rad is below {self.servo.model.to_angle(0):.3f} rad")
        await self.servo.put_eeprom(min_position_limit=low, max_position_limit=high)

    def _check_current(self, what: str, current: float) -> None:
        limit = self.binding.limits.get("current", math.inf)
        if not abs(current) <= limit or math.isinf(current):  # so that NaN is refused too
            raise self.error(f"{what} of {current:g} A is above the limit of {limit:g} A")
        if not self.servo.model.current:
            raise self.error(f"{what}: a {self.servo.model.name} measures no current")
