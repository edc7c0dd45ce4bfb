"""State of a vehicle from its messages: telemetry and texts. Pure: messages and times in, values out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from msgspec import Struct

from lfield_mavlink.geodesy import EARTH_RADIUS, Place, Vector
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.modes import PROFILES, PX4, RADII, Profile

#: The quantities of the manifest in each message. A message is requested at the highest rate of its
#: quantities. ArduPilot's heartbeat is needed faster than 1 Hz, since it confirms modes and arming. PX4 sends
#: it no faster, but also sends CURRENT_MODE, without arming; its texts report arming at once, but not while
#: it receives no station heartbeats.
SOURCES: Mapping[int, tuple[str, ...]] = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: ("mode", "armed", "failsafe"),
    dialect.MAVLINK_MSG_ID_CURRENT_MODE: ("mode", "failsafe"),
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: ("position", "velocity", "altitude"),
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: ("globalPosition",),
    dialect.MAVLINK_MSG_ID_ATTITUDE: ("attitude", "heading", "yawRate"),
    dialect.MAVLINK_MSG_ID_VFR_HUD: ("groundSpeed", "climb"),
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: ("gpsFix", "satellites"),
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: ("landed",),
    dialect.MAVLINK_MSG_ID_SYS_STATUS: ("battery", "batteryVoltage", "batteryCurrent"),
}

#: Seconds by which the clock goes back at a restart; less may be a reordered packet.
REORDER_LIMIT = 1.0
#: Seconds for which a position is published again when home has moved.
FRESH = 0.5
#: Characters of one message; a longer text is sent in chunks with one id.
CHUNK = 50
#: Maximum number of stored incomplete texts, since chunks may be lost.
UNFINISHED = 8

#: SYS_STATUS: the pre-arm checks have passed.
PREARM = dialect.MAV_SYS_STATUS_PREARM_CHECK

Values = dict[str, object]


class Sensors(Struct, frozen=True):
    """Sensors and checks of SYS_STATUS as bits of MAV_SYS_STATUS_SENSOR, and its time."""

    present: int
    enabled: int
    healthy: int
    at: float

    @property
    def unhealthy(self) -> list[str]:
        """Enabled sensors that are unhealthy, such as `3d gyro`, `gps`."""
        bits = self.present & self.enabled & ~self.healthy & ~PREARM
        return [_sensor_name(1 << number) for number in range(32) if bits >> number & 1]


def _sensor_name(bit: int) -> str:
    entry = dialect.enums["MAV_SYS_STATUS_SENSOR"].get(bit)
    if entry is None:
        return f"sensor {bit:#x}"
    name: str = entry.name.removeprefix("MAV_SYS_STATUS_").removeprefix("SENSOR_")
    return name.lower().replace("_", " ")


class VehicleState:
    """The newest value of every quantity; None is unknown.

    Positions are in metres relative to *home*. The autopilot uses the origin of its estimator, which is its
    first known position, while home moves to where it was armed last. PX4's home also moves vertically in
    flight with its GNSS altitude; here it stays as it was at takeoff. A rover sets its home before it knows a
    height, so its height is relative to the origin.

    The origin is fixed until the autopilot restarts. Then it is unknown until it is received again, even if
    home and positions arrive before it (11 s before on ArduRover).
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        #: Time of the last heartbeat, and of the last known arming state.
        self.heartbeat_at: float | None = None
        self.armed_at = -math.inf
        self.profile: Profile | None = None
        self.autopilot = -1
        self.type = -1
        self.mode = ""
        self.armed = False
        #: Whether the heartbeat reports a failure (MAV_STATE_CRITICAL).
        self.critical = False
        #: The commanded mode while a failsafe of PX4 overrides it, '' without a failsafe.
        self.overruled: str | None = None
        #: Whether a failsafe is active, even if neither heartbeat nor CURRENT_MODE shows it.
        self.has_failsafe = False
        self.sensors: Sensors | None = None
        self.landed: bool | None = None
        self.yaw: float | None = None
        self.home: Place | None = None
        self.booted: int | None = None
        #: m/s north, east and down.
        self.velocity: Vector = (0.0, 0.0, 0.0)
        #: m/s horizontal and upward, and their time.
        self.speeds: tuple[float, float] | None = None
        self.speeds_at = -math.inf
        #: Time of the last position.
        self.placed_at = -math.inf
        self._relative_altitude: float | None = None
        self._local: Vector | None = None
        self._origin: Place | None = None
        # The first origin, and whether the last one is from before a restart.
        self._first_origin: Place | None = None
        self._restarted = False
        self._reported_at = 0
        self._local_home: Vector | None = None

    @property
    def radius(self) -> float:
        """The Earth radius of the autopilot's conversion, in metres."""
        return RADII.get(self.autopilot, EARTH_RADIUS)

    @property
    def origin(self) -> Place | None:
        """The origin of the local frame on the Earth, None while unknown."""
        return None if self._restarted else self._origin

    @property
    def origin_moved(self) -> Vector | None:
        """The distance of the origin from the first one; None after a restart until it is known."""
        if self._first_origin is None:
            return (0.0, 0.0, 0.0)
        return None if self.origin is None else self._first_origin.vector_to(self.origin, self.radius)

    @property
    def home_offset(self) -> Vector:
        """Home in the autopilot's local frame."""
        # The origin first: older ArduPilots leave the local position in HOME_POSITION at 0.
        if self.home is not None and (origin := self.origin) is not None:
            north, east, down = origin.vector_to(self.home, self.radius)
        else:
            north, east, down = self._local_home or (0.0, 0.0, 0.0)
        return (north, east, 0.0 if self.kind == "rover" else down)

    @property
    def position(self) -> Vector | None:
        """North, east, down of home in metres."""
        if self._local is None:
            return None
        (north, east, down), home = self._local, self.home_offset
        return (north - home[0], east - home[1], down - home[2])

    @property
    def height(self) -> float | None:
        """Metres above home."""
        position = self.position
        return self._relative_altitude if position is None else -position[2]

    @property
    def holder(self) -> str:
        """The controller that has selected a mode other than this program's, as far as known."""
        if self.overruled is None:
            return "a pilot or a failsafe"
        return (
            f"its failsafe, instead of {self.overruled}," if self.overruled else "a pilot or another station"
        )

    @property
    def knows_frames(self) -> bool:
        """Whether home is known in the local frame, so that positions are relative to home."""
        return self.home is not None and (self.origin is not None or self._local_home is not None)

    def on_mode_entered(self, mode: str) -> None:
        """Sets a mode that a confirmed answer reports before a heartbeat does.

        Otherwise an immediate request for the previous mode would appear to have been executed already.
        """
        self.mode = mode

    def on_switched_off(self, now: float) -> Values:
        """Handles an answer that confirms, instead of a heartbeat, that the motors are off; returns
        telemetry.
        """
        self.armed, self.armed_at = False, now
        return {"armed": False}

    def update(self, message: Any, now: float) -> Values:
        """Handles a message; returns telemetry. Invalid values are skipped."""
        handler = _HANDLERS.get(message.get_msgId())
        return handler(self, message, now) if handler else {}

    def _on_heartbeat(self, message: Any, now: float) -> Values:
        self.heartbeat_at = self.armed_at = now
        self.autopilot, self.type = message.autopilot, message.type
        self.profile = PROFILES.get((message.autopilot, self.kind))
        number = message.custom_mode
        self.mode = self.profile.mode_name(number) if self.profile else f"mode {number}"
        self.armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        self.critical = message.system_status in (dialect.MAV_STATE_CRITICAL, dialect.MAV_STATE_EMERGENCY)
        return {"mode": self.mode, "armed": self.armed, "failsafe": self._failsafe}

    def _on_current_mode(self, message: Any, _: float) -> Values:
        # 0 is "unknown".
        if self.profile is None or not self.profile.px4 or not message.custom_mode:
            return {}
        self.mode = self.profile.mode_name(message.custom_mode)
        intended = message.intended_custom_mode
        differs = intended not in (0, message.custom_mode)
        self.overruled = self.profile.mode_name(intended) if differs else ""
        return {"mode": self.mode, "failsafe": self._failsafe}

    def set_failsafe(self, active: bool) -> None:
        """Sets whether the autopilot's own failsafe is active, if its messages do not report that."""
        self.has_failsafe = active

    def set_kind(self, autopilot: int, vehicle_type: int) -> None:
        """Sets only MAV_AUTOPILOT and MAV_TYPE: the heartbeat is of another vehicle."""
        self.autopilot, self.type = autopilot, vehicle_type

    @property
    def _failsafe(self) -> bool:
        return self.critical or bool(self.overruled) or self.has_failsafe

    def _on_local_position(self, message: Any, now: float) -> Values:
        numbers = (message.x, message.y, message.z, message.vx, message.vy, message.vz)
        if not all(map(math.isfinite, numbers)):
            return {}
        self._check_clock(message.time_boot_ms)
        self._local, self.velocity, self.placed_at = numbers[:3], numbers[3:], now
        self.speeds, self.speeds_at = (math.hypot(message.vx, message.vy), -message.vz), now
        position = self.position
        assert position is not None
        over_ground, upwards = self.speeds
        velocities = {"velocity": list(numbers[3:]), "groundSpeed": over_ground, "climb": upwards}
        return {**_placed(position), **velocities}

    def _on_global_position(self, message: Any, _: float) -> Values:
        place = Place.scaled(message.lat, message.lon, message.alt)
        self._check_clock(message.time_boot_ms)
        self._relative_altitude = message.relative_alt / 1000.0
        return {"globalPosition": [place.latitude, place.longitude, place.altitude]} if place else {}

    def _on_attitude(self, message: Any, _: float) -> Values:
        angles = (message.roll, message.pitch, message.yaw)
        if not all(map(math.isfinite, (*angles, message.yawspeed))):
            return {}
        self._check_clock(message.time_boot_ms)
        self.yaw, self.booted = message.yaw, message.time_boot_ms
        return {"attitude": list(angles), "heading": message.yaw % math.tau, "yawRate": message.yawspeed}

    def _check_clock(self, booted: int) -> None:
        """Handles the milliseconds since power-on; a restart invalidates the frames of the vehicle."""
        if booted < self._reported_at - 1000.0 * REORDER_LIMIT:
            self._restarted = True
            self._local = self._local_home = self.home = None
        self._reported_at = booted

    def _on_vfr_hud(self, message: Any, now: float) -> Values:
        if not (math.isfinite(message.groundspeed) and math.isfinite(message.climb)):
            return {}
        self.speeds, self.speeds_at = (message.groundspeed, message.climb), now
        return {"groundSpeed": message.groundspeed, "climb": message.climb}

    def _on_gps(self, message: Any, _: float) -> Values:
        values: Values = {"gpsFix": message.fix_type}
        if message.satellites_visible != 0xFF:
            values["satellites"] = message.satellites_visible
        return values

    def _on_sys_status(self, message: Any, now: float) -> Values:
        self.sensors = Sensors(
            message.onboard_control_sensors_present,
            message.onboard_control_sensors_enabled,
            message.onboard_control_sensors_health,
            now,
        )
        values: Values = {}
        if message.battery_remaining >= 0:  # -1 is "unknown"
            values["battery"] = min(message.battery_remaining / 100.0, 1.0)
        if message.voltage_battery != 0xFFFF:
            values["batteryVoltage"] = message.voltage_battery / 1000.0
        if message.current_battery >= 0:
            values["batteryCurrent"] = message.current_battery / 100.0
        return values

    def _on_extended_sys_state(self, message: Any, _: float) -> Values:
        if self.profile is not None and not self.profile.flies:
            self.landed = True
        elif message.landed_state == dialect.MAV_LANDED_STATE_UNDEFINED:
            return {}
        else:
            self.landed = message.landed_state == dialect.MAV_LANDED_STATE_ON_GROUND
        return {"landed": self.landed}

    def _on_home(self, message: Any, now: float) -> Values:
        keeps_home = self.autopilot == PX4 and self.landed is False and self.knows_frames
        home = Place.scaled(message.latitude, message.longitude, message.altitude)
        if home is None or keeps_home:
            return {}
        self.home = home
        local = (message.x, message.y, message.z)
        self._local_home = local if all(map(math.isfinite, local)) else None
        values: Values = {"home": [home.latitude, home.longitude, home.altitude]}
        # Publish the position relative to the new home at once, for a caller that has just armed it.
        position = self.position
        return values if position is None or now > self.placed_at + FRESH else {**values, **_placed(position)}

    def _on_origin(self, message: Any, _: float) -> Values:
        origin = Place.scaled(message.latitude, message.longitude, message.altitude)
        if origin is not None:
            self._origin, self._restarted = origin, False
            self._first_origin = self._first_origin or origin
        return {}


def _placed(position: Vector) -> Values:
    return {"position": list(position), "altitude": -position[2]}


_HANDLERS: Mapping[int, Callable[[VehicleState, Any, float], Values]] = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: VehicleState._on_heartbeat,
    dialect.MAVLINK_MSG_ID_CURRENT_MODE: VehicleState._on_current_mode,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: VehicleState._on_local_position,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: VehicleState._on_global_position,
    dialect.MAVLINK_MSG_ID_ATTITUDE: VehicleState._on_attitude,
    dialect.MAVLINK_MSG_ID_VFR_HUD: VehicleState._on_vfr_hud,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: VehicleState._on_gps,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: VehicleState._on_sys_status,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: VehicleState._on_extended_sys_state,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: VehicleState._on_home,
    dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: VehicleState._on_origin,
}


class Texts:
    """STATUSTEXT: joins chunks, and keeps the newest texts as reasons for refusals."""

    def __init__(self) -> None:
        self._chunks: dict[int, list[str]] = {}
        self._recent: deque[tuple[float, str]] = deque(maxlen=32)

    def add(self, text: str, text_id: int, sequence: int, now: float) -> str | None:
        """Handles one message; returns a completed text."""
        if text_id == 0:
            return self._complete(text, now)
        if sequence == 0:
            self._chunks[text_id] = []
            while len(self._chunks) > UNFINISHED:
                del self._chunks[next(iter(self._chunks))]
        chunks = self._chunks.get(text_id)
        if chunks is None or len(chunks) != sequence:
            # A chunk is missing: discard the rest.
            self._chunks.pop(text_id, None)
            return None
        chunks.append(text)
        if len(text) == CHUNK:
            return None
        del self._chunks[text_id]
        return self._complete("".join(chunks), now)

    def since(self, start: float) -> list[str]:
        """The texts completed from `start` on."""
        return [text for at, text in self._recent if at >= start]

    def _complete(self, text: str, now: float) -> str:
        # PX4 ends its texts with a tab, and some consist of nothing else.
        if text := text.strip():
            self._recent.append((now, text))
        return text
