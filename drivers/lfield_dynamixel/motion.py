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

    async def travel(self, instruction: str, angles: Angles) -> None:
        """Moves each servo to its angle so that all arrive together. Raises DeviceError."""
        self.check_angles(instruction, angles)
        await self.read_conditions()
        self.check_ready(instruction, POSITION_MODES)
        start = await self.observe()
        self._check_present(angles, start)
        writes = self.goals(angles, start)
        await self.send(writes, COMMAND)
        try:
            # A packet to several is not confirmed: repeat wrong goals one by one.
            await self.for_each(writes, lambda servo: self._confirm(servo, writes[servo]))
            await self._await_arrival(instruction, angles)
        except DeviceError:
            # When one member has failed, the others must not continue.
            await self.hold_answering()
            raise

    def goals(self, angles: Angles, start: Readings) -> dict[Servo, tuple[int, bytes]]:
        """The writes that send each servo to its angle; profiles are scaled for equal durations."""
        distances = {number: abs(angle - start[number].position) for number, angle in angles.items()}
        longest = max(distances.values())
        speed = min([self._speed(), *(self.servos[number].top_speed for number in angles)])
        writes = {}
        for number, angle in angles.items():
            share = distances[number] / longest if longest > 0.0 else 1.0
            servo = self.servos[number]
            servo.set_pushing(False)
            servo.check_profile(distances[number], speed * share, self.profile[1] * share)
            writes[servo] = servo.motion(angle, distances[number], speed * share, self.profile[1] * share)
        return writes

    def _speed(self) -> float:
        """The speed of a profile: set by the program, within the limit of the binding."""
        return min(self.profile[0] or math.inf, self.binding.limits.get("speed", math.inf))

    async def _confirm(self, servo: Servo, write: tuple[int, bytes]) -> None:
        address, data = write
        observed = await self.chain.read(servo.node, address, len(data))
        if observed.data != data:
            await self.chain.write(servo.node, address, data)

    async def _await_arrival(self, instruction: str, angles: Angles) -> None:
        """Waits until all are at rest at their angles. Members without progress are stopped."""
        tolerance: float = self.binding.option("tolerance")
        least_distance, progress_at = math.inf, self.clock.monotonic()
        while True:
            observed = await self.observe()
            self.publish_readings(observed)
            self._check_present(angles, observed)
            if any(value.alert for value in observed.values()) or not self._have_torque():
                await self.check_shut_down(instruction)
            distances = {number: abs(angle - observed[number].position) for number, angle in angles.items()}
            if max(distances.values()) <= tolerance and all(
                abs(v.velocity) <= STILL for v in observed.values()
            ):
                return
            if sum(distances.values()) < least_distance - MIN_PROGRESS:
                least_distance, progress_at = sum(distances.values()), self.clock.monotonic()
            if self.clock.monotonic() - progress_at > STUCK_TIME:
                await self._stop_stalled(instruction, distances, tolerance, observed)
            await asyncio.sleep(POLL_INTERVAL)

    async def _stop_stalled(
        self, instruction: str, distances: Angles, tolerance: float, readings: Readings
    ) -> None:
        """Stops blocked members, which would keep pushing. Raises DeviceError."""
        await self.check_shut_down(instruction)
        stalled = [number for number, distance in distances.items() if distance > tolerance]
        await self.for_each(
            [self.servos[n] for n in stalled], lambda s: s.write_hold_goal(readings[s.node.number])
        )
        description = ", ".join(
            f"servo {self.servos[n].joint.label} stopped {distances[n]:.3f} rad short" for n in stalled
        )
        raise self.error(
            f"{instruction}: {description or 'it does not come to rest'}; "
            "an obstacle blocks it, or its load is too heavy"
        )

    # -- checks -----------------------------------------------------------------------------------------

    def check_angles(self, instruction: str, angles: Angles) -> None:
        """Refuses angles that are not finite, or outside the bounds of the binding or the servo."""
        for number, angle in angles.items():
            servo = self.servos[number]
            low, high = servo.joint.lowest, servo.joint.highest
            if not low - ROUNDING <= angle <= high + ROUNDING:  # refuses NaN as well
                subject = f"servo {servo.joint.label}: " if len(self.servos) > 1 else ""
                raise self.error(
                    f"{instruction} refused: {subject}{angle:g} rad is outside {low:g} to {high:g} rad"
                )
            minimum, maximum = servo.reach
            if servo.is_bounded and not minimum - 1e-3 <= angle <= maximum + 1e-3:
                raise self.error(
                    f"{instruction} refused: servo {servo.joint.label} only moves from {minimum:.3f} to "
                    f"{maximum:.3f} rad (its position limits), not to {angle:g}"
                )

    def check_ready(self, instruction: str, modes: Collection[str]) -> None:
        """Refuses an instruction that a servo would not follow, naming the call that is needed."""
        for servo in self.servos.values():
            label = servo.joint.label
            if servo.mode not in modes:
                raise self.error(
                    f"{instruction} requires the mode {' or '.join(modes)}; "
                    f"servo {label} is in {servo.mode} mode"
                )
            if servo.is_slave:
                raise self.error(
                    f"{instruction} refused: servo {label} is a slave (bit 1 of its drive mode) and only "
                    "follows the cable of its master; bind the master"
                )
            self._check_healthy(servo)
            condition = self.conditions[servo.node.number]
            if not condition.torque:
                cause = f" ({condition.faults})" if condition.faults else ""
                raise self.error(
                    f"{instruction}: the torque of servo {label} is off{cause}; call torque(true) first"
                )
            self._check_full_torque(instruction, servo)

    def _check_healthy(self, servo: Servo) -> None:
        number, label = servo.node.number, servo.joint.label
        if number in self.conflicts:
            raise self.error(self.conflicts[number])
        condition = self.conditions.get(number)
        if condition is None:
            raise NoAnswer(number)
        # An AX keeps reporting its fault until its torque is on again, which is the remedy.
        if condition.faults and not condition.torque and servo.node.protocol == 2:
            raise self.error(f"servo {label} has shut down: {condition.faults}; {servo.remedy}")
        if condition.watchdog == WATCHDOG_FIRED:
            raise self.error(f"servo {label} was stopped by its own watchdog; call release() first")

    def _check_present(self, angles: Angles, readings: Readings) -> None:
        missing = [number for number in angles if number not in readings]
        doubled = [number for number in missing if number in self.conflicts]
        if doubled:
            raise self.error(self.conflicts[doubled[0]])
        if missing:
            names = ", ".join(f"servo {self.servos[number].joint.label}" for number in missing)
            raise self.error(f"{names} {'does' if len(missing) == 1 else 'do'} not answer", timeout=True)

    async def check_shut_down(self, instruction: str) -> None:
        """Fails when a servo has switched itself off meanwhile. An AX reports the reason only while it
        applies.
        """
        await self.read_conditions()
        for number, condition in list(self.conditions.items()):
            servo = self.servos[number]
            if not condition.torque and condition.faults:
                label = servo.joint.label
                raise self.error(
                    f"{instruction}: servo {label} has shut down: {condition.faults}; {servo.remedy}"
                )
            if not condition.torque:
                # A second servo with the same id and without torque may have answered.
                await self.check_for_double(servo)
                if number in self.conflicts:
                    raise self.error(self.conflicts[number])
                raise self.error(
                    f"{instruction}: servo {servo.joint.label} has lost its torque without a fault, as after "
                    "a drop of its supply voltage; torque(true) restores it"
                )
            self._check_full_torque(instruction, servo)

    def _check_full_torque(self, instruction: str, servo: Servo) -> None:
        """Refuses a servo that has reduced its torque after an error."""
        condition = self.conditions[servo.node.number]
        if condition.weak:
            label = servo.joint.label
            raise self.error(
                f"{instruction}: servo {label} has reduced its torque: {condition.faults}; {servo.remedy}"
            )

    def _have_torque(self) -> bool:
        """Whether all had torque when their conditions were last read."""
        return all(condition.torque for condition in self.conditions.values())

    def _check_speed(self, instruction: str, speed: float) -> None:
        limit = self.binding.limits.get("speed", math.inf)
        if not math.isfinite(speed):
            raise self.error(f"{instruction} requires a finite number, not {speed}")
        if abs(speed) > limit * ROUNDED:
            raise self.error(f"{instruction} of {speed:g} rad/s is above the limit of {limit:g} rad/s")
