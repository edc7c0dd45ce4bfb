"""Motion of one servo or several: checked before anything is sent, and done when the state shows it."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Collection, Mapping

from lfield_dynamixel.bus import COMMAND
from lfield_dynamixel.chain import NoAnswer
from lfield_dynamixel.members import LOOK, STILL, Members, Seen
from lfield_dynamixel.servo import FIRED, POSITION_MODES, Servo

#: Seconds without coming closer after which a travel has failed, and what counts as closer, in rad.
STUCK, CLOSER = 1.5, 0.01

Angles = Mapping[int, float]


class Movers(Members):
    """Members that travel together."""

    async def do_torque(self, on: bool) -> None:
        """Stiff where they are, or limp."""
        await self.look()
        if on:
            for servo in self.servos.values():
                self._check_sound(servo)
            await self._each(self.servos.values(), Servo.stiffen)
        else:
            await self._go_limp(COMMAND)
        await self.look()

    async def do_set_profile(self, velocity: float, acceleration: float) -> None:
        """How they move from now on; it goes out with every goal, so that a restart cannot lose it."""
        if not (0.0 <= velocity < math.inf and 0.0 <= acceleration < math.inf):
            raise self.error(f"setProfile needs finite numbers from 0, not {velocity:g} and {acceleration:g}")
        self._check_speed("setProfile", velocity)
        self.profile = velocity, acceleration

    async def travel(self, what: str, angles: Angles) -> None:
        """Move each to its angle so that all arrive together. Raises DeviceError."""
        self.check_angles(what, angles)
        await self.look()
        self.check_ready(what, POSITION_MODES)
        start = await self.observe()
        self._check_present(angles, start)
        writes = self.goals(angles, start)
        await self._send(writes, COMMAND)
        # Nobody confirms a packet to several: those whose goal is another are told again, one by one.
        await self._each([self.servos[number] for number in angles], lambda s: self._confirm(s, writes[s]))
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
            self._tell(seen)
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
        await self._each([self.servos[n] for n in hanging], lambda s: s.write_here(seen[s.node.number]))
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
            if not low <= angle <= high:  # so that NaN is refused too
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
            self._check_sound(servo)
            if not self.conditions[number].torque:
                raise self.error(f"{what}: the torque of servo {number} is off; call torque(true) first")

    def _check_sound(self, servo: Servo) -> None:
        number = servo.node.number
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
        if not abs(speed) <= limit:  # so that NaN is refused too
            raise self.error(f"{what} of {speed:g} rad/s is above the limit of {limit:g} rad/s")
