"""What is known of a vehicle from its telemetry. Pure: messages and times in, telemetry values out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from lfield_mavlink.dialect import dialect
from lfield_mavlink.modes import Kind

EARTH_RADIUS = 6378137.0

Vector = tuple[float, float, float]
Place = tuple[int, int, int]  # latitude and longitude in 1e-7 degrees, altitude in mm

#: The streams we ask for: message id -> Hz. ArduPilot sends nothing but heartbeats unasked. The heartbeat
#: itself is wanted faster than its 1 Hz, since modes and arming are confirmed by it.
STREAMS: Mapping[int, float] = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 5.0,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    dialect.MAVLINK_MSG_ID_ATTITUDE: 10.0,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
}


class VehicleState:
    """The newest of everything; None is "not heard yet".

    Positions are metres of *home*: the autopilot reports and takes them about the origin of its estimator,
    which is where it first knew its place, while home moves to where it was armed last.
    """

    def __init__(self, kind: Kind) -> None:
        self.kind = kind
        self.heard: float | None = None
        self.autopilot = -1
        self.type = -1
        self.mode = ""
        self.armed = False
        self.landed: bool | None = None
        self.yaw: float | None = None
        self._local: Vector | None = None
        self._home: Place | None = None
        self._origin: Place | None = None

    @property
    def home_offset(self) -> Vector:
        """Home in the autopilot's local frame."""
        if self._home is None or self._origin is None:
            return (0.0, 0.0, 0.0)
        latitude = math.radians((self._home[0] - self._origin[0]) / 1e7)
        longitude = math.radians((self._home[1] - self._origin[1]) / 1e7)
        shrink = math.cos(math.radians(self._origin[0] / 1e7))
        up = (self._home[2] - self._origin[2]) / 1000.0
        return (latitude * EARTH_RADIUS, longitude * EARTH_RADIUS * shrink, -up)

    @property
    def position(self) -> Vector | None:
        """North, east, down of home in metres."""
        if self._local is None:
            return None
        (north, east, down), home = self._local, self.home_offset
        return (north - home[0], east - home[1], down - home[2])

    @property
    def knows_frames(self) -> bool:
        """Whether home and origin are known, so that positions are about home."""
        return self._home is not None and self._origin is not None

    def update(self, message: Any, now: float) -> dict[str, object]:
        """Take a message in; the telemetry quantities it gives."""
        handler = _HANDLERS.get(message.get_msgId())
        return handler(self, message, now) if handler else {}

    def _on_heartbeat(self, message: Any, now: float) -> dict[str, object]:
        self.heard = now
        self.autopilot, self.type = message.autopilot, message.type
        self.mode = self.kind.mode_name(message.custom_mode)
        self.armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        return {"mode": self.mode, "armed": self.armed}

    def _on_local_position(self, message: Any, _: float) -> dict[str, object]:
        numbers = (message.x, message.y, message.z, message.vx, message.vy, message.vz)
        if not all(map(math.isfinite, numbers)):
            return {}
        self._local = numbers[:3]
        position = self.position
        assert position is not None
        return {"position": list(position), "velocity": list(numbers[3:]), "altitude": -position[2]}

    def _on_attitude(self, message: Any, _: float) -> dict[str, object]:
        if not math.isfinite(message.yaw):
            return {}
        self.yaw = message.yaw
        return {"attitude": [message.roll, message.pitch, message.yaw]}

    def _on_sys_status(self, message: Any, _: float) -> dict[str, object]:
        values: dict[str, object] = {}
        if message.battery_remaining >= 0:  # -1 is "unknown"
            values["battery"] = min(message.battery_remaining / 100.0, 1.0)
        if message.voltage_battery != 0xFFFF:
            values["batteryVoltage"] = message.voltage_battery / 1000.0
        return values

    def _on_extended_sys_state(self, message: Any, _: float) -> dict[str, object]:
        if self.kind.name == "rover":
            self.landed = True
        elif message.landed_state == dialect.MAV_LANDED_STATE_UNDEFINED:
            return {}
        else:
            self.landed = message.landed_state == dialect.MAV_LANDED_STATE_ON_GROUND
        return {"landed": self.landed}

    def _on_home(self, message: Any, _: float) -> dict[str, object]:
        self._home = (message.latitude, message.longitude, message.altitude)
        return {}

    def _on_origin(self, message: Any, _: float) -> dict[str, object]:
        self._origin = (message.latitude, message.longitude, message.altitude)
        return {}


_HANDLERS: Mapping[int, Callable[[VehicleState, Any, float], dict[str, object]]] = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: VehicleState._on_heartbeat,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: VehicleState._on_local_position,
    dialect.MAVLINK_MSG_ID_ATTITUDE: VehicleState._on_attitude,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: VehicleState._on_sys_status,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: VehicleState._on_extended_sys_state,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: VehicleState._on_home,
    dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: VehicleState._on_origin,
}
