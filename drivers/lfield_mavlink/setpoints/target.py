"""One setpoint, as data, and its message."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lfield_mavlink.geo import Vector
from lfield_mavlink.link.dialect import AUTOPILOT, dialect

# type_mask of SET_POSITION_TARGET_LOCAL_NED: everything ignored but what the name says.
ONLY_POSITION, ONLY_VELOCITY, VELOCITY_AND_YAW_RATE, ONLY_YAW = 0x0DF8, 0x0DC7, 0x05C7, 0x09FF
POSITION_AND_YAW = 0x09F8


@dataclass(frozen=True, slots=True)
class Target:
    """A setpoint in metres of home and m/s; `mask` says what counts."""

    mask: int
    place: Vector = (0.0, 0.0, 0.0)
    velocity: Vector = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    yaw_rate: float = 0.0

    def message(self, system: int, home: Vector) -> Any:
        """SET_POSITION_TARGET_LOCAL_NED for a system; `home` is in its local frame, in metres."""
        place = (mine + h for mine, h in zip(self.place, home, strict=True))
        frame, acceleration = dialect.MAV_FRAME_LOCAL_NED, (0.0, 0.0, 0.0)
        return dialect.MAVLink_set_position_target_local_ned_message(
            0, system, AUTOPILOT, frame, self.mask, *place, *self.velocity, *acceleration,
            self.yaw, self.yaw_rate,
        )  # fmt: skip
