"""Motions of one servo or of several that move together.

A motion is checked before packets are sent, and done when the state confirms it. When it fails, all servos
stop.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Collection, Mapping

from lfield.driver import DeviceError
from lfield_dynamixel.bus.half_duplex_bus import COMMAND
from lfield_dynamixel.bus.servo_chain import NoAnswer
from lfield_dynamixel.members import POLL_INTERVAL, STILL, Members, Readings
from lfield_dynamixel.servo import POSITION_MODES, ROUNDED, WATCHDOG_FIRED, Servo

#: Seconds without progress after which a motion has failed, and the least progress in rad.
STUCK_TIME, MIN_PROGRESS = 1.5, 0.01
#: Rounding tolerance of an angle bound in rad.
ROUNDING = 1e-9

Angles = Mapping[int, float]


class MovingMembers(Members):
    """Members that move together."""

    async def do_torque(self, on: bool) -> None:
        """Switches the torque on at the present position, or off."""
        await self.read_conditions()
        if on:
            for servo in self.servos.values():
                self._check_healthy(servo)
            try:
                await self.for_each(self.servos.values(), Servo.stiffen)
            except DeviceError:
                await self.check_shut_down("torque")
                raise
        else:
            await self.release_torque(COMMAND)
        await self.read_conditions()

    async def do_set_profile(self, velocity: float, acceleration: float) -> None:
        """Sets the profile of later motions; sent with every goal, so that a restart cannot lose it."""
        if not (0.0 <= velocity < math.inf and 0.0 <= acceleration < math.inf):
            raise self.error(
                f"setProfile requires finite numbers of at least 0, not {velocity:g} and {acceleration:g}"
            )
        self._check_speed("setProfile", velocity)
        self.profile = velocity, acceleration

    async def do_stop(self) -> None:
        """Stops and holds; confirmed at rest. Members without torque stay limp."""
        await self._make_safe("torque_hold")
        # The servo overshot that position while it slowed down, and would return to it.
        await self._make_safe("torque_hold")
        self.publish_readings(await self.observe())

    async def travel(self, what: str, angles: Angles) -> None:
        """Moves each servo to its angle so that all arrive together. Raises DeviceError."""
        self.check_angles(what, angles)
        await self.read_conditions()
        self.check_ready(what, POSITION_MODES)
        start = await self.observe()
        self._check_present(angles, start)
        writes = self.goals(angles, start)
        await self.send(writes, COMMAND)
        try:
            # A packet to several is not confirmed: repeat wrong goals one by one.
            await self.for_each(writes, lambda servo: self._confirm(servo, writes[servo]))
            await self._await_arrival(what, angles)
        except DeviceError:
            # The others must not go on without one that failed.
            await self.hold_answering()
            raise

    def goals(self, angles: Angles, start: Readings) -> dict[Servo, tuple[int, bytes]]:
        """The writes that send each servo to its angle; profiles are scaled for equal durations."""
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
            if any(value.alert for value in observed.values()) or not self._have_torque():
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
        stalled = ", ".join(
            f"servo {self.servos[n].joint.label} stopped {short[n]:.3f} rad short" for n in hanging
        )
        raise self.error(
            f"{what}: {stalled or 'it does not come to rest'}; something is in the way or too heavy"
        )

    # -- checks -----------------------------------------------------------------------------------------

    def check_angles(self, what: str, angles: Angles) -> None:
        """Refuses angles that are not finite, or outside the bounds of the binding or the servo."""
        for number, angle in angles.items():
            servo = self.servos[number]
            low, high = servo.joint.lowest, servo.joint.highest
            if not low - ROUNDING <= angle <= high + ROUNDING:  # refuses NaN as well
                who = f"servo {servo.joint.label}: " if len(self.servos) > 1 else ""
                raise self.error(f"{what} refused: {who}{angle:g} rad is outside {low:g} to {high:g} rad")
            least, greatest = servo.reach
            if servo.is_bounded and not least - 1e-3 <= angle <= greatest + 1e-3:
                raise self.error(
                    f"{what} refused: servo {servo.joint.label} only moves from {least:.3f} to "
                    f"{greatest:.3f} rad (its position limits), not to {angle:g}"
                )

    def check_ready(self, what: str, modes: Collection[str]) -> None:
        """Refuses an instruction that a servo would not follow, naming the call that is needed."""
        for servo in self.servos.values():
            label = servo.joint.label
            if servo.mode not in modes:
                raise self.error(
                    f"{what} requires the mode {' or '.join(modes)}; servo {label} is in {servo.mode} mode"
                )
            if servo.is_slave:
                raise self.error(
                    f"{what} refused: servo {label} is a slave (bit 1 of its drive mode) and only follows "
                    "the cable of its master; bind the master"
                )
            self._check_healthy(servo)
            now = self.conditions[servo.node.number]
            if not now.torque:
                why = f" ({now.faults})" if now.faults else ""
                raise self.error(f"{what}: the torque of servo {label} is off{why}; call torque(true) first")
            self._check_strong(what, servo)

    def _check_healthy(self, servo: Servo) -> None:
        number, label = servo.node.number, servo.joint.label
        if number in self.conflicts:
            raise self.error(self.conflicts[number])
        now = self.conditions.get(number)
        if now is None:
            raise NoAnswer(number)
        # An AX keeps reporting its fault until its torque is on again, which is the remedy.
        if now.faults and not now.torque and servo.node.protocol == 2:
            raise self.error(f"servo {label} has shut down: {now.faults}; {servo.cure}")
        if now.watchdog == WATCHDOG_FIRED:
            raise self.error(f"servo {label} was stopped by its own watchdog; call release() first")

    def _check_present(self, angles: Angles, readings: Readings) -> None:
        missing = [number for number in angles if number not in readings]
        doubled = [number for number in missing if number in self.conflicts]
        if doubled:
            raise self.error(self.conflicts[doubled[0]])
        if missing:
            names = ", ".join(f"servo {self.servos[number].joint.label}" for number in missing)
            raise self.error(f"{names} {'does' if len(missing) == 1 else 'do'} not answer", timeout=True)

    async def check_shut_down(self, what: str) -> None:
        """Fails when a servo has switched itself off meanwhile. An AX reports the reason only while it
        applies.
        """
        await self.read_conditions()
        for number, now in list(self.conditions.items()):
            servo = self.servos[number]
            if not now.torque and now.faults:
                raise self.error(
                    f"{what}: servo {servo.joint.label} has shut down: {now.faults}; {servo.cure}"
                )
            if not now.torque:
                # Another servo with its id, which is limp, may have answered.
                await self.check_for_double(servo)
                if number in self.conflicts:
                    raise self.error(self.conflicts[number])
                raise self.error(
                    f"{what}: servo {servo.joint.label} has lost its torque without a fault, as after a dip "
                    "of its supply; torque(true) restores it"
                )
            self._check_strong(what, servo)

    def _check_strong(self, what: str, servo: Servo) -> None:
        """Refuses a servo that has reduced its torque after an error."""
        now = self.conditions[servo.node.number]
        if now.weak:
            raise self.error(
                f"{what}: servo {servo.joint.label} has reduced its torque: {now.faults}; {servo.cure}"
            )

    def _have_torque(self) -> bool:
        """Whether all had torque when their conditions were last read."""
        return all(now.torque for now in self.conditions.values())

    def _check_speed(self, what: str, speed: float) -> None:
        limit = self.binding.limits.get("speed", math.inf)
        if not math.isfinite(speed):
            raise self.error(f"{what} requires a finite number, not {speed}")
        if abs(speed) > limit * ROUNDED:
            raise self.error(f"{what} of {speed:g} rad/s is above the limit of {limit:g} rad/s")
