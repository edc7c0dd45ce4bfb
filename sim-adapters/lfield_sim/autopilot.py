"""What an autopilot does with a vehicle: modes, arming, guided flight, missions, failsafes.

Times and refusals are those measured on ArduPilot 4.7 and PX4 1.17; what tells them apart is data in
`flavours`. Pure: `step(dt)` moves time, everything else answers at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from lfield_sim import ardupilot, px4
from lfield_sim.battery import Battery
from lfield_sim.failsafes import Failsafes
from lfield_sim.fences import Fence, NoFence, fence_at
from lfield_sim.flavours import Flavour, Kind, Result, Role, Severity
from lfield_sim.flight import circle_ahead, fly, why_no_mission
from lfield_sim.habits import disarm_when_idle, suffer
from lfield_sim.mission import Mission, MissionItem
from lfield_sim.payload import Payload
from lfield_sim.vehicle import (
    ZERO,
    Circle,
    Descend,
    Fall,
    Goal,
    GroundVehicle,
    Keep,
    Lean,
    Reach,
    Rest,
    Vector,
    Vehicle,
)

#: Every vehicle there is, by flavour and kind.
FLAVOURS: Mapping[str, Mapping[str, Kind]] = {"ardupilot": ardupilot.KINDS, "px4": px4.KINDS}
KINDS = FLAVOURS["ardupilot"]
#: Seconds between two setpoints that still make a stream to PX4, which does not enter OFFBOARD without one.
STREAM_GAP = 0.5
#: Seconds that a restart takes.
REBOOT = 3.0
#: Texts that are kept until somebody takes them.
KEPT_TEXTS = 100


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What a guided vehicle is to do; a motion and a heading, each may be left open."""

    goal: Goal | None = None
    yaw: float | None = None
    yaw_rate: float | None = None


@dataclass(slots=True)
class Autopilot:
    """One vehicle with its autopilot.

    Faults: `refuse_arming` is a reason to refuse every arming, or ''; `gps_lost`, `motor_failed`; `warm_up`
    are the seconds after a start in which it is not healthy yet.
    """

    kind: Kind = KINDS["copter"]
    battery: Battery = field(default_factory=Battery)
    refuse_arming: str = ""
    gps_lost: bool = False
    motor_failed: bool = False
    warm_up: float = 0.0
    parameters: dict[str, float] = field(init=False)
    vehicle: Vehicle = field(init=False)
    payload: Payload = field(default_factory=Payload)
    mission: Mission = field(default_factory=Mission)
    fence: Fence = field(default_factory=NoFence)
    failsafes: Failsafes = field(init=False)
    mode: str = field(init=False)
    armed: bool = False
    critical: bool = False
    home: Vector = ZERO
    now: float = 0.0
    booted: float = 0.0
    booting_until: float = -1.0
    boots: int = 0
    armed_at: float = 0.0
    landed_at: float | None = None
    perform: Callable[[MissionItem], object] = lambda _: None
    _texts: list[tuple[Severity, str]] = field(default_factory=list)
    _setpoint_at: float = -math.inf
    _takeoff_height: float | None = None

    def __post_init__(self) -> None:
        self.parameters = dict(self.kind.parameters)
        self.vehicle = Vehicle() if self.kind.name == "copter" else GroundVehicle()
        self.failsafes = Failsafes(self)
        self.mode = self.kind.start
        self.apply_parameters()

    # -- state ----------------------------------------------------------------------------------------

    @property
    def uptime(self) -> float:
        """Seconds since it was switched on or restarted."""
        return max(0.0, self.now - self.booted)

    @property
    def role(self) -> Role:
        """What the present mode does."""
        return self.kind.modes[self.mode].role

    @property
    def charge(self) -> float:
        """Of the battery, 0 to 1."""
        return self.battery.charge

    @property
    def flavour(self) -> Flavour:
        """ArduPilot or PX4."""
        return self.kind.flavour

    @property
    def flies(self) -> bool:
        """Whether it is a copter."""
        return self.kind.name == "copter"

    @property
    def booting(self) -> bool:
        """Whether it is restarting: it says nothing and hears nothing."""
        return self.now < self.booting_until

    @property
    def unfit(self) -> str:
        """Why it cannot be armed now, '' when it can."""
        if self.refuse_arming:
            return self.refuse_arming
        if self.gps_lost:
            fence = self.flavour.fence
            fenced = fence.blind_text and self.parameters[fence.enable]
            return fence.blind_text if fenced else "Need Position Estimate"
        return "EKF not ready" if self.uptime < self.warm_up else ""

    @property
    def setpoints_over(self) -> bool:
        """Whether the last setpoint is too old to go on with; positions of ArduPilot stay for ever."""
        old = self.now - self._setpoint_at > self.value(self.flavour.setpoint_timeout)
        return old and (self.flavour.needs_stream or isinstance(self.vehicle.goal, Keep | Lean))

    @property
    def return_height(self) -> float:
        """Metres above home at which it returns."""
        name, scale = self.kind.return_height
        return min(self.value(name) / scale, 1000.0) if name else 0.0

    @property
    def takeoff_height(self) -> float:
        """Metres above home to which PX4 takes off."""
        if self._takeoff_height is not None:
            return self._takeoff_height
        name = self.kind.takeoff_height
        return min(max(self.value(name), 0.5), 1000.0) if name else 2.5

    def value(self, name: str) -> float:
        """A parameter as a number one can count with: neither NaN nor below 0."""
        number = self.parameters[name]
        return min(number, 1e9) if number > 0.0 else 0.0

    def apply_parameters(self) -> None:
        """Take the limits of motion and the battery's size from the parameters."""
        limits = self.vehicle.limits
        for limit, (name, scale) in self.kind.speeds.items():
            setattr(limits, limit, min(max(self.value(name) / scale, 0.01), 100.0))
        limits.vertical_acceleration = limits.acceleration
        self.battery.capacity = min(max(self.value(self.flavour.capacity), 1.0), 1e6)

    def say(self, text: str, severity: Severity = Severity.INFO) -> None:
        """A status text."""
        self._texts = [*self._texts[-KEPT_TEXTS:], (severity, text)]

    def take_texts(self) -> list[tuple[Severity, str]]:
        """What it had to say since the last call."""
        texts, self._texts = self._texts, []
        return texts

    # -- commands -------------------------------------------------------------------------------------

    def arm(self, *, force: bool = False) -> Result:
        """COMPONENT_ARM_DISARM 1: accepted too when it is armed already."""
        if self.armed:
            return Result.ACCEPTED
        if not self.kind.modes[self.mode].armable:
            return self._deny_arming(f"{self.mode} mode not armable")
        if self.unfit and not force:
            return self._deny_arming(self.unfit)
        self.armed, self.armed_at, self.landed_at = True, self.now, None
        self.home = self.vehicle.place
        self.say(self.flavour.armed)
        return Result.ACCEPTED

    def disarm(self, *, force: bool = False) -> Result:
        """COMPONENT_ARM_DISARM 0: refused in the air unless forced."""
        if self.vehicle.airborne and not force:
            return self.flavour.refusal
        if self.armed:
            self.say(self.flavour.disarmed)
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
            self.say(f"No such mode {number}", Severity.WARNING)
            return Result.FAILED
        return self.command_mode(name)

    def command_mode(self, name: str) -> Result:
        """A mode by name. PX4 says yes to OFFBOARD without setpoints, and does not enter it."""
        role = self.kind.modes[name].role
        if role is Role.MISSION and (reason := why_no_mission(self)):
            return self.refuse(reason)
        streams = self.now - self._setpoint_at <= STREAM_GAP
        if role is not Role.GUIDED or streams or not self.flavour.needs_stream:
            self.failsafes.commanded()
            self.enter(name)
        return Result.ACCEPTED

    def command_role(self, role: Role) -> Result:
        """The mode that has a role; UNSUPPORTED when there is none (a rover does not land)."""
        name = self.kind.mode_for(role)
        return self.command_mode(name) if name else Result.UNSUPPORTED

    def takeoff(self, height: float | None) -> Result:
        """NAV_TAKEOFF to a height above home; None is the one PX4 has as a parameter.

        ArduPilot: only armed, in GUIDED, from the ground. PX4 enters a mode and says yes in any case.
        """
        if not self.flies:
            return Result.UNSUPPORTED
        if self.flavour.takeoff_mode:
            self._takeoff_height = height if height is not None and 0.0 < height < 1e4 else None
            return self.command_role(Role.TAKEOFF)
        if not self.armed:
            return self.refuse("Takeoff: not armed")
        if self.role is not Role.GUIDED:
            return self.refuse(f"Takeoff: not possible in {self.mode}")
        if self.vehicle.airborne or height is None or not 0.0 < height < 1e4:
            return Result.FAILED
        north, east, _ = self.vehicle.place
        self.vehicle.goal = Reach((north, east, self.home[2] - height))
        return Result.ACCEPTED

    def start_mission(self, first: int | None = None) -> Result:
        """MISSION_START: the mission mode, from an item or from where it was left."""
        if first is not None and not self.mission.jump(first):
            return self.refuse(f"Mission: there is no item {first}")
        return self.command_role(Role.MISSION)

    def set_yaw(self, yaw: float) -> Result:
        """CONDITION_YAW to an absolute heading in radians."""
        if self.role not in (Role.GUIDED, Role.MISSION):
            return Result.FAILED
        self.vehicle.yaw_goal, self.vehicle.yaw_rate_goal = yaw, None
        return Result.ACCEPTED

    def set_speed(self, speed: float) -> Result:
        """DO_CHANGE_SPEED over ground, until the next mode change."""
        if not 0.0 < speed <= 100.0:
            return Result.DENIED
        self.vehicle.limits.cruise = speed
        return Result.ACCEPTED

    def reposition(self, place: Vector, yaw: float | None, *, change_mode: bool) -> Result:
        """DO_REPOSITION: ArduPilot goes there in GUIDED, PX4 holds there."""
        if fence_at(self, place)[0] and not self.flavour.needs_stream:
            return Result.FAILED
        role = Role.HOLD if self.flavour.needs_stream else Role.GUIDED
        if self.role is not role and not change_mode:
            return Result.DENIED
        self.command_role(role)
        if self.armed and (self.vehicle.airborne or not self.flies):
            self.vehicle.goal, self.vehicle.yaw_goal = Reach(place), yaw
        return Result.ACCEPTED

    def orbit(self, circle: Circle) -> Result:
        """DO_ORBIT: only what flies."""
        if not self.vehicle.airborne or circle.radius <= 0.0:
            return self.refuse("Orbit: not possible now")
        result = self.command_role(Role.ORBIT)
        self.vehicle.goal = circle
        return result

    def guide(self, setpoint: Setpoint) -> None:
        """A setpoint; ignored, as on the real thing, when it cannot be followed."""
        self._setpoint_at = self.now
        # An ArduCopter on the ground follows no setpoint: it takes a takeoff to leave it.
        lifted = self.vehicle.airborne or not self.flies or self.flavour.needs_stream
        if self.role is not Role.GUIDED or not self.armed or not lifted:
            return
        if setpoint.goal is not None:
            self.vehicle.goal = setpoint.goal
        if setpoint.yaw is not None or setpoint.yaw_rate is not None:
            self.vehicle.yaw_goal, self.vehicle.yaw_rate_goal = setpoint.yaw, setpoint.yaw_rate

    def stop_moving(self) -> None:
        """The setpoint is over: stand still where it is."""
        self.vehicle.goal, self.vehicle.yaw_rate_goal = Rest(), None

    def go_home(self) -> Result:
        """NAV_RETURN_TO_LAUNCH."""
        return self.command_role(Role.RETURN)

    def terminate(self) -> Result:
        """DO_FLIGHTTERMINATION: the motors stop, wherever it is."""
        self.critical = True
        return self.disarm(force=True)

    def reboot(self) -> Result:
        """PREFLIGHT_REBOOT_SHUTDOWN: refused while armed; silent for a moment, then as after a start."""
        if self.armed:
            return Result.DENIED if self.flavour.submodes else Result.FAILED
        self.booting_until = self.booted = self.now + REBOOT
        self.boots += 1
        self.failsafes = Failsafes(self)
        self.payload, self.critical = Payload(), False
        self.mission.jump(0)
        self.mode, self.home = self.kind.start, ZERO
        self._texts, self._setpoint_at = [], -math.inf
        self.apply_parameters()
        return Result.ACCEPTED

    def refuse(self, text: str) -> Result:
        """Say why not, with this autopilot's result for it."""
        self.say(text, Severity.CRITICAL)
        return self.flavour.refusal

    # -- time -----------------------------------------------------------------------------------------

    def step(self, dt: float) -> None:
        """Let `dt` seconds pass."""
        self.now += dt
        if self.booting:
            return
        self.failsafes.check(dt)
        self.payload.step(dt)
        self.battery.step(dt, armed=self.armed, flying=self.vehicle.airborne)
        fly(self)
        disarm_when_idle(self)
        suffer(self)
        if self.armed or self.vehicle.airborne:
            self.vehicle.step(dt)

    def fall_back(self, role: Role) -> None:
        """What a failsafe does; a rover stops where a copter would land."""
        if role is Role.TERMINATE:
            self.terminate()
        else:
            self.enter(self.kind.mode_for(role) or self.kind.mode_for(Role.HOLD))

    def enter(self, name: str) -> None:
        """Enter a mode, whoever wants it."""
        if name == self.mode:
            return
        self.mode = name
        self.apply_parameters()
        vehicle = self.vehicle
        vehicle.yaw_goal = vehicle.yaw_rate_goal = None
        vehicle.goal = Descend() if self.role is Role.LAND and self.armed else Rest()
        if self.role is Role.MISSION:
            first = 1 if self.flavour.home_item else 0
            self.mission.jump(max(self.mission.current, first) if self.mission.item else first)
        if self.role is Role.ORBIT and "CIRCLE_RADIUS" in self.parameters:
            vehicle.goal = circle_ahead(self)
        if self.role is Role.GUIDED:
            self.armed_at = self.now

    def _deny_arming(self, reason: str) -> Result:
        for text in self.flavour.denial:
            self.say(text.format(reason=reason), Severity.CRITICAL)
        return self.flavour.refusal
