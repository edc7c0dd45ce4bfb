"""The modes of operation of a CiA 402 drive (0x6060): what the drive does while operation is enabled.

Simplified: homing knows two ways, to stay (methods 35 and 37) and to travel to the home switch (all others);
the cyclic modes move towards each target as fast as the limits allow, without interpolating between them.
"""

from __future__ import annotations

from collections.abc import Mapping

from lfield_sim.can.cia402 import table
from lfield_sim.can.cia402.drive import Drive

#: Bits of the statusword, and of the controlword, that a mode gives its meaning.
REACHED, LIMITED, SPECIFIC, ERROR = 1 << 10, 1 << 11, 1 << 12, 1 << 13
_START, _AT_ONCE, _RELATIVE = 1 << 4, 1 << 5, 1 << 6


class Mode:
    """No mode: the motor is held where it is. The others override what they do otherwise."""

    code = 0

    def begin(self, drive: Drive) -> None:
        """Take over."""

    def control(self, drive: Drive, rising: int) -> None:
        """A controlword came; `rising` are the bits that were not set before."""

    def step(self, drive: Drive, dt: float) -> None:
        """Move the reference, and the motor after it."""
        drive.brake(dt, deceleration=drive.objects.get(0x6084))

    def status(self, drive: Drive) -> int:
        """Bits 10 to 13 of the statusword."""
        return 0


class _Settled:
    """Whether a value has been within a window for a time."""

    def __init__(self) -> None:
        self._for = 0.0

    def step(self, near: bool, dt: float) -> None:
        self._for = self._for + dt if near else 0.0

    def since(self, milliseconds: int) -> bool:
        return self._for > 0.0 and self._for >= milliseconds / 1000.0


class ProfilePosition(Mode):
    """Trapezoids to set-points; one more may wait. Bit 12 acknowledges one until bit 4 is taken back."""

    code = table.PP

    def begin(self, drive: Drive) -> None:
        self._target: float | None = None
        self._next: float | None = None
        self._asked = 0.0
        self._acknowledged = False
        self._settled = _Settled()

    def control(self, drive: Drive, rising: int) -> None:
        if rising & _START:
            self._set_point(drive)
        elif not drive.word & _START and self._next is None:
            self._acknowledged = False

    def step(self, drive: Drive, dt: float) -> None:
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
        near = abs(self._target - drive.position) <= objects.get(0x6067)
        self._settled.step(near and drive.profile.position == self._target, dt)
        if self._next is not None and self._settled.since(objects.get(0x6068)):
            self._target, self._next = self._next, None
            self._acknowledged = bool(drive.word & _START)
            self._settled = _Settled()

    def status(self, drive: Drive) -> int:
        reached = self._next is None and self._settled.since(drive.objects.get(0x6068))
        limited = self._target is not None and self._target != self._asked
        return REACHED * reached | LIMITED * limited | SPECIFIC * self._acknowledged

    def _set_point(self, drive: Drive) -> None:
        start = drive.position if self._target is None else self._target
        self._asked = drive.objects.get(0x607A) + (start if drive.word & _RELATIVE else 0.0)
        target = drive.within(self._asked)
        moving = self._target is not None and not self._settled.since(drive.objects.get(0x6068))
        if moving and not drive.word & _AT_ONCE:
            if self._next is not None:
                return
            self._next = target
        else:
            self._target, self._next, self._settled = target, None, _Settled()
        self._acknowledged = True


class ProfileVelocity(Mode):
    """Ramps to the target velocity (0x60FF). Bit 12 tells that it stands."""

    code = table.PV

    def begin(self, drive: Drive) -> None:
        self._settled, self._wanted = _Settled(), 0.0

    def step(self, drive: Drive, dt: float) -> None:
        objects = drive.objects
        self._wanted = 0.0 if drive.halted else _bounded(objects.get(0x60FF), drive)
        if drive.halted:
            drive.halt(dt)
        else:
            slower = objects.get(0x6084)
            drive.ramp(self._wanted, dt, acceleration=objects.get(0x6083), deceleration=slower)
        near = abs(self._wanted - drive.velocity) <= max(objects.get(0x606D), 1)
        self._settled.step(near, dt)

    def status(self, drive: Drive) -> int:
        reached = self._settled.since(drive.objects.get(0x606E))
        limited = not drive.halted and self._wanted != drive.objects.get(0x60FF)
        still = abs(drive.velocity) <= drive.objects.get(0x606D)
        return REACHED * reached | LIMITED * limited | SPECIFIC * still


class ProfileTorque(Mode):
    """Ramps to the target torque (0x6071) by the slope (0x6087), at most at the bound of the speed."""

    code = table.PT
    slope: float | None = None

    def begin(self, drive: Drive) -> None:
        drive.torque_demand = 0.0

    def step(self, drive: Drive, dt: float) -> None:
        if drive.halted:
            # Not by a torque of 0: it would run out.
            drive.halt(dt)
            drive.torque_demand = 0.0
            return
        objects, rated = drive.objects, drive.motor.data.rated_torque
        wanted = (objects.get(0x6071) + objects.get(0x60B2)) / 1000.0 * rated
        wanted = max(-drive.strongest, min(drive.strongest, wanted))
        most = self._slope(drive) * dt
        drive.torque_demand += max(-most, min(most, wanted - drive.torque_demand))
        if abs(drive.velocity) >= drive.fastest and drive.velocity * drive.torque_demand > 0.0:
            drive.motor.track(drive.motor.speed, dt, abs(drive.torque_demand))
        else:
            drive.motor.drive(drive.torque_demand, dt)
        drive.profile.position, drive.profile.velocity = drive.position, drive.velocity

    def status(self, drive: Drive) -> int:
        wanted = 0 if drive.halted else drive.objects.get(0x6071)
        reached = abs(1000.0 * drive.torque_demand / drive.motor.data.rated_torque - wanted) < 1.0
        return REACHED * reached

    def _slope(self, drive: Drive) -> float:
        return drive.objects.get(0x6087) / 1000.0 * drive.motor.data.rated_torque


class Homing(Mode):
    """Bit 4 starts it; bit 12 tells that the home is found, bit 13 that homing cannot be done."""

    code = table.HM

    def begin(self, drive: Drive) -> None:
        self._running = self._attained = self._failed = False

    def control(self, drive: Drive, rising: int) -> None:
        if rising & _START:
            method = drive.objects.get(0x6098)
            self._attained, self._failed = False, method == 0
            self._running = method != 0
            if method in table.HERE:
                self._arrive(drive)
        elif not drive.word & _START:
            self._running = False

    def step(self, drive: Drive, dt: float) -> None:
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

    def status(self, drive: Drive) -> int:
        still = abs(drive.velocity) <= drive.objects.get(0x606D) and not self._running
        return REACHED * still | SPECIFIC * self._attained | ERROR * self._failed

    def _arrive(self, drive: Drive) -> None:
        drive.set_position(drive.objects.get(0x607C))
        self._running, self._attained = False, True


class CyclicPosition(Mode):
    """Follows the target position (0x607A) as it comes."""

    code = table.CSP

    def step(self, drive: Drive, dt: float) -> None:
        objects = drive.objects
        drive.profile.to_position(
            drive.within(objects.get(0x607A)),
            speed=drive.fastest,
            acceleration=objects.get(0x60C5),
            deceleration=objects.get(0x60C6),
            dt=dt,
        )
        drive.follow(dt)

    def status(self, drive: Drive) -> int:
        """Bit 12: the drive follows."""
        return SPECIFIC


class CyclicVelocity(Mode):
    """Follows the target velocity (0x60FF) with its offset (0x60B1)."""

    code = table.CSV

    def step(self, drive: Drive, dt: float) -> None:
        wanted = _bounded(drive.objects.get(0x60FF) + drive.objects.get(0x60B1), drive)
        objects = drive.objects
        drive.ramp(wanted, dt, acceleration=objects.get(0x60C5), deceleration=objects.get(0x60C6))

    def status(self, drive: Drive) -> int:
        """Bit 12: the drive follows."""
        return SPECIFIC


class CyclicTorque(ProfileTorque):
    """Follows the target torque (0x6071) with its offset (0x60B2) at once."""

    code = table.CST

    def status(self, drive: Drive) -> int:
        """Bit 12: the drive follows."""
        return SPECIFIC

    def _slope(self, drive: Drive) -> float:
        return float("inf")


def _bounded(velocity: float, drive: Drive) -> float:
    """A velocity within the bound of the speed, and 0 for one that leads out of the software limits."""
    inside = drive.within(drive.position)
    if (drive.position - inside) * velocity > 0.0:
        return 0.0
    return max(-drive.fastest, min(drive.fastest, velocity))


MODES: Mapping[int, type[Mode]] = {
    mode.code: mode
    for mode in (
        Mode,
        ProfilePosition,
        ProfileVelocity,
        ProfileTorque,
        Homing,
        CyclicPosition,
        CyclicVelocity,
        CyclicTorque,
    )
}
