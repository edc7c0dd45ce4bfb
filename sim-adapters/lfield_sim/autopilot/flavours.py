"""Differences of autopilots, as data. The tables are in `stacks`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import Enum, IntEnum
from typing import Protocol

from msgspec import Struct, field

from lfield_sim.autopilot.body.estimator import BlindRule
from lfield_sim.autopilot.ground_vehicle import Wheels
from lfield_sim.autopilot.vehicle import Limits


class MavResult(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5


class Role(Enum):
    """The function of a flight mode, independent of its name."""

    MANUAL = "manual"
    HOLD = "hold"
    GUIDED = "guided"
    MISSION = "mission"
    TAKEOFF = "takeoff"
    RETURN = "return"
    LAND = "land"
    ORBIT = "orbit"
    TERMINATE = "terminate"


class SetpointControl(Enum):
    """The quantities of a setpoint: a position, a position with a velocity towards it, or a velocity."""

    PLACE = "place"
    BOTH = "both"
    VELOCITY = "velocity"


class SpeedControl(Protocol):
    """The speed to a position (see `speed_control`); speeds in m/s."""

    @property
    def speed(self) -> float:
        """The present speed to a position."""

    def enter(self, *, guided: bool) -> None:
        """Called when a mode was entered, or a takeoff began."""

    def arm(self) -> None:
        """Called when the vehicle was armed."""

    def start(self, control: SetpointControl, requested: float | None = None) -> bool:
        """Called for a goal, with or without its own speed; False when it is refused for that speed."""

    def change(self, speed: float) -> MavResult:
        """Handles DO_CHANGE_SPEED."""


#: Creates a pace from the autopilot's own speed and the cap on all speeds, read when needed.
MakeSpeedControl = Callable[[Callable[[], float], Callable[[], float]], SpeedControl]


class FlightMode(Struct, frozen=True):
    """A flight mode: HEARTBEAT.custom_mode, its role, and whether it permits arming.

    `flags` is HEARTBEAT.base_mode apart from armed (MAV_MODE_FLAG), `standard` that of CURRENT_MODE
    (MAV_STANDARD_MODE). `by_hand` needs a transmitter: without one the throttle counts as down, and it sinks.
    """

    number: int
    role: Role
    flags: int
    armable: bool = True
    by_hand: bool = False
    standard: int = 0


Actions = Mapping[int, Role]


class GcsRule(Struct, frozen=True):
    """The ground station failsafe, by parameter names ('' for none).

    `action` 0 disables it; `pause` are seconds of hold before the action; `options` bit 3 lets a landing
    continue (text `continue_text`); `station` is the only system whose heartbeats count, or the first of a
    range up to `stations_to`, on any link. `late` is its delay beyond the timeout in s, or the parameter for
    it. While it lasts arming is refused if it `forbids` that, with `refusal` ('': without a text).
    `acts_disarmed`: a disarmed vehicle takes the action too, unless it holds or returns already. `lost_text`
    is sent for any action, `unfit_text` if there is one, `hold_text` before a pause, and `text` with the
    action. It is checked every `check_period` seconds (0: always), which delays its start and end.
    """

    action: str
    timeout: str
    actions: Actions
    text: str
    cleared: str
    pause: str = ""
    options: str = ""
    station: str = ""
    stations_to: str = ""
    enable: str = ""
    late: str | float = 0.0
    continue_text: str = ""
    forbids: bool = False
    refusal: str = ""
    acts_disarmed: bool = False
    lost_text: str = ""
    unfit_text: str = ""
    hold_text: str = ""
    check_period: float = 0.0


class BatteryLevel(Struct, frozen=True):
    """One level of a battery failsafe: a share of the charge, or mAh when `of_capacity`."""

    threshold: str
    of_capacity: bool
    action: str
    actions: Actions
    text: str


class FenceRule(Struct, frozen=True):
    """The fence failsafe; the texts are for circle, ceiling and uploaded zones.

    `avoid` is the parameter by which it stays inside (`margin` m from the edge), '' for none. `refuses`: it
    ignores a goal beyond, with `outside_text`. `recovery_text` is sent at each change of mode outside,
    `cleared_text` when it is back. `pause` is the parameter for seconds of hold before the action,
    `hold_text` the text for it, after which the breach is reported again. `blind_text` is the reason against
    arming behind a fence without a position ('' for no text).
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
    avoid: str = ""
    margin: str = ""
    refuses: bool = True
    outside_text: str = ""
    recovery_text: str = ""
    cleared_text: str = ""
    hold_text: str = ""
    pause: str = ""


class StartupTiming(Struct, frozen=True):
    """A cold start, in shares of the time until arming is possible.

    `fix`, `home`, `origin` and `position` are when GNSS has a fix and when the others are reported; from
    `estimate` on the estimator trusts its position. `reasons` are the reasons against arming, each until
    its share; None is a refusal without a text. `texts` are its messages, each at its share. From `by_hand`
    on it may be armed in a mode without a position.
    """

    fix: float
    home: float
    origin: float
    position: float
    estimate: float
    reasons: tuple[tuple[float, tuple[str, ...] | None], ...]
    texts: tuple[tuple[float, tuple[str, ...]], ...] = ()
    by_hand: float = 1.0


#: A lost GNSS has no effect.
NEVER_BLIND = BlindRule(1e9)


class Flavour(Struct, frozen=True):
    """An autopilot: the properties that its kinds of vehicles have in common.

    refusal             the result of a refused arming or disarming
    denial              the texts of a refused arming: one for each {reason}
    warning             the same, repeated while it is not armed ('': never)
    verdict             the text after them
    unarmable           the reason when a {mode} does not permit arming
    serves_components   commands for another component are executed (ArduPilot), not ignored (PX4)
    submodes            DO_SET_MODE has a main and a sub mode (PX4)
    streams             what it sends without a request, id -> Hz
    needs_stream        the guided mode requires a stream of setpoints, which also lift it off
    takeoff_mode        takeoff is a mode that is entered even when disarmed; its height is a parameter
    home_item           item 0 of a mission is home
    settles             seconds at rest until it reports a landing
    landed_text         sent when it switches its motors off after a landing
    unsupported         unknown MAV_CMDs
    unknown_messages    messages that it does not know
    streamed_only       messages that REQUEST_MESSAGE does not support
    heeds_groups        it supports REQUEST_DATA_STREAM
    fastest             the highest accepted rate of a stream, Hz
    return_cone         slope of the cone around home in which it climbs less for its return (0: none)
    unasked_only        messages whose rate cannot be changed
    grace               seconds that a setpoint may exceed its timeout
    unavailable         text for an unavailable mode, which is accepted ('': it is refused)
    ignored_text        text for an ignored acceleration alone ('': it is followed)
    setpoint_text       text for a setpoint that is too old
    mute, stale         seconds without a ground station after which it sends no texts; they follow, unless
                        they are too old by then
    sends_modes         a heartbeat is sent at each change of mode, not only once a second
    sends_home          home is sent when it is set, not only as a stream
    sent_once           messages sent at the first contact of a station, and again only by REQUEST_MESSAGE
    no_mission          text when there is no mission
    airborne_text       text when it is not disarmed because it flies
    idle_text           text when it disarms because nothing follows an arming
    drifts              home's height moves with GNSS while it flies
    blind               its behaviour without GNSS
    battery_text        text when the battery failsafe acts
    battery_refusal     reason against arming after that
    thrust_loss         text when it sinks for lack of power
    """

    name: str
    autopilot: int
    version: int
    capabilities: int
    refusal: MavResult
    denial: str
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
    unknown_messages: frozenset[int] = frozenset()
    unasked_only: frozenset[int] = frozenset()
    streamed_only: frozenset[int] = frozenset()
    heeds_groups: bool = True
    fastest: float = 1000.0
    return_cone: float = 0.0
    verdict: str = ""
    warning: str = ""
    unarmable: str = "{mode} mode not armable"
    grace: float = 0.0
    unavailable: str = ""
    setpoint_text: str = ""
    ignored_text: str = ""
    mute: float = math.inf
    stale: float = math.inf
    sends_modes: bool = False
    sends_home: bool = False
    sent_once: frozenset[int] = frozenset()
    idle_text: str = ""
    no_mission: tuple[str, ...] = ()
    airborne_text: str = ""
    drifts: bool = False
    blind: BlindRule = NEVER_BLIND
    battery_text: str = ""
    battery_refusal: str = ""
    thrust_loss: str = ""


class VehicleKind(Struct, frozen=True):
    """A kind of vehicle with its autopilot.

    `speeds` are the parameters of the motion limits with units per SI unit; `return_height` and
    `return_pause` likewise; `takeoff_height` is PX4's in metres. `limits` are those without a parameter,
    `speed_control` its speed to a position, `wheels` those of a rover, `home_altitude` the height above mean
    sea level that it uses for home; `lands`: it supports takeoff and landing. `mission_limits` apply in a
    mission only.
    """

    name: str
    mav_type: int
    flavour: Flavour
    modes: Mapping[str, FlightMode]
    start: str
    parameters: Mapping[str, float]
    speeds: Mapping[str, tuple[str, float]]
    speed_control: MakeSpeedControl
    warming: StartupTiming
    limits: Limits = field(default_factory=Limits)
    wheels: Wheels = field(default_factory=Wheels)
    home_altitude: float | None = None
    lands: bool = True
    mission_limits: Mapping[str, float] = field(default_factory=dict)
    return_height: tuple[str, float] = ("", 1.0)
    takeoff_height: str = ""
    return_pause: tuple[str, float] = ("", 1.0)

    def mode_name(self, number: int) -> str:
        """The name of a mode number, '' for an unknown one."""
        return next((name for name, mode in self.modes.items() if mode.number == number), "")

    def mode_for(self, role: Role) -> str:
        """The first mode with a role, '' when it has none."""
        return next((name for name, mode in self.modes.items() if mode.role is role), "")
