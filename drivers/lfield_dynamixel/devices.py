"""The two device types: one servo, and servos that move together.

Motion is checked before anything is sent, and done when the state shows it.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Collection, Mapping

from lfield_dynamixel.bus.bus import COMMAND
from lfield_dynamixel.bus.chain import NoAnswer, Refusal
from lfield_dynamixel.members import LOOK, STILL, Members, Seen
from lfield_dynamixel.servo import FIRED, POSITION_MODES, ROUNDED, Servo

#: Seconds without coming closer after which a travel has failed, and what counts as closer, in rad.
STUCK, CLOSER = 1.5, 0.01
#: An angle that has been rounded may be beyond its bound by so much, in rad.
ROUNDING = 1e-9
#: It pushes as hard as it was told when it takes this share of the current, and does so for so long (s).
PUSHES, LASTING = 0.85, 0.1

Angles = Mapping[int, float]


class Movers(Members):
    """Members that travel together."""

    async def do_torque(self, on: bool) -> None:
        """Stiff where they are, or limp."""
        await self.look()
        if on:
            for servo in self.servos.values():
                self._check_sound(servo)
            await self.each(self.servos.values(), Servo.stiffen)
        else:
            await self.go_limp(COMMAND)
        await self.look()

    async def do_set_profile(self, velocity: float, acceleration: float) -> None:
        """How they move from now on; it goes out with every goal, so that a restart cannot lose it."""
        if not (0.0 <= velocity < math.inf and 0.0 <= acceleration < math.inf):
            raise self.error(f"setProfile needs finite numbers from 0, not {velocity:g} and {acceleration:g}")
        self._check_speed("setProfile", velocity)
        self.profile = velocity, acceleration

    async def do_stop(self) -> None:
        """Stay where they are now, seen to stand still; what is limp stays so."""
        await self._make_safe("torque_hold")
        # While it slowed down by its profile it went past that place, and would come back to it.
        await self._make_safe("torque_hold")
        self.tell(await self.observe())

    async def travel(self, what: str, angles: Angles) -> None:
        """Move each to its angle so that all arrive together. Raises DeviceError."""
        self.check_angles(what, angles)
        await self.look()
        self.check_ready(what, POSITION_MODES)
        start = await self.observe()
        self._check_present(angles, start)
        writes = self.goals(angles, start)
        await self.send(writes, COMMAND)
        # Nobody confirms a packet to several: those whose goal is another are told again, one by one.
        await self.each([self.servos[number] for number in angles], lambda s: self._confirm(s, writes[s]))
        await self._arrive(what, angles)

    def goals(self, angles: Angles, start: Seen) -> dict[Servo, tuple[int, bytes]]:
        """The writes that send each to its angle; profiles are scaled by the way, so all take as long."""
        ways = {number: abs(angle - start[number].position) for number, angle in angles.items()}
        longest = max(ways.values())
        speed = min([self._speed(), *(self.servos[number].top_speed for number in angles)])
        writes = {}
        for number, angle in angles.items():
            part = ways[number] / longest if longest > 0.0 else 1.0
            servo = self.servos[number]
            servo.pushing = False
            servo.check_profile(ways[number], speed * part, self.profile[1] * part)
            writes[servo] = servo.motion(angle, ways[number], speed * part, self.profile[1] * part)
        return writes

    def _speed(self) -> float:
        """The speed of a profile: what the program has set, within the limit of the binding."""
        return min(self.profile[0] or math.inf, self.binding.limits.get("speed", math.inf))

    async def _confirm(self, servo: Servo, write: tuple[int, bytes]) -> None:
        address, data = write
        seen = await self.chain.read(servo.node, address, len(data))
        if seen.data != data:
            await self.chain.write(servo.node, address, data)

    async def _arrive(self, what: str, angles: Angles) -> None:
        """Wait until all are there and stand still. Who comes no closer is left where it is."""
        tolerance: float = self.binding.option("tolerance")
        best, best_at = math.inf, self.clock.monotonic()
        while True:
            seen = await self.observe()
            self.tell(seen)
            self._check_present(angles, seen)
            if any(value.alert for value in seen.values()):
                await self.check_shut_down(what)
            short = {number: abs(angle - seen[number].position) for number, angle in angles.items()}
            if max(short.values()) <= tolerance and all(abs(v.velocity) <= STILL for v in seen.values()):
                return
            if sum(short.values()) < best - CLOSER:
                best, best_at = sum(short.values()), self.clock.monotonic()
            if self.clock.monotonic() - best_at > STUCK:
                await self._give_up(what, short, tolerance, seen)
            await asyncio.sleep(LOOK)

    async def _give_up(self, what: str, short: Angles, tolerance: float, seen: Seen) -> None:
        """Those that hang stay where they are instead of pushing on. Raises DeviceError."""
        await self.check_shut_down(what)
        hanging = [number for number, left in short.items() if left > tolerance]
        await self.each([self.servos[n] for n in hanging], lambda s: s.write_here(seen[s.node.number]))
        told = ", ".join(f"servo {number} stopped {short[number]:.3f} rad short" for number in hanging)
        raise self.error(
            f"{what}: {told or 'it does not come to rest'}; something is in the way or too heavy"
        )

    # -- checks -----------------------------------------------------------------------------------------

    def check_angles(self, what: str, angles: Angles) -> None:
        """Refuse what is no angle, or outside the bounds of the binding or of the servo itself."""
        low, high = self.binding.option("lowest"), self.binding.option("highest")
        for number, angle in angles.items():
            servo = self.servos[number]
            if not low - ROUNDING <= angle <= high + ROUNDING:  # so that NaN is refused too
                raise self.error(f"{what} refused: {angle:g} rad is outside {low:g} to {high:g} rad")
            least, greatest = servo.reach
            if servo.mode == "position" and not least - 1e-3 <= angle <= greatest + 1e-3:
                raise self.error(
                    f"{what} refused: servo {number} only goes from {least:.3f} to {greatest:.3f} rad "
                    f"(its position limits), not to {angle:g}"
                )

    def check_ready(self, what: str, modes: Collection[str]) -> None:
        """Refuse what a servo would not follow, saying what to call first."""
        for servo in self.servos.values():
            number = servo.node.number
            if servo.mode not in modes:
                raise self.error(
                    f"{what} needs the mode {' or '.join(modes)}; servo {number} is in {servo.mode} mode"
                )
            if servo.is_slave:
                raise self.error(
                    f"{what} refused: servo {number} is a slave (bit 1 of its drive mode) and only follows "
                    "the cable of its master; bind the master"
                )
            self._check_sound(servo)
            if not self.conditions[number].torque:
                raise self.error(f"{what}: the torque of servo {number} is off; call torque(true) first")

    def _check_sound(self, servo: Servo) -> None:
        number = servo.node.number
        if number in self.conflicts:
            raise self.error(self.conflicts[number])
        now = self.conditions.get(number)
        if now is None:
            raise NoAnswer(number)
        # An AX goes on saying what was wrong until its torque is on again: that is its cure.
        if now.faults and not now.torque and servo.node.protocol == 2:
            raise self.error(f"servo {number} has shut down: {now.faults}; {servo.cure}")
        if now.watchdog == FIRED:
            raise self.error(f"servo {number} was stopped by its own watchdog; call release() first")

    def _check_present(self, angles: Angles, seen: Seen) -> None:
        missing = [number for number in angles if number not in seen]
        doubled = [number for number in missing if number in self.conflicts]
        if doubled:
            raise self.error(self.conflicts[doubled[0]])
        if missing:
            names = ", ".join(f"servo {number}" for number in missing)
            raise self.error(f"{names} {'does' if len(missing) == 1 else 'do'} not answer", timeout=True)

    async def check_shut_down(self, what: str) -> None:
        """Fail when a servo has switched itself off on the way. An AX says why only while it is so."""
        await self.look()
        for number, now in self.conditions.items():
            if not now.torque:
                why, cure = now.faults or "it has switched its torque off", self.servos[number].cure
                raise self.error(f"{what}: servo {number} has shut down: {why}; {cure}")

    def _check_speed(self, what: str, speed: float) -> None:
        limit = self.binding.limits.get("speed", math.inf)
        if not abs(speed) <= limit * ROUNDED:  # so that NaN is refused too
            raise self.error(f"{what} of {speed:g} rad/s is above the limit of {limit:g} rad/s")


class Dynamixel(Movers):
    """One servo, by its id."""

    @property
    def servo(self) -> Servo:
        """The servo."""
        return next(iter(self.servos.values()))

    def tell(self, seen: Seen) -> None:
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
        await self.send(self.goals({number: angle}, start))
        await self._close(angle, current)

    async def _close(self, angle: float, current: float) -> None:
        """Wait until it is there, or pushes; a servo that does neither is held up by something else."""
        number, tolerance = self.servo.node.number, self.binding.option("tolerance")
        moved_at, pushes_since = self.clock.monotonic(), math.inf
        while True:
            seen = await self.observe()
            self.tell(seen)
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
        start = self.last_seen if number in self.last_seen else await self.observe()
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
        """A goal in the nearest count that is within the limit."""
        self.check_ready(what, [mode])
        counts = round(value / unit)
        if abs(counts) * unit > limit * ROUNDED:
            counts -= 1 if counts > 0 else -1
        item = self.servo.item(f"goal_{mode}")
        await self._command(what, item.address, item.encode(counts))

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
                "position mode an offset of a quarter turn is the most"
            )

    async def do_set_range(self, lowest: float, highest: float) -> None:
        """The position limits in the servo itself."""
        if not -math.inf < lowest < highest < math.inf:
            raise self.error(f"setRange needs a lower and a higher angle, not {lowest:g} and {highest:g}")
        low, high = (self.servo.model.to_counts(angle) for angle in (lowest, highest))
        if high == 2 * self.servo.model.centre and self.servo.model.protocol == 2:
            high -= 1  # a half turn is the place of minus a half turn; the last count of the turn is meant
        if low < 0:
            raise self.error(f"setRange: {lowest:g} rad is below {self.servo.model.to_angle(0):.3f} rad")
        await self.servo.put_eeprom(min_position_limit=low, max_position_limit=high)

    def _check_current(self, what: str, current: float) -> None:
        limit = self.binding.limits.get("current", math.inf)
        if not abs(current) <= limit * ROUNDED or math.isinf(current):  # so that NaN is refused too
            raise self.error(f"{what} of {current:g} A is above the limit of {limit:g} A")
        if not self.servo.model.current:
            raise self.error(f"{what}: a {self.servo.model.name} measures no current")


class DynamixelGroup(Movers):
    """Several servos; arrays are in the order of the ids in the binding."""

    def tell(self, seen: Seen) -> None:
        def each(quantity: str) -> list[float]:
            return [getattr(seen[n], quantity) if n in seen else math.nan for n in self.servos]

        self.publish(
            positions=each("position"),
            velocities=each("velocity"),
            currents=each("current"),
            temperatures=each("temperature"),
            missing=[number for number in self.servos if number not in seen],
            moving=any(value.moving for value in seen.values()),
        )

    async def do_move_to(self, angles: list[float]) -> None:
        """All turn and arrive together."""
        await self.travel("moveTo", self._by_id("moveTo", angles))

    async def do_set_positions(self, angles: list[float]) -> None:
        """A setpoint for all in one packet, which nobody confirms; a member that is missing is an error."""
        wanted = self._by_id("setPositions", angles)
        self.check_angles("setPositions", wanted)
        self.check_ready("setPositions", POSITION_MODES)
        await self.send(self.goals(wanted, self.last_seen), COMMAND)

    def _by_id(self, what: str, angles: list[float]) -> dict[int, float]:
        if len(angles) != len(self.servos):
            raise self.error(f"{what} needs {len(self.servos)} angles, one for each id, not {len(angles)}")
        return dict(zip(self.servos, angles, strict=True))
