"""What an ArduPilot-like autopilot does with a vehicle: modes, arming, guided flight, failsafes.

Times and refusals are those measured on ArduCopter and ArduRover 4.7 (see README.md for what is not
modelled). Pure: `step(dt)` moves time, everything else answers at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

from lfield_sim.vehicle import Descend, Fall, GroundVehicle, Keep, Reach, Rest, Vector, Vehicle


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class Severity(IntEnum):
    """MAV_SEVERITY, the part that is used."""

    CRITICAL = 2
    WARNING = 4
    INFO = 6


@dataclass(frozen=True, slots=True)
class Kind:
    """What tells a copter from a rover: MAV_TYPE, mode numbers, and where it may be armed."""

    name: str
    mav_type: int
    modes: Mapping[str, int]
    start: str
    unarmable: frozenset[str]

    def mode_name(self, number: int) -> str:
        """The name of a mode number, '' for an unknown one."""
        return next((name for name, known in self.modes.items() if known == number), "")


COPTER = Kind(
    "copter",
    2,
    {
        "STABILIZE": 0,
        "ALT_HOLD": 2,
        "AUTO": 3,
        "GUIDED": 4,
        "LOITER": 5,
        "RTL": 6,
        "CIRCLE": 7,
        "LAND": 9,
        "POSHOLD": 16,
        "BRAKE": 17,
    },
    "STABILIZE",
    frozenset({"RTL", "CIRCLE", "LAND", "BRAKE", "AUTO"}),
)
ROVER = Kind(
    "rover",
    10,
    {"MANUAL": 0, "ACRO": 1, "STEERING": 3, "HOLD": 4, "LOITER": 5, "AUTO": 10, "RTL": 11, "GUIDED": 15},
    "MANUAL",
    frozenset({"RTL"}),
)
KINDS = {kind.name: kind for kind in (COPTER, ROVER)}

#: The parameters it has, as ArduPilot names them: speeds in cm/s, times in s, heights in cm.
PARAMETERS: Mapping[str, float] = {
    "BATT_CAPACITY": 3300,
    "BATT_LOW_MAH": 660,
    "DISARM_DELAY": 10,
    "FENCE_ENABLE": 0,
    "FS_GCS_ENABLE": 0,
    "FS_GCS_TIMEOUT": 5,
    "GUID_TIMEOUT": 3,
    "LAND_SPEED": 100,
    "MAV_GCS_SYSID": 255,
    "RTL_ALT": 1500,
    "WPNAV_ACCEL": 250,
    "WPNAV_SPEED": 500,
    "WPNAV_SPEED_DN": 150,
    "WPNAV_SPEED_UP": 250,
}

#: Amperes drawn: switched on, motors turning, flying.
IDLE_CURRENT, ARMED_CURRENT, FLYING_CURRENT = 0.5, 2.0, 18.0
FULL_VOLTS, EMPTY_VOLTS, RESISTANCE = 16.8, 13.2, 0.02
#: param2 of a disarm that is meant even in the air.
FORCE = 21196


@dataclass(slots=True)
class Autopilot:
    """One vehicle with its autopilot. `refuse_arming` is a reason to refuse every arming, or ''."""

    kind: Kind = COPTER
    parameters: dict[str, float] = field(default_factory=lambda: dict(PARAMETERS))
    charge: float = 1.0
    refuse_arming: str = ""
    vehicle: Vehicle = field(init=False)
    mode: str = field(init=False)
    armed: bool = False
    critical: bool = False
    home: Vector = (0.0, 0.0, 0.0)
    uptime: float = 0.0
    texts: list[tuple[Severity, str]] = field(default_factory=list)
    _gcs_seen: float | None = None
    _gcs_lost: bool = False
    _setpoint_at: float = 0.0
    _armed_at: float = 0.0
    _low_told: bool = False

    def __post_init__(self) -> None:
        self.vehicle = Vehicle() if self.kind is COPTER else GroundVehicle()
        self.mode = self.kind.start
        self.apply_parameters()

    @property
    def current(self) -> float:
        """Amperes drawn from the battery."""
        if self.vehicle.airborne:
            return FLYING_CURRENT
        return ARMED_CURRENT if self.armed else IDLE_CURRENT

    @property
    def volts(self) -> float:
        """Voltage of the battery under the present load."""
        return EMPTY_VOLTS + (FULL_VOLTS - EMPTY_VOLTS) * self.charge - RESISTANCE * self.current

    def apply_parameters(self) -> None:
        """Take the limits of motion from the parameters; a DO_CHANGE_SPEED ends here."""
        limits = self.vehicle.limits
        limits.cruise = self._metres("WPNAV_SPEED")
        limits.climb = self._metres("WPNAV_SPEED_UP")
        limits.descend = self._metres("WPNAV_SPEED_DN")
        limits.land = self._metres("LAND_SPEED")
        limits.acceleration = limits.vertical_acceleration = self._metres("WPNAV_ACCEL")

    def _metres(self, name: str) -> float:
        """A parameter in cm as metres, within what the model and its messages can hold."""
        return min(max(self.parameters[name], 1.0), 10_000.0) / 100.0

    @property
    def capacity(self) -> float:
        """Of the battery, in mAh."""
        return min(max(self.parameters["BATT_CAPACITY"], 1.0), 1e6)

    # -- commands -------------------------------------------------------------------------------------

    def arm(self, *, force: bool = False) -> Result:
        """COMPONENT_ARM_DISARM 1: accepted too when it is armed already."""
        if self.armed:
            return Result.ACCEPTED
        if self.mode in self.kind.unarmable:
            return self._refuse(f"Arm: {self.mode} mode not armable")
        if self.refuse_arming and not force:
            return self._refuse(f"Arm: {self.refuse_arming}")
        self.armed, self._armed_at = True, self.uptime
        self.home = self.vehicle.place
        self._say("Arming motors")
        return Result.ACCEPTED

    def disarm(self, *, force: bool = False) -> Result:
        """COMPONENT_ARM_DISARM 0: refused in the air unless forced."""
        if self.vehicle.airborne and not force:
            return Result.FAILED
        if self.armed:
            self._say("Disarming motors")
        self.armed = False
        if self.vehicle.airborne:
            self.vehicle.goal = Fall()
        else:
            self.vehicle.settle()
        return Result.ACCEPTED

    def set_mode(self, number: int) -> Result:
        """DO_SET_MODE with a custom mode, or SET_MODE."""
        name = self.kind.mode_name(number)
        if not name:
            self._say(f"No such mode {number}", Severity.WARNING)
            return Result.FAILED
        self._enter(name)
        return Result.ACCEPTED

    def takeoff(self, height: float) -> Result:
        """NAV_TAKEOFF to a height above home: only armed, in GUIDED, from the ground."""
        if self.kind is not COPTER:
            return Result.UNSUPPORTED
        if not self.armed:
            return self._refuse("Takeoff: not armed")
        if self.mode != "GUIDED":
            return self._refuse(f"Takeoff: not possible in {self.mode}")
        if self.vehicle.airborne or not (math.isfinite(height) and height > 0.0):
            return Result.FAILED
        north, east, _ = self.vehicle.place
        self.vehicle.goal = Reach((north, east, self.home[2] - height))
        return Result.ACCEPTED

    def land(self) -> Result:
        """NAV_LAND: the mode LAND."""
        if self.kind is not COPTER:
            return Result.UNSUPPORTED
        self._enter("LAND")
        return Result.ACCEPTED

    def go_home(self) -> Result:
        """NAV_RETURN_TO_LAUNCH: the mode RTL."""
        self._enter("RTL")
        return Result.ACCEPTED

    def set_yaw(self, yaw: float) -> Result:
        """CONDITION_YAW to an absolute heading in radians."""
        if self.mode not in ("GUIDED", "AUTO"):
            return Result.FAILED
        self.vehicle.yaw_goal = yaw
        return Result.ACCEPTED

    def set_speed(self, speed: float) -> Result:
        """DO_CHANGE_SPEED over ground, until the next mode change."""
        if not 0.0 < speed <= 100.0:
            return Result.DENIED
        self.vehicle.limits.cruise = speed
        return Result.ACCEPTED

    def guide_to(self, place: Vector) -> None:
        """A position setpoint; ignored, as on the real thing, when it cannot be followed."""
        if self._guidable():
            self.vehicle.goal = Reach(place)

    def guide_along(self, velocity: Vector) -> None:
        """A velocity setpoint; it lasts GUID_TIMEOUT seconds."""
        if self._guidable():
            self.vehicle.goal, self._setpoint_at = Keep(velocity), self.uptime

    def gcs_heartbeat(self) -> None:
        """A heartbeat of the ground station that counts (MAV_GCS_SYSID)."""
        self._gcs_seen = self.uptime
        if self._gcs_lost:
            self._gcs_lost = self.critical = False
            self._say("GCS Failsafe Cleared", Severity.WARNING)

    def take_texts(self) -> list[tuple[Severity, str]]:
        """What it had to say since the last call."""
        texts, self.texts = self.texts, []
        return texts

    # -- time -----------------------------------------------------------------------------------------

    def step(self, dt: float) -> None:
        """Let `dt` seconds pass."""
        self.uptime += dt
        self._check_gcs()
        self._drain(dt)
        self._fly()
        if self.armed or self.vehicle.airborne:
            self.vehicle.step(dt)

    def _fly(self) -> None:
        """What the modes do as time passes."""
        vehicle = self.vehicle
        if self.kind is COPTER and self.mode in ("LAND", "RTL") and not vehicle.airborne and self.armed:
            self.disarm()
        elif self.mode == "RTL" and self.armed:
            self._return()
        timeout = self.parameters["GUID_TIMEOUT"]
        if isinstance(vehicle.goal, Keep) and self.uptime - self._setpoint_at > timeout:
            vehicle.goal = Rest()
        delay = self.parameters["DISARM_DELAY"]
        idle = self.kind is COPTER and self.armed and not vehicle.airborne and isinstance(vehicle.goal, Rest)
        if idle and delay > 0 and self.uptime - self._armed_at > delay:
            self.disarm()

    def _return(self) -> None:
        """RTL: up to RTL_ALT, over to home, down."""
        vehicle = self.vehicle
        north, east, down = vehicle.place
        far = math.hypot(north - self.home[0], east - self.home[1])
        height = -self.parameters["RTL_ALT"] / 100.0
        if self.kind is not COPTER:
            vehicle.goal = Reach(self.home)
        elif far < 0.3 and math.hypot(*vehicle.velocity[:2]) < 0.5:
            vehicle.goal = Descend()
        elif far > 1.0 and down > height + 0.3:
            vehicle.goal = Reach((north, east, height))
        else:
            vehicle.goal = Reach((self.home[0], self.home[1], min(down, height)))

    def _check_gcs(self) -> None:
        """The GCS failsafe: RTL when a ground station that was there is gone for FS_GCS_TIMEOUT."""
        if self._gcs_seen is None or self._gcs_lost or not self.armed or not self.parameters["FS_GCS_ENABLE"]:
            return
        if self.uptime - self._gcs_seen > self.parameters["FS_GCS_TIMEOUT"]:
            self._gcs_lost = self.critical = True
            self._say("GCS Failsafe", Severity.WARNING)
            self._enter("RTL")

    def _drain(self, dt: float) -> None:
        self.charge = max(0.0, self.charge - self.current * dt / (self.capacity * 3.6))
        low = self.parameters["BATT_LOW_MAH"] / self.capacity
        if self.charge < low and self.armed and not self._low_told:
            self._low_told = True
            used = (1.0 - self.charge) * self.capacity
            self._say(f"Battery 1 is low {self.volts:.2f}V used {used:.0f} mAh", Severity.WARNING)
        if self.charge == 0.0 and self.armed and self.kind is COPTER and self.mode != "LAND":
            self.critical = True
            self._say("Battery 1 is critical: landing", Severity.CRITICAL)
            self._enter("LAND")

    def _enter(self, mode: str) -> None:
        if mode == self.mode:
            return
        self.mode = mode
        self.apply_parameters()
        self.vehicle.yaw_goal = None
        self.vehicle.goal = Descend() if mode == "LAND" and self.armed else Rest()

    def _guidable(self) -> bool:
        # A copter on the ground follows no setpoint: it takes a takeoff to leave it.
        return self.mode == "GUIDED" and self.armed and (self.vehicle.airborne or self.kind is not COPTER)

    def _refuse(self, text: str) -> Result:
        self._say(text, Severity.CRITICAL)
        return Result.FAILED

    def _say(self, text: str, severity: Severity = Severity.INFO) -> None:
        self.texts.append((severity, text))
