"""Payload of a vehicle: battery, servos, relays, gripper, winch, camera and gimbal.

SI units, radians; charges in mAh.
"""

from __future__ import annotations

import math

from msgspec import Struct, field

from lfield_sim.autopilot.body.goals import Vector
from lfield_sim.autopilot.equipment.camera import CameraModel
from lfield_sim.autopilot.equipment.gimbal import GimbalModel, towards

#: Amperes: switched on, motors turning, flying.
IDLE_CURRENT, ARMED_CURRENT, FLYING_CURRENT = 0.5, 2.0, 18.0
FULL_VOLTS, EMPTY_VOLTS, RESISTANCE = 16.8, 13.2, 0.02
#: Line of the winch in metres, and its default speed.
LINE, LINE_SPEED = 20.0, 0.5
SERVOS, RELAYS = 16, 6
#: Optional payload; servos and relays are outputs of each autopilot. These hang on its outputs.
HARDWARE = frozenset({"gripper", "winch", "camera", "gimbal"})
#: Payload with MAVLink: components with ids of their own.
MAVLINK_CAMERA, MAVLINK_GIMBAL = "mavlink_camera", "mavlink_gimbal"


class Battery(Struct):
    """Four cells that drain by the vehicle's activity, and sag under load.

    `charge` is from 0 to 1, `capacity` in mAh, `current` in amperes.
    """

    charge: float = 1.0
    capacity: float = 3300.0
    current: float = IDLE_CURRENT

    @property
    def volts(self) -> float:
        """Voltage under the present load."""
        return EMPTY_VOLTS + (FULL_VOLTS - EMPTY_VOLTS) * self.charge - RESISTANCE * self.current

    @property
    def used(self) -> float:
        """Charge drawn since the battery was full, in mAh."""
        return (1.0 - self.charge) * self.capacity

    def step(self, dt: float, *, armed: bool, flying: bool, load: float = 1.0) -> None:
        """Advances time by `dt` seconds; `load` is the draw of a flight relative to still air."""
        self.current = FLYING_CURRENT * load if flying else ARMED_CURRENT if armed else IDLE_CURRENT
        self.charge = max(0.0, self.charge - self.current * dt / (self.capacity * 3.6))


class Payload(Struct):
    """The payload; `fitted` are its parts of HARDWARE, MAVLINK_CAMERA and MAVLINK_GIMBAL.

    Servos are in microseconds by number from 1, `line` is the length paid out.
    """

    fitted: frozenset[str] = HARDWARE
    servos: dict[int, int] = field(default_factory=lambda: dict.fromkeys(range(1, SERVOS + 1), 0))
    relays: dict[int, bool] = field(default_factory=lambda: dict.fromkeys(range(RELAYS), False))
    gripped: bool = False
    line: float = 0.0
    line_goal: float = 0.0
    line_speed: float = 0.0
    gimbal: GimbalModel = field(default_factory=GimbalModel)
    camera: CameraModel = field(default_factory=CameraModel)

    @property
    def has_gimbal(self) -> bool:
        """Whether the autopilot has a gimbal of either kind."""
        return not self.fitted.isdisjoint({"gimbal", MAVLINK_GIMBAL})

    def wind_by(self, length: float, speed: float) -> None:
        """Pays out (positive) or in by a length, within its line."""
        self.wind_to(self.line + length, speed)

    def wind_to(self, length: float, speed: float) -> None:
        """Pays out or in to a length of line."""
        self.line_goal = min(max(length, 0.0), LINE)
        self.line_speed = min(abs(speed) or LINE_SPEED, 5.0)

    def wind(self, speed: float) -> None:
        """Pays out (positive) or in at a speed, to the end of the line; 0 stops."""
        self.wind_to(self.line if speed == 0.0 else math.copysign(LINE, speed), speed)

    def step(self, dt: float, now: float, place: Vector, heading: float) -> None:
        """Advances time by `dt` seconds to `now`, on a vehicle at a place with a heading."""
        self.line = towards(self.line, self.line_goal, self.line_speed * dt)
        self.gimbal.step(dt, place, heading)
        self.camera.step(now)

    def restarted(self) -> Payload:
        """The payload after a restart of the autopilot: the camera is a separate computer."""
        return Payload(self.fitted, camera=self.camera)
