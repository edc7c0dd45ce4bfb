"""What tells autopilots apart, as data. The tables are in `ardupilot` and `px4`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import Protocol

from lfield_sim.autopilot.body.estimate import BlindRule
from lfield_sim.autopilot.ground import Wheels
from lfield_sim.autopilot.vehicle import Limits


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5


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


class Control(Enum):
    """What a setpoint has controlled: a place, a place with a velocity towards it, or a velocity."""

    PLACE = "place"
    BOTH = "both"
    VELOCITY = "velocity"


class Pace(Protocol):
    """How fast a place is flown to (see `pace`); speeds in m/s."""

    @property
    def speed(self) -> float:
        """What is flown to a place now."""

    def enter(self, *, guided: bool) -> None:
        """A mode was entered, or a takeoff began."""

    def arm(self) -> None:
        """It was armed."""

    def begin(self, control: Control, asked: float | None = None) -> bool:
        """A goal came, with a speed of its own or without; False when it is refused for that."""

    def change(self, speed: float) -> Result:
        """DO_CHANGE_SPEED."""


#: Makes a pace from the autopilot's own speed and the cap on all speeds, each read when it is needed.
PaceMaker = Callable[[Callable[[], float], Callable[[], float]], Pace]


@dataclass(frozen=True, slots=True)
class Mode:
    """A flight mode: HEARTBEAT.custom_mode, what it does, and whether one may arm in it.

    `flags` is what HEARTBEAT.base_mode says of it beside armed (MAV_MODE_FLAG), `standard` what CURRENT_MODE
    does (MAV_STANDARD_MODE). `by_hand` needs a transmitter: without one the throttle counts as down, and it
    sinks.
    """

    number: int
    role: Role
    flags: int
    armable: bool = True
    by_hand: bool = False
    standard: int = 0


Actions = Mapping[int, Role]


@dataclass(frozen=True, slots=True)
class GcsRule:
    """The failsafe for a lost ground station, by the names of its parameters ('' where it has none).

    `action` 0 switches it off; `pause` are seconds of hold before the action; `options` bit 3 lets a
    landing go on (`goes_on` is said then); `station` is the only system whose heartbeats count, or the first
    of them, up to `stations_to`, on whatever link. `late` is
    how much longer than the timeout it takes, in s, or the parameter that says so. While it lasts arming is
    refused when it `forbids` that, with `refusal` ('': without a word). `stands` says that what is not armed
    takes the action too, unless it holds or returns already. `lost_text` is said whatever the action is,
    `unfit_text` where there is one, `hold_text` before a pause, and `text` with the action. It is looked at
    `every` so many seconds (0: always), so that it begins and ends up to that much later.
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
    goes_on: str = ""
    forbids: bool = False
    refusal: str = ""
    stands: bool = False
    lost_text: str = ""
    unfit_text: str = ""
    hold_text: str = ""
    every: float = 0.0


@dataclass(frozen=True, slots=True)
class BatteryLevel:
    """One level of a battery failsafe: a share of the charge, or mAh when `of_capacity`."""

    threshold: str
    of_capacity: bool
    action: str
    actions: Actions
    text: str


@dataclass(frozen=True, slots=True)
class FenceRule:
    """The fence failsafe; the texts are for circle, ceiling and what was uploaded.

    `avoid` is the parameter by which it stays inside (`margin` m from the edge), '' where it has none.
    `refuses` says that it does not set out for a goal beyond, which is told with `outside_text`.
    `recovery_text` is said with each change of mode outside, `cleared_text` when it is back. `pause` is the
    parameter for seconds of hold before the action, `hold_text` what is said to that, and then the breach is
    told once more. `blind_text` is why nobody arms behind a fence without a position ('' where that has no
    text of its own).
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


@dataclass(frozen=True, slots=True)
class Warming:
    """A cold start, in shares of the time that it takes until it may be armed.

    `fix`, `home`, `origin` and `position` are when GPS has one and when the others are told; from `estimate`
    on the estimator trusts its position. `reasons` are why arming is refused, each until its share; None is
    a refusal without a word. `texts` are what it says of itself meanwhile, each at its share.
    From `by_hand` on it may be armed in a mode that needs no position.
    """

    fix: float
    home: float
    origin: float
    position: float
    estimate: float
    reasons: tuple[tuple[float, tuple[str, ...] | None], ...]
    texts: tuple[tuple[float, tuple[str, ...]], ...] = ()
    by_hand: float = 1.0


#: Nothing comes of a lost GPS.
SEES_ON = BlindRule(1e9)


@dataclass(frozen=True, slots=True)
class Flavour:
    """An autopilot: what its kinds of vehicles have in common.

    refusal             the result of an arming or disarming that is refused
    denial              the texts of a refused arming: one for each {reason}
    warning             the same, told again and again while it is not armed ('': never)
    verdict             what is said after them
    unarmable           the reason why a {mode} is none to arm in
    serves_components   commands for another component are carried out (ArduPilot), not ignored (PX4)
    submodes            DO_SET_MODE has a main and a sub mode (PX4)
    streams             what it sends unasked, id -> Hz
    needs_stream        the guided mode is entered and kept only while setpoints come, and lifts off by them
    takeoff_mode        takeoff is a mode that is entered even when disarmed; its height is a parameter
    home_item           item 0 of a mission is home
    settles             seconds that it stands until it says that it has landed
    landed_text         said when it switches its motors off after a landing
    unsupported         MAV_CMDs that it does not know
    lacks               messages that it does not have
    streamed_only       messages that it streams and does not send for REQUEST_MESSAGE
    heeds_groups        it obeys REQUEST_DATA_STREAM
    fastest             the highest rate of a stream that it takes, Hz
    return_cone         how steep the cone about home is, within which it climbs less for its return (0: none)
    unasked_only        messages that it sends as often as it likes, whatever it is asked
    grace               seconds that a setpoint may be late beyond its timeout
    unavailable         said when a mode is not available, which is accepted all the same ('': it is refused)
    ignored_text        said when an acceleration alone is ignored ('': it is followed)
    setpoint_text       said when a setpoint is too old
    mute, stale         seconds without a ground station after which it says no texts; they come later, unless
                        they are so old by then
    tells_modes         a heartbeat goes out with each change of mode, not only once a second
    tells_home          home goes out when it is taken, not only as a stream
    told_once           messages that come when the first station is heard, and again only by REQUEST_MESSAGE
    no_mission          said when there is no mission to fly
    airborne_text       said when it is not disarmed because it flies
    idle_text           said when it disarms because nothing follows an arming
    drifts              home's height moves with GNSS while it flies
    blind               what it does without GPS
    battery_text        said when the failsafe of the battery acts
    battery_refusal     why it is not armed after that
    thrust_loss         said when it sinks for want of power
    """

    name: str
    autopilot: int
    version: int
    capabilities: int
    refusal: Result
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
    lacks: frozenset[int] = frozenset()
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
    tells_modes: bool = False
    tells_home: bool = False
    told_once: frozenset[int] = frozenset()
    idle_text: str = ""
    no_mission: tuple[str, ...] = ()
    airborne_text: str = ""
    drifts: bool = False
    blind: BlindRule = SEES_ON
    battery_text: str = ""
    battery_refusal: str = ""
    thrust_loss: str = ""


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of vehicle with its autopilot.

    `speeds` are the parameters of the limits of motion with how many of their units make one SI unit;
    `return_height` and `return_pause` likewise; `takeoff_height` is PX4's in metres. `limits` are those that
    no parameter sets, `pace` how fast it goes to a place, `wheels` are those of a rover,
    `home_altitude` the height above mean sea level that it takes for home's, wherever that is; `lands` says
    that it knows takeoff, landing and being landed. `mission_limits` are those that hold in a mission only.
    """

    name: str
    mav_type: int
    flavour: Flavour
    modes: Mapping[str, Mode]
    start: str
    parameters: Mapping[str, float]
    speeds: Mapping[str, tuple[str, float]]
    pace: PaceMaker
    warming: Warming
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
