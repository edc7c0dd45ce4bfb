"""What tells autopilots apart, as data. The tables are in `ardupilot` and `px4`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5


class Severity(IntEnum):
    """MAV_SEVERITY, the part that is used."""

    CRITICAL = 2
    WARNING = 4
    INFO = 6


class Role(Enum):
    """What a flight mode does, whatever an autopilot calls it."""

    MANUAL = "manual"
    HOLD = "hold"
    GUIDED = "guided"
    MISSION = "mission"
    TAKEOFF = "takeoff"
    RETURN = "return"
    LAND = "land"
    ORBIT = "orbit"
    TERMINATE = "terminate"


@dataclass(frozen=True, slots=True)
class Mode:
    """A flight mode: HEARTBEAT.custom_mode, what it does, and whether one may arm in it."""

    number: int
    role: Role
    armable: bool = True


Actions = Mapping[int, Role]


@dataclass(frozen=True, slots=True)
class GcsRule:
    """The failsafe for a lost ground station, by the names of its parameters ('' where it has none).

    `action` 0 switches it off; `pause` are seconds of hold before the action; `options` bit 3 lets a
    landing go on; `station` is the only system whose heartbeats count.
    """

    action: str
    timeout: str
    actions: Actions
    text: str
    cleared: str
    pause: str = ""
    options: str = ""
    station: str = ""
    enable: str = ""


@dataclass(frozen=True, slots=True)
class BatteryLevel:
    """One level of a battery failsafe: a share of the charge, or mAh when `of_capacity`."""

    threshold: str
    of_capacity: bool
    action: str
    actions: Actions
    text: str
    severity: Severity = Severity.WARNING


@dataclass(frozen=True, slots=True)
class FenceRule:
    """The fence failsafe; the texts are for circle, ceiling and what was uploaded.

    `blind_text` is why nobody arms behind a fence without a position ('' where that has no text of its own).
    """

    enable: str
    action: str
    actions: Actions
    radius: str
    ceiling: str
    circle_text: str
    ceiling_text: str
    shape_text: str
    blind_text: str = ""


@dataclass(frozen=True, slots=True)
class Flavour:
    """An autopilot: what its kinds of vehicles have in common.

    refusal             the result of an arming or disarming that is refused
    denial              the texts of a refused arming, with {reason}
    serves_components   commands for another component are carried out (ArduPilot), not ignored (PX4)
    submodes            DO_SET_MODE has a main and a sub mode (PX4)
    streams             what it sends unasked, id -> Hz
    needs_stream        the guided mode is entered and kept only while setpoints come, and lifts off by them
    takeoff_mode        takeoff is a mode that is entered even when disarmed; its height is a parameter
    home_item           item 0 of a mission is home
    settles             seconds that it stands until it says that it has landed
    landed_text         said when it switches its motors off after a landing
    unsupported         MAV_CMDs that it does not know
    """

    name: str
    autopilot: int
    version: int
    capabilities: int
    refusal: Result
    denial: tuple[str, ...]
    armed: str
    disarmed: str
    serves_components: bool
    submodes: bool
    needs_stream: bool
    takeoff_mode: bool
    home_item: bool
    setpoint_timeout: str
    disarm_delay: str
    land_delay: str | float
    settles: float
    landed_text: str
    gcs: GcsRule
    battery: tuple[BatteryLevel, ...]
    fence: FenceRule
    position_lost: str
    capacity: str
    streams: Mapping[int, float] = field(default_factory=dict)
    unsupported: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of vehicle with its autopilot.

    `speeds` are the parameters of the limits of motion with how many of their units make one SI unit;
    `return_height` and `return_pause` likewise; `takeoff_height` is PX4's in metres.
    """

    name: str
    mav_type: int
    flavour: Flavour
    modes: Mapping[str, Mode]
    start: str
    parameters: Mapping[str, float]
    speeds: Mapping[str, tuple[str, float]]
    return_height: tuple[str, float] = ("", 1.0)
    takeoff_height: str = ""
    return_pause: tuple[str, float] = ("", 1.0)

    def mode_name(self, number: int) -> str:
        """The name of a mode number, '' for an unknown one."""
        return next((name for name, mode in self.modes.items() if mode.number == number), "")

    def mode_for(self, role: Role) -> str:
        """The first mode with a role, '' when it has none."""
        return next((name for name, mode in self.modes.items() if mode.role is role), "")
