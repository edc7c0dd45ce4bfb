"""Modes of operation of a CiA 402 drive (0x6060).

Simplified: homing either stays (methods 35 and 37) or moves to the home switch (all others); the cyclic modes
move to each target as fast as the limits allow, without interpolation.
"""

from __future__ import annotations

from collections.abc import Mapping

from lfield_sim.can.cia402 import cia402_table
from lfield_sim.can.cia402.cia402_drive import Cia402Drive

#: Bits of the statusword, and of the controlword, with a mode-specific meaning.
REACHED, LIMITED, SPECIFIC, ERROR = 1 << 10, 1 << 11, 1 << 12, 1 << 13
_START, _AT_ONCE, _RELATIVE = 1 << 4, 1 << 5, 1 << 6


class OperationMode:
    """No mode: the motor holds its position. Subclasses override parts of it."""

    code = 0

    def start(self, drive: Cia402Drive) -> None:
        """Starts the mode."""

    def control(self, drive: Cia402Drive, rising: int) -> None:
        """Handles a received controlword; `rising` are the newly set bits."""

    def step(self, drive: Cia402Drive, dt: float) -> None:
        """Moves the reference and the motor."""
        drive.brake(dt, deceleration=drive.objects.get(0x6084))

    def status(self, drive: Cia402Drive) -> int:
        """Bits 10 to 13 of the statusword."""
        return 0


class _Settled:
    """Whether a value has been within a window for a time."""

    def __init__(self) -> None:
        self._duration = 0.0

    def step(self, is_near: bool, dt: float) -> None:
        self._duration = self._duration + dt if is_near else 0.0

    def has_lasted(self, milliseconds: int) -> bool:
        return self._duration > 0.0 and self._duration >= milliseconds / 1000.0


class ProfilePosition(OperationMode):
    """Trapezoids to set-points; one more may be queued. Bit 12 acknowledges one until bit 4 is cleared."""

    code = cia402_table.PP

    def start(self, drive: Cia402Drive) -> None:
        self._target: float | None = None
        self._next: float | None = None
        self._requested = 0.0
        self._acknowledged = False
        self._settled = _Settled()

    def control(self, drive: Cia402Drive, rising: int) -> None:
        if rising & _START:
            self._set_point(drive)
        elif not drive.controlword & _START and self._next is None:
            self._acknowledged = False

    def step(self, drive: Cia402Drive, dt: float) -> None:
        objects = drive.objects
        if drive.halted or self._target is None:
            drive.halt(dt)
            self._settled.step(drive.profile.velocity == 0.0, dt)
            return
        drive.profile.to_position(
            self._target,
            speed=min(objects.get(0x6081), drive.fastest),
            acceleration=objects.get(0x6083),
            deceleration=objects.get(0x6084),
            dt=dt,
        )
        drive.follow(dt)
        is_near = abs(self._target - drive.position) <= objects.get(0x6067)
        self._settled.step(is_near and drive.profile.position == self._target, dt)
        if self._next is not None and self._settled.has_lasted(objects.get(0x6068)):
            self._target, self._next = self._next, None
            self._acknowledged = bool(drive.controlword & _START)
            self._settled = _Settled()

    def status(self, drive: Cia402Drive) -> int:
        reached = self._next is None and self._settled.has_lasted(drive.objects.get(0x6068))
        limited = self._target is not None and self._target != self._requested
        return REACHED * reached | LIMITED * limited | SPECIFIC * self._acknowledged

    def _set_point(self, drive: Cia402Drive) -> None:
        start = drive.position if self._target is None else self._target
        self._requested = drive.objects.get(0x607A) + (start if drive.controlword & _RELATIVE else 0.0)
        target = drive.within(self._requested)
        moving = self._target is not None and not self._settled.has_lasted(drive.objects.get(0x6068))
        if moving and not drive.controlword & _AT_ONCE:
            if self._next is not None:
                return
            self._next = target
        else:
            self._target, self._next, self._settled = target, None, _Settled()
        self._acknowledged = True


class ProfileVelocity(OperationMode):
    """Ramps to the target velocity (0x60FF). Bit 12: the motor is at rest."""

    code = cia402_table.PV

    def start(self, drive: Cia402Drive) -> None:
        self._settled, self._target = _Settled(), 0.0

    def step(self, drive: Cia402Drive, dt: float) -> None:
        objects = drive.objects
        self._target = 0.0 if drive.halted else _bounded(objects.get(0x60FF), drive)
        if drive.halted:
            drive.halt(dt)
        else:
            deceleration = objects.get(0x6084)
            drive.ramp(self._target, dt, acceleration=objects.get(0x6083), deceleration=deceleration)
        is_near = abs(self._target - drive.velocity) <= max(objects.get(0x606D), 1)
        self._settled.step(is_near, dt)

    def status(self, drive: Cia402Drive) -> int:
        reached = self._settled.has_lasted(drive.objects.get(0x606E))
        limited = not drive.halted and self._target != drive.objects.get(0x60FF)
        still = abs(drive.velocity) <= drive.objects.get(0x606D)
        return REACHED * reached | LIMITED * limited | SPECIFIC * still


class ProfileTorque(OperationMode):
    """Ramps to the target torque (0x6071) with the slope (0x6087), within the speed limit."""

    code = cia402_table.PT
    slope: float | None = None

    def start(self, drive: Cia402Drive) -> None:
        drive.torque_demand = 0.0

    def step(self, drive: Cia402Drive, dt: float) -> None:
        if drive.halted:
            # A torque of 0 would let the motor coast.
            drive.halt(dt)
            drive.torque_demand = 0.0
            return
        objects, rated = drive.objects, drive.motor.data.rated_torque
        target = (objects.get(0x6071) + objects.get(0x60B2)) / 1000.0 * rated
        target = max(-drive.strongest, min(drive.strongest, target))
        max_change = self._slope(drive) * dt
        drive.torque_demand += max(-max_change, min(max_change, target - drive.torque_demand))
        if abs(drive.velocity) >= drive.fastest and drive.velocity * drive.torque_demand > 0.0:
            drive.motor.track(drive.motor.speed, dt, abs(drive.torque_demand))
        else:
            drive.motor.drive(drive.torque_demand, dt)
        drive.profile.position, drive.profile.velocity = drive.position, drive.velocity

    def status(self, drive: Cia402Drive) -> int:
        target = 0 if drive.halted else drive.objects.get(0x6071)
        reached = abs(1000.0 * drive.torque_demand / drive.motor.data.rated_torque - target) < 1.0
        return REACHED * reached

    def _slope(self, drive: Cia402Drive) -> float:
        return drive.objects.get(0x6087) / 1000.0 * drive.motor.data.rated_torque


class Homing(OperationMode):
    """Homes the drive: bit 4 starts it; bit 12: home found, bit 13: homing error."""

    code = cia402_table.HM

    def start(self, drive: Cia402Drive) -> None:
        self._running = self._attained = self._failed = False

    def control(self, drive: Cia402Drive, rising: int) -> None:
        if rising & _START:
            method = drive.objects.get(0x6098)
            self._attained, self._failed = False, method == 0
            self._running = method != 0
            if method in cia402_table.HOME_HERE:
                self._arrive(drive)
        elif not drive.controlword & _START:
            self._running = False

    def step(self, drive: Cia402Drive, dt: float) -> None:
        if not self._running or drive.halted:
            drive.halt(dt)
            return
        home = drive.home_position
        drive.profile.to_position(
            home,
            speed=min(drive.objects.get(0x6099, 1), drive.fastest),
            acceleration=drive.objects.get(0x609A),
            deceleration=drive.objects.get(0x609A),
            dt=dt,
        )
        drive.follow(dt)
        if drive.profile.position == home and abs(drive.position - home) <= drive.objects.get(0x6067):
            self._arrive(drive)

    def status(self, drive: Cia402Drive) -> int:
        still = abs(drive.velocity) <= drive.objects.get(0x606D) and not self._running
        return REACHED * still | SPECIFIC * self._attained | ERROR * self._failed

    def _arrive(self, drive: Cia402Drive) -> None:
        drive.set_position(drive.objects.get(0x607C))
        self._running, self._attained = False, True


class CyclicPosition(OperationMode):
    """Follows the target position (0x607A)."""

    code = cia402_table.CSP

    def step(self, drive: Cia402Drive, dt: float) -> None:
        objects = drive.objects
        drive.profile.to_position(
            drive.within(objects.get(0x607A)),
            speed=drive.fastest,
            acceleration=objects.get(0x60C5),
            deceleration=objects.get(0x60C6),
            dt=dt,
        )
        drive.follow(dt)

    def status(self, drive: Cia402Drive) -> int:
        """Bit 12: the drive follows."""
        return SPECIFIC


class CyclicVelocity(OperationMode):
    """Follows the target velocity (0x60FF) with its offset (0x60B1)."""

    code = cia402_table.CSV

    def step(self, drive: Cia402Drive, dt: float) -> None:
        target = _bounded(drive.objects.get(0x60FF) + drive.objects.get(0x60B1), drive)
        objects = drive.objects
        drive.ramp(target, dt, acceleration=objects.get(0x60C5), deceleration=objects.get(0x60C6))

    def status(self, drive: Cia402Drive) -> int:
        """Bit 12: the drive follows."""
        return SPECIFIC


class CyclicTorque(ProfileTorque):
    """Follows the target torque (0x6071) with its offset (0x60B2)."""

    code = cia402_table.CST

    def status(self, drive: Cia402Drive) -> int:
        """Bit 12: the drive follows."""
        return SPECIFIC

    def _slope(self, drive: Cia402Drive) -> float:
        return float("inf")


def _bounded(velocity: float, drive: Cia402Drive) -> float:
    """A velocity within the speed limit, and 0 for one that leaves the software limits."""
    inside = drive.within(drive.position)
    if (drive.position - inside) * velocity > 0.0:
        return 0.0
    return max(-drive.fastest, min(drive.fastest, velocity))


MODES: Mapping[int, type[OperationMode]] = {
    mode.code: mode
    for mode in (
        OperationMode,
        ProfilePosition,
        ProfileVelocity,
        ProfileTorque,
        Homing,
        CyclicPosition,
        CyclicVelocity,
        CyclicTorque,
    )
}
