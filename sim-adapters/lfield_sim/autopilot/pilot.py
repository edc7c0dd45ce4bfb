"""The state of a vehicle with its autopilot, and its changes by modes and failsafes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random

from msgspec.structs import replace

from lfield_sim.autopilot.body.estimator import Estimator
from lfield_sim.autopilot.body.goals import ZERO, Descend, Fall, Goal, Keep, Lean, Orbit, Rest, Sink, Vector
from lfield_sim.autopilot.equipment.payload import Battery, Payload
from lfield_sim.autopilot.flavours import Flavour, MavResult, Role, SpeedControl, VehicleKind
from lfield_sim.autopilot.ground_vehicle import GroundVehicle
from lfield_sim.autopilot.home import Home
from lfield_sim.autopilot.plans import BOUNDARY, CEILING, NO_BREACH, Fence, Mission, MissionItem, NoFence
from lfield_sim.autopilot.vehicle import Vehicle
from lfield_sim.state_log import Facts

#: Seconds of a restart.
REBOOT = 3.0
#: m/s below which a vehicle is at rest or hovers.
STILL = 0.05
#: Seconds that a setpoint is valid without a parameter for it.
SETPOINT_TIMEOUT = 3.0
#: Metres from home within which PX4 returns by a cone (RTL_MIN_DIST); beyond, at full height.
CONE_RADIUS = 10.0
#: Pending texts at most.
KEPT_TEXTS = 100


@dataclass(slots=True)
class Pilot:
    """State of the vehicle and its transitions when a mode is entered; `Autopilot` handles the commands.

    Faults: `refuse_arming` is a reason to refuse every arming, or ''; `gps_lost`, `compass_failed`,
    `motor_failed`; `gps_glitch` in metres north; `motor_power` is the share that one motor gives; `sticks` is
    a pilot who moves them; `warm_up` are the seconds after a start in which it is not healthy yet.

    altitude             of the local frame's origin above mean sea level, m
    setpoint_at          when the last setpoint arrived; stream_at the first of those without a pause
    takeoff_goal         the height in m that a takeoff of PX4 was given
    lifts_at, lift_goal  when the motors lift it in the present takeoff, and the down coordinate of its goal
    risen_to             the goal at which a takeoff has ended, which ArduCopter does not report
    entered_at, entered_down  time and down coordinate at the start of the mode; a climb changes the latter
    weak_at              the time since which a motor is too weak, minus infinity once that has been reported
    sinks_at             when a landing starts to descend: after a failsafe an ArduCopter hovers first
    on_its_way           of PX4's rover: the state that it reports as flying
    intended             the commanded mode, which a failsafe may have replaced
    resumes              the mode that PX4 goes back to after a landing
    station_at           when a packet of a ground station arrived last
    perform              executes the mission commands that have no position
    ailing, calibrating  the reason why a calibration prevents arming, or ''; whether a calibration runs
    sent_goal            of a rover, the last goal that it has reported as reached
    ignores_arm          after a motor test while armed it accepts arming and stays disarmed, until a restart
    """

    kind: VehicleKind
    battery: Battery = field(default_factory=Battery)
    refuse_arming: str = ""
    gps_lost: bool = False
    gps_glitch: float = 0.0
    compass_failed: bool = False
    motor_failed: bool = False
    motor_power: float = 1.0
    estimate: Estimator = field(init=False)
    sticks: bool = False
    warm_up: float = 0.0
    parameters: dict[str, float] = field(init=False)
    vehicle: Vehicle = field(init=False)
    payload: Payload = field(default_factory=Payload)
    mission: Mission = field(default_factory=Mission)
    fence: Fence = field(default_factory=NoFence)
    mode: str = field(init=False)
    intended: str = field(init=False)
    resumes: str = field(init=False)
    speed_control: SpeedControl = field(init=False)
    homing: Home = field(init=False)
    rng: Random = field(default_factory=lambda: Random(1))
    altitude: float = 488.0
    armed: bool = False
    critical: bool = False
    now: float = 0.0
    booted: float = 0.0
    booting_until: float = -1.0
    boots: int = 0
    armed_at: float = 0.0
    armed_first: float = 0.0
    on_its_way: bool = False
    touched_at: float | None = None
    was_landed: bool = True
    lifts_at: float | None = None
    sinks_at: float = 0.0
    weak_at: float = math.inf
    lift_goal: float = 0.0
    risen_to: Goal | None = None
    over_home_at: float | None = None
    entered_at: float = 0.0
    entered_down: float = 0.0
    setpoint_at: float = -math.inf
    stream_at: float = math.inf
    station_at: float = -math.inf
    takeoff_goal: float | None = None
    perform: Callable[[MissionItem], object] = lambda _: None
    ailing: str = ""
    calibrating: bool = False
    ignores_arm: bool = False
    sent_goal: Goal | None = None
    _texts: list[tuple[float, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.parameters, self.estimate = dict(self.kind.parameters), Estimator(self.flavour.blind)
        limits = replace(self.kind.limits)
        self.vehicle = (
            Vehicle(limits) if self.kind.name == "copter" else GroundVehicle(limits, wheels=self.kind.wheels)
        )
        self.speed_control = self.kind.speed_control(self.own_speed, lambda: self.vehicle.limits.top)
        self.homing = Home(self.rng)
        self.mode = self.intended = self.kind.start
        self.resumes = self.kind.mode_for(Role.HOLD)
        self.apply_parameters()
        self.speed_control.enter(guided=False)
        self.set_home(ZERO)

    # -- state ----------------------------------------------------------------------------------------

    @property
    def flavour(self) -> Flavour:
        """ArduPilot or PX4."""
        return self.kind.flavour

    @property
    def flies(self) -> bool:
        """Whether the vehicle is a copter."""
        return self.kind.name == "copter"

    @property
    def aloft(self) -> bool:
        """Whether the vehicle counts as off the ground: a flying copter, or PX4's rover on its way."""
        return self.vehicle.airborne if self.flies else self.on_its_way

    @property
    def settles(self) -> float:
        """Seconds at rest until the autopilot reports a landing."""
        return self.flavour.settles if self.flies else 0.0

    @property
    def landed(self) -> bool:
        """Whether the vehicle has been at rest for long enough to report a landing."""
        if self.aloft:
            return False
        return self.touched_at is None or self.now - self.touched_at >= self.settles

    @property
    def home(self) -> Vector:
        """The home position, in the local frame."""
        return self.homing.place

    @property
    def role(self) -> Role:
        """The role of the present mode."""
        return self.kind.modes[self.mode].role

    @property
    def uptime(self) -> float:
        """Seconds since the autopilot was switched on or restarted."""
        return max(0.0, self.now - self.booted)

    @property
    def booting(self) -> bool:
        """Whether the autopilot is restarting, neither sending nor receiving."""
        return self.now < self.booting_until

    def facts(self) -> Facts:
        """The log entries of the vehicle; `failsafe` is the state CRITICAL in its heartbeats."""
        return {
            "mode": self.mode,
            "armed": self.armed,
            "airborne": self.vehicle.airborne,
            "moving": math.hypot(*self.vehicle.velocity) > STILL,
            "failsafe": self.critical,
        }

    @property
    def setpoints_over(self) -> bool:
        """Whether the last setpoint is too old; positions of ArduPilot do not expire."""
        name = self.flavour.setpoint_timeout
        timeout = self.value(name) if name else SETPOINT_TIMEOUT
        old = self.now - self.setpoint_at > timeout + self.flavour.grace
        return old and (self.flavour.needs_stream or isinstance(self.vehicle.goal, Keep | Lean))

    @property
    def streams(self) -> bool:
        """Whether a stream of setpoints arrives."""
        return self.setpoint_at >= self.stream_at and not self.setpoints_over

    @property
    def return_height(self) -> float:
        """The height of a return above home, in metres."""
        name, scale = self.kind.return_height
        return min(self.value(name) / scale, 1000.0) if name else 0.0

    @property
    def return_pause(self) -> float:
        """Seconds that a return hovers over home before it descends."""
        name, scale = self.kind.return_pause
        return self.value(name) / scale if name else 0.0

    @property
    def takeoff_height(self) -> float:
        """PX4's takeoff height above home, in metres."""
        if self.takeoff_goal is not None:
            return self.takeoff_goal
        name = self.kind.takeoff_height
        return min(max(self.value(name), 0.5), 1000.0) if name else 2.5

    def fence_at(self, place: Vector) -> tuple[int, str]:
        """The fence that a position is beyond (FENCE_BREACH), with its text; (0, '') for none."""
        rule = self.flavour.fence
        if not self.value(rule.enable):
            return NO_BREACH, ""
        radius = self.value(rule.radius)
        if radius > 0 and math.dist(place[:2], self.home[:2]) > radius:
            return BOUNDARY, rule.circle_text
        ceiling = self.value(rule.ceiling) if rule.ceiling else 0.0
        if ceiling > 0 and self.home[2] - place[2] > ceiling:
            return CEILING, rule.ceiling_text
        shape = self.fence.breached(place)
        return (shape, rule.shape_text) if shape else (NO_BREACH, "")

    # -- parameters and texts -------------------------------------------------------------------------

    def value(self, name: str) -> float:
        """A parameter as a finite, non-negative number."""
        number = self.parameters[name]
        return min(number, 1e9) if number > 0.0 else 0.0

    def apply_parameters(self) -> None:
        """Takes motion limits and battery size from the parameters."""
        for limit in self.kind.speeds:
            if limit != "cruise":
                setattr(self.vehicle.limits, limit, self._limit(limit))
        flown = self.kind.mission_limits if self.role is Role.MISSION else {}
        for limit in self.kind.mission_limits:
            setattr(self.vehicle.limits, limit, flown.get(limit, getattr(self.kind.limits, limit)))
        self.battery.capacity = min(max(self.value(self.flavour.capacity), 1.0), 1e6)

    def own_speed(self) -> float:
        """The horizontal speed of the autopilot's own parameter."""
        return self._limit("cruise")

    def _limit(self, limit: str) -> float:
        name, scale = self.kind.speeds[limit]
        return min(max(self.value(name) / scale, 0.01), 100.0)

    def say(self, text: str) -> None:
        """Sends a status text."""
        self._texts = [*self._texts[-KEPT_TEXTS:], (self.now, text)]

    def pop_texts(self) -> list[str]:
        """The texts since the last call; without a station PX4 holds them back for a while."""
        if self.now - self.station_at > self.flavour.mute:
            return []
        since = self.now - self.flavour.stale
        texts, self._texts = self._texts, []
        return [text for at, text in texts if at >= since]

    # -- changes --------------------------------------------------------------------------------------

    def set_home(self, place: Vector, *, sent: bool = False) -> None:
        """Sets home in the local frame; a rover uses its own height, unless sent."""
        altitude = None if sent else self.kind.home_altitude
        down = place[2] if altitude is None else self.altitude - altitude
        self.homing.set_place((place[0], place[1], down))

    def command(self, name: str) -> None:
        """Enters a commanded mode."""
        self.intended = name
        self.enter(name)

    def go_on(self, role: Role) -> None:
        """Enters the mode that follows a completed one."""
        self.command(self.kind.mode_for(role))

    def enter(self, name: str) -> None:
        """Enters a mode."""
        if name == self.mode:
            return
        if self.role in (Role.HOLD, Role.GUIDED):
            self.resumes = self.mode
        self.mode, self.over_home_at, vehicle = name, None, self.vehicle
        self.entered_at, self.entered_down = self.now, vehicle.place[2]
        self.apply_parameters()
        self.speed_control.enter(guided=self.role is Role.GUIDED)
        vehicle.yaw_goal = vehicle.yaw_rate_goal = None
        vehicle.goal = self._first_goal()
        if self.kind.limits.eases and self.role in (Role.HOLD, Role.RETURN):
            vehicle.level()
        if self.role is Role.RETURN:
            self._start_return()
        if self.role is Role.MISSION:
            first = 1 if self.flavour.home_item else 0
            self.mission.jump(max(self.mission.current, first) if self.mission.item else first)
        if self.role is Role.ORBIT and "CIRCLE_RADIUS" in self.parameters:
            vehicle.goal = self._circle_ahead()
        if self.role is Role.GUIDED:
            self.armed_at = self.now

    def _start_return(self) -> None:
        """Starts a return: PX4 reports its height; its rover lands from the start."""
        place, home = self.vehicle.place, self.homing.start_return(self.vehicle.place, self.parameters)
        if not (self.flavour.takeoff_mode and self.armed and self.aloft):
            return
        if not self.flies:
            self.say("RTL: land at destination\t")
        climb = max(home[2] - place[2], self.return_height_at(math.dist(place[:2], home[:2])))
        top = self.altitude - self.home[2] + climb
        self.say(f"RTL: start return at {top:.0f} m ({climb:.0f} m above destination)\t")

    def return_height_at(self, distance: float) -> float:
        """The height of a return from `distance` away in metres above home: lower within the cone."""
        cone = self.flavour.return_cone
        is_in_cone = cone > 0.0 and distance <= CONE_RADIUS
        return min(self.return_height, cone * distance) if is_in_cone else self.return_height

    def _first_goal(self) -> Goal:
        """The initial goal of a mode; without a transmitter ArduPilot's throttle is down."""
        if not self.flies:
            return self.vehicle.released() if self.kind.modes[self.mode].by_hand else Rest()
        if self.armed and self.role is Role.LAND:
            return Descend()
        if self.armed and self.kind.modes[self.mode].by_hand and self.vehicle.airborne:
            return Sink()
        return Rest(self.kind.limits.eases * (self.role is Role.HOLD))

    def fall_back(self, role: Role, *, pause: float = 0.0) -> None:
        """Takes the action of a failsafe, a landing after a pause in s; a rover stops instead of landing."""
        if role is Role.TERMINATE:
            self.terminate()
        else:
            self.enter(self.kind.mode_for(role) or self.kind.mode_for(Role.HOLD))
        if pause and self.role is Role.LAND and self.kind.lands and not self.flavour.takeoff_mode:
            self.vehicle.goal, self.sinks_at = Rest(), self.now + pause

    def stop_moving(self) -> None:
        """Stops the vehicle: the setpoint has expired."""
        self.vehicle.goal, self.vehicle.yaw_rate_goal = Rest(self.kind.limits.eases), None

    def disarm(self, *, force: bool = False, text: str = "") -> MavResult:
        """COMPONENT_ARM_DISARM 0: refused in flight, unless forced."""
        if self.armed and self.flies and not (self.landed or force):
            if self.flavour.airborne_text:
                self.say(self.flavour.airborne_text)
            return self.flavour.refusal
        if self.armed:
            self.say(text or self.flavour.disarmed)
        self.armed = self.on_its_way = False
        if self.role is Role.TAKEOFF:
            # Otherwise the next arming would take off.
            self.go_on(Role.HOLD)
        self.vehicle.switch_off()
        return MavResult.ACCEPTED

    def terminate(self) -> MavResult:
        """DO_FLIGHTTERMINATION: the motors stop anywhere; PX4 stays armed in a special mode."""
        name = self.kind.mode_for(Role.TERMINATE)
        if not name or not self.armed:
            return self.disarm(force=True)
        self.critical = True
        self.say("Failsafe activated\t")
        self.say("Preflight Fail: Flight termination active")
        self.command(name)
        self.vehicle.goal = Fall() if self.vehicle.airborne else Rest()
        return MavResult.ACCEPTED

    def restart(self) -> None:
        """Restarts: silent for a moment, then as after a start; parameters and plans remain."""
        self.booting_until = self.booted = self.now + REBOOT
        self.boots += 1
        self.payload, self.critical = self.payload.restarted(), False
        self.ailing, self.calibrating, self.ignores_arm = "", False, False
        self.mission.jump(0)
        self.mode = self.intended = self.kind.start
        self._texts, self.setpoint_at, self.stream_at = [], -math.inf, math.inf
        self.apply_parameters()
        self.speed_control.enter(guided=False)
        self.set_home(ZERO)

    def switch_off(self) -> None:
        """Makes the vehicle permanently silent."""
        self.booting_until = math.inf

    def _circle_ahead(self) -> Orbit:
        """ArduCopter's CIRCLE: the centre is a radius (cm) ahead; CIRCLE_RATE is in degrees per second."""
        radius = min(max(self.value("CIRCLE_RADIUS") / 100.0, 1.0), 2000.0)
        (north, east, down), yaw = self.vehicle.place, self.vehicle.yaw
        centre = (north + radius * math.cos(yaw), east + radius * math.sin(yaw), down)
        return Orbit(centre, radius, math.radians(min(self.value("CIRCLE_RATE"), 90.0)) * radius)
