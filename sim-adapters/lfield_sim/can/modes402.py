"""The modes of operation of a CiA 402 drive (0x6060): what the axis does while operation is enabled.

Simplified: homing knows two ways, to stay (methods 35 and 37) and to travel to the home switch (all others);
the cyclic modes move towards each target as fast as the limits allow, without interpolating between them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from lfield_sim.can import objects402 as numbers

if TYPE_CHECKING:
    from lfield_sim.can.axis402 import Axis

#: Bits of the statusword, and of the controlword, that a mode gives its meaning.
REACHED, LIMITED, SPECIFIC, ERROR = 1 << 10, 1 << 11, 1 << 12, 1 << 13
_START, _AT_ONCE, _RELATIVE = 1 << 4, 1 << 5, 1 << 6


class Mode:
    """No mode: the motor is held where it is. The others override what they do otherwise."""

    code = 0

    def begin(self, axis: Axis) -> None:
        """Take over."""

    def control(self, axis: Axis, rising: int) -> None:
        """A controlword came; `rising` are the bits that were not set before."""

    def step(self, axis: Axis, dt: float) -> None:
        """Move the reference, and the motor after it."""
        axis.brake(dt, deceleration=axis.objects.get(0x6084))

    def status(self, axis: Axis) -> int:
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

    code = numbers.PP

    def begin(self, axis: Axis) -> None:
        self._target: float | None = None
        self._next: float | None = None
        self._asked = 0.0
        self._acknowledged = False
        self._settled = _Settled()

    def control(self, axis: Axis, rising: int) -> None:
        if rising & _START:
            self._set_point(axis)
        elif not axis.word & _START and self._next is None:
            self._acknowledged = False

    def step(self, axis: Axis, dt: float) -> None:
        objects = axis.objects
        if axis.halted or self._target is None:
            axis.brake(dt, deceleration=objects.get(0x6084))
            self._settled.step(axis.profile.velocity == 0.0, dt)
            return
        axis.profile.to_position(
            self._target,
            speed=min(objects.get(0x6081), axis.fastest),
            acceleration=objects.get(0x6083),
            deceleration=objects.get(0x6084),
            dt=dt,
        )
        axis.follow(dt)
        near = abs(self._target - axis.position) <= objects.get(0x6067)
        self._settled.step(near and axis.profile.position == self._target, dt)
        if self._next is not None and self._settled.since(objects.get(0x6068)):
            self._target, self._next = self._next, None
            self._acknowledged = bool(axis.word & _START)
            self._settled = _Settled()

    def status(self, axis: Axis) -> int:
        reached = self._next is None and self._settled.since(axis.objects.get(0x6068))
        limited = self._target is not None and self._target != self._asked
        return REACHED * reached | LIMITED * limited | SPECIFIC * self._acknowledged

    def _set_point(self, axis: Axis) -> None:
        start = axis.position if self._target is None else self._target
        self._asked = axis.objects.get(0x607A) + (start if axis.word & _RELATIVE else 0.0)
        target = axis.within(self._asked)
        moving = self._target is not None and not self._settled.since(axis.objects.get(0x6068))
        if moving and not axis.word & _AT_ONCE:
            if self._next is not None:
                return
            self._next = target
        else:
            self._target, self._next, self._settled = target, None, _Settled()
        self._acknowledged = True


class ProfileVelocity(Mode):
    """Ramps to the target velocity (0x60FF). Bit 12 tells that it stands."""

    code = numbers.PV

    def begin(self, axis: Axis) -> None:
        self._settled, self._wanted = _Settled(), 0.0

    def step(self, axis: Axis, dt: float) -> None:
        objects = axis.objects
        self._wanted = 0.0 if axis.halted else _bounded(objects.get(0x60FF), axis)
        axis.ramp(self._wanted, dt, acceleration=objects.get(0x6083), deceleration=objects.get(0x6084))
        near = abs(self._wanted - axis.velocity) <= max(objects.get(0x606D), 1)
        self._settled.step(near, dt)

    def status(self, axis: Axis) -> int:
        reached = self._settled.since(axis.objects.get(0x606E))
        limited = not axis.halted and self._wanted != axis.objects.get(0x60FF)
        still = abs(axis.velocity) <= axis.objects.get(0x606D)
        return REACHED * reached | LIMITED * limited | SPECIFIC * still


class ProfileTorque(Mode):
    """Ramps to the target torque (0x6071) by the slope (0x6087), at most at the bound of the speed."""

    code = numbers.PT
    slope: float | None = None

    def begin(self, axis: Axis) -> None:
        axis.torque_demand = 0.0

    def step(self, axis: Axis, dt: float) -> None:
        objects, rated = axis.objects, axis.motor.data.rated_torque
        wanted = 0.0 if axis.halted else (objects.get(0x6071) + objects.get(0x60B2)) / 1000.0 * rated
        wanted = max(-axis.strongest, min(axis.strongest, wanted))
        most = self._slope(axis) * dt
        axis.torque_demand += max(-most, min(most, wanted - axis.torque_demand))
        if abs(axis.velocity) >= axis.fastest and axis.velocity * axis.torque_demand > 0.0:
            axis.motor.track(axis.motor.speed, dt, abs(axis.torque_demand))
        else:
            axis.motor.drive(axis.torque_demand, dt)
        axis.profile.position, axis.profile.velocity = axis.position, axis.velocity

    def status(self, axis: Axis) -> int:
        wanted = 0 if axis.halted else axis.objects.get(0x6071)
        reached = abs(1000.0 * axis.torque_demand / axis.motor.data.rated_torque - wanted) < 1.0
        return REACHED * reached

    def _slope(self, axis: Axis) -> float:
        return axis.objects.get(0x6087) / 1000.0 * axis.motor.data.rated_torque


class Homing(Mode):
    """Bit 4 starts it; bit 12 tells that the home is found, bit 13 that homing cannot be done."""

    code = numbers.HM

    def begin(self, axis: Axis) -> None:
        self._running = self._attained = self._failed = False

    def control(self, axis: Axis, rising: int) -> None:
        if rising & _START:
            method = axis.objects.get(0x6098)
            self._attained, self._failed = False, method == 0
            self._running = method != 0
            if method in numbers.HERE:
                self._arrive(axis)
        elif not axis.word & _START:
            self._running = False

    def step(self, axis: Axis, dt: float) -> None:
        if not self._running or axis.halted:
            axis.brake(dt, deceleration=axis.objects.get(0x609A))
            return
        home = axis.home_position
        axis.profile.to_position(
            home,
            speed=min(axis.objects.get(0x6099, 1), axis.fastest),
            acceleration=axis.objects.get(0x609A),
            deceleration=axis.objects.get(0x609A),
            dt=dt,
        )
        axis.follow(dt)
        if axis.profile.position == home and abs(axis.position - home) <= axis.objects.get(0x6067):
            self._arrive(axis)

    def status(self, axis: Axis) -> int:
        still = abs(axis.velocity) <= axis.objects.get(0x606D) and not self._running
        return REACHED * still | SPECIFIC * self._attained | ERROR * self._failed

    def _arrive(self, axis: Axis) -> None:
        axis.set_position(axis.objects.get(0x607C))
        self._running, self._attained = False, True


class CyclicPosition(Mode):
    """Follows the target position (0x607A) as it comes."""

    code = numbers.CSP

    def step(self, axis: Axis, dt: float) -> None:
        objects = axis.objects
        axis.profile.to_position(
            axis.within(objects.get(0x607A)),
            speed=axis.fastest,
            acceleration=objects.get(0x60C5),
            deceleration=objects.get(0x60C6),
            dt=dt,
        )
        axis.follow(dt)

    def status(self, axis: Axis) -> int:
        """Bit 12: the drive follows."""
        return SPECIFIC


class CyclicVelocity(Mode):
    """Follows the target velocity (0x60FF) with its offset (0x60B1)."""

    code = numbers.CSV

    def step(self, axis: Axis, dt: float) -> None:
        wanted = _bounded(axis.objects.get(0x60FF) + axis.objects.get(0x60B1), axis)
        objects = axis.objects
        axis.ramp(wanted, dt, acceleration=objects.get(0x60C5), deceleration=objects.get(0x60C6))

    def status(self, axis: Axis) -> int:
        """Bit 12: the drive follows."""
        return SPECIFIC


class CyclicTorque(ProfileTorque):
    """Follows the target torque (0x6071) with its offset (0x60B2) at once."""

    code = numbers.CST

    def status(self, axis: Axis) -> int:
        """Bit 12: the drive follows."""
        return SPECIFIC

    def _slope(self, axis: Axis) -> float:
        return float("inf")


def _bounded(velocity: float, axis: Axis) -> float:
    """A velocity within the bound of the speed, and 0 for one that leads out of the software limits."""
    inside = axis.within(axis.position)
    if (axis.position - inside) * velocity > 0.0:
        return 0.0
    return max(-axis.fastest, min(axis.fastest, velocity))


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
