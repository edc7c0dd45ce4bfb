"""Attitudes of a gimbal and its manager as in the gimbal protocol v2: frames, ranges, directions. Pure."""

from __future__ import annotations

import math
from typing import Any

from msgspec import Struct

from lfield_mavlink.geodesy import Vector
from lfield_mavlink.link.dialect import dialect

#: Margin of a range in radians: its ends are reported in single precision.
MARGIN = 1e-3
#: The largest id of a gimbal that has no component id of its own.
MOST_ATTACHED = 6


class GimbalManager(Struct, frozen=True):
    """A gimbal manager by its component id, with its gimbal and the ranges of that, in radians.

    `device` is the id of the gimbal: 1 to 6 without MAVLink, else its component id.
    """

    component: int
    device: int
    pitch: tuple[float, float]
    yaw: tuple[float, float]

    @classmethod
    def from_message(cls, message: Any) -> GimbalManager:
        """The manager described by GIMBAL_MANAGER_INFORMATION."""
        return cls(
            message.get_srcComponent(),
            message.gimbal_device_id,
            (message.pitch_min, message.pitch_max),
            (message.yaw_min, message.yaw_max),
        )

    @property
    def reporter(self) -> int:
        """The component that reports the attitude."""
        return self.component if self.device <= MOST_ATTACHED else self.device

    def excess_reason(self, pitch: float, yaw: float) -> str:
        """The angle that is out of range, in words; '' for none. A range without a width is unknown."""
        for name, angle, (minimum, maximum) in (("pitch", pitch, self.pitch), ("yaw", yaw, self.yaw)):
            if minimum < maximum and not minimum - MARGIN <= angle <= maximum + MARGIN:
                return f"a {name} of {angle:.2f} is outside its range of {minimum:.2f} to {maximum:.2f} rad"
        return ""


class GimbalAttitude(Struct, frozen=True):
    """Roll, pitch above the horizon and yaw clockwise from the nose, in radians."""

    roll: float
    pitch: float
    yaw: float

    @classmethod
    def from_message(cls, message: Any, heading: float) -> GimbalAttitude | None:
        """The attitude in GIMBAL_DEVICE_ATTITUDE_STATUS; None for an unknown attitude.

        Flags define whether its yaw is from north or from the nose; without them, the lock of its yaw does.
        """
        if not all(map(math.isfinite, message.q)):
            return None
        w, x, y, z = message.q
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = math.asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x))))
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        if _is_from_north(message.flags):
            yaw = math.remainder(yaw - heading, math.tau)
        return cls(roll, pitch, yaw)

    def deviation(self, pitch: float, yaw: float) -> float:
        """The distance from a direction: the larger of both differences."""
        return max(abs(self.pitch - pitch), abs(math.remainder(self.yaw - yaw, math.tau)))


def direction(vector: Vector) -> tuple[float, float]:
    """Pitch above the horizon and heading clockwise from north of a vector north, east, down."""
    north, east, down = vector
    return math.atan2(-down, math.hypot(north, east)), math.atan2(east, north)


def _is_from_north(flags: int) -> bool:
    if flags & dialect.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME:
        return True
    if flags & dialect.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME:
        return False
    return bool(flags & dialect.GIMBAL_DEVICE_FLAGS_YAW_LOCK)
