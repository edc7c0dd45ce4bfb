"""Commands of an autopilot: arming, modes, guided flight, missions.

Times and refusals as measured on ArduPilot 4.7 and PX4 1.17; differences are data in `flavours`. Pure:
`step(dt)` advances time, all other methods respond at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from msgspec import Struct
from msgspec.structs import replace

from lfield_sim.autopilot.body.goals import ZERO, Fall, Goal, Keep, Lean, Orbit, Reach, Vector
from lfield_sim.autopilot.flavours import MavResult, Role, SetpointControl, VehicleKind
from lfield_sim.autopilot.flight_modes import apply_motor_faults, fly
from lfield_sim.autopilot.mission_flight import mission_refusal
from lfield_sim.autopilot.monitoring.arming_readiness import ArmingRefusal, arming_refusal, new_texts
from lfield_sim.autopilot.monitoring.failsafes import Failsafes
from lfield_sim.autopilot.pilot import Pilot
from lfield_sim.autopilot.speed_control import RoverSpeedControl
from lfield_sim.autopilot.stacks import ardupilot, px4
from lfield_sim.autopilot.takeoff_landing import disarm_when_idle, rise, start_takeoff

#: Every vehicle kind, by flavour.
FLAVOURS: Mapping[str, Mapping[str, VehicleKind]] = {"ardupilot": ardupilot.KINDS, "px4": px4.KINDS}
KINDS = FLAVOURS["ardupilot"]
#: Modes that need a position, in PX4's words.
POSITION_MODES = {
    Role.GUIDED: "Offboard",
    Role.HOLD: "Hold",
    Role.RETURN: "Return",
    Role.MISSION: "Mission",
    Role.ORBIT: "Orbit",
    Role.TAKEOFF: "Takeoff",
}


class Setpoint(Struct, frozen=True):
    """A setpoint; motion and heading are optional."""

    goal: Goal | None = None
    yaw: float | None = None
    yaw_rate: float | None = None
    control: SetpointControl = SetpointControl.VELOCITY


@dataclass(slots=True)
class Autopilot(Pilot):
    """One vehicle with its autopilot: handles commands and has failsafes (faults: see `Pilot`).

    `board` is the constant 96-bit id of its board; 0 without one.
    """

    kind: VehicleKind = KINDS["copter"]
    board: int = 0
    failsafes: Failsafes = field(init=False)

    def __post_init__(self) -> None:
        # A class with slots is created twice: super() without arguments would refer to the first one.
        Pilot.__post_init__(self)
        self.failsafes = Failsafes(self)

    def step(self, dt: float) -> None:
        """Advances time by `dt` seconds."""
        self.now += dt
        if self.booting:
            return
        for text in new_texts(self, dt):
            self.say(text)
        for text in self.estimate.step(
            dt,
            gps_lost=self.gps_lost,
            glitch=self.gps_glitch,
            compass_failed=self.compass_failed,
            reports_glitches=self.flies and not self.flavour.submodes,
        ):
            self.say(text)
        self.failsafes.check(dt)
        if self.flavour.drifts:
            self.homing.step(dt, self.vehicle.place, flying=self.vehicle.airborne)
        self.vehicle.limits.cruise = self.speed_control.speed
        if isinstance(self.speed_control, RoverSpeedControl):
            self.vehicle.limits.shoots_over = self.speed_control.is_commanded
        self.payload.step(dt, self.now, self.vehicle.place, self.vehicle.yaw)
        self.battery.step(dt, armed=self.armed, flying=self.vehicle.airborne, load=self.vehicle.wind.load)
        self.vehicle.wind.step(dt)
        fly(self)
        rise(self)
        disarm_when_idle(self)
        apply_motor_faults(self)
        if self.armed or self.vehicle.airborne or self.vehicle.velocity != ZERO:
            self.vehicle.step(dt)

    # -- arming ---------------------------------------------------------------------------------------

    @property
    def unfit(self) -> ArmingRefusal | None:
        """The reason why the vehicle cannot be armed now, None when it can."""
        rule = self.flavour.gcs
        if rule.forbids and self.failsafes.station_lost:
            return ArmingRefusal((rule.refusal,) if rule.refusal else None)
        if self.failsafes.battery_acted and self.flavour.battery_refusal:
            return ArmingRefusal((self.flavour.battery_refusal,))
        if self.failsafes.fences.breach and self.flavour.submodes:
            return ArmingRefusal(())
        if not (self.flies or self.flavour.submodes or self.kind.modes[self.mode].armable):
            return ArmingRefusal((self.flavour.unarmable.format(mode=self.mode),))
        if self.flavour.submodes and self.role in (Role.MANUAL, Role.TERMINATE):
            # Manual arming needs a transmitter; after a termination it is impossible.
            return ArmingRefusal(())
        return arming_refusal(self)

    def arm(self, *, force: bool = False, text: str = "") -> MavResult:
        """COMPONENT_ARM_DISARM 1: also accepted when armed."""
        if self.armed or self.ignores_arm:
            return MavResult.ACCEPTED
        if not self.kind.modes[self.mode].armable:
            return self._deny_arming(ArmingRefusal((self.flavour.unarmable.format(mode=self.mode),)))
        if (unfit := self.unfit) and not force:
            return self._deny_arming(unfit)
        self.armed, self.armed_at, self.armed_first, self.touched_at = True, self.now, self.now, None
        self.set_home(self.vehicle.place)
        self.speed_control.arm()
        self.say(text or self.flavour.armed)
        return MavResult.ACCEPTED

    def _deny_arming(self, unfit: ArmingRefusal) -> MavResult:
        texts = [] if unfit.reasons is None else [self.flavour.denial.format(reason=r) for r in unfit.reasons]
        if unfit.reasons is not None and self.flavour.verdict:
            texts.append(self.flavour.verdict)
        for text in texts:
            self.say(text)
        return self.flavour.refusal

    def reboot(self) -> MavResult:
        """PREFLIGHT_REBOOT_SHUTDOWN: refused while armed; silent for a moment, then as after a start."""
        if self.armed:
            return MavResult.DENIED if self.flavour.submodes else MavResult.FAILED
        self.restart()
        self.failsafes = Failsafes(self)
        return MavResult.ACCEPTED

    # -- modes ----------------------------------------------------------------------------------------

    def set_mode(self, number: int) -> MavResult:
        """DO_SET_MODE with a custom mode, or SET_MODE. PX4 accepts unknown ones."""
        name = self.kind.mode_name(number)
        if name:
            return self.command_mode(name)
        if self.flavour.submodes:
            return MavResult.ACCEPTED
        self.say(f"No such mode {number}")
        return MavResult.FAILED

    def command_mode(self, name: str) -> MavResult:
        """Enters a mode by name. PX4 accepts an unavailable one and stays in its mode."""
        if texts := self._mode_refusal(name):
            for text in texts:
                self.say(text)
            # PX4 accepts an unavailable mode, except one that lacks a position.
            accepts = self.flavour.submodes and not self._is_lost
            return MavResult.ACCEPTED if accepts else self.flavour.refusal
        self.failsafes.commanded()
        self.command(name)
        return MavResult.ACCEPTED

    @property
    def _is_lost(self) -> bool:
        """Whether the vehicle flies without a position."""
        return self.estimate.is_lost and self.armed

    def _mode_refusal(self, name: str) -> tuple[str, ...]:
        """The texts when a mode cannot be entered now, empty when it can."""
        role, flavour = self.kind.modes[name].role, self.flavour
        if self._is_lost and role in POSITION_MODES:
            return (flavour.blind.refusal.format(mode=POSITION_MODES[role] if flavour.submodes else name),)
        if role is Role.MISSION:
            return mission_refusal(self)
        if role is Role.GUIDED and flavour.needs_stream and not self.streams:
            return (flavour.unavailable.format(mode="Offboard"),)
        if role is Role.MANUAL and flavour.submodes and self.vehicle.airborne:
            return (flavour.unavailable.format(mode="Altitude" if name == "ALTCTL" else "Position"),)
        return ()

    def command_role(self, role: Role) -> MavResult:
        """Enters the mode of a role; UNSUPPORTED without one (a rover does not land)."""
        name = self.kind.mode_for(role)
        return self.command_mode(name) if name else MavResult.UNSUPPORTED

    def takeoff(self, height: float | None) -> MavResult:
        """NAV_TAKEOFF to a height above home; None: PX4's parameter.

        ArduPilot: only armed, in GUIDED, on the ground. PX4 accepts it and enters a mode in any case.
        """
        if not self.kind.lands:
            return MavResult.UNSUPPORTED
        if self.flavour.takeoff_mode:
            return self._enter_takeoff(height)
        ready = self.armed and self.role is Role.GUIDED and not self.vehicle.airborne
        if not ready or height is None or not 0.0 < height < 1e4:
            return MavResult.FAILED
        start_takeoff(self, self.home[2] - height)
        return MavResult.ACCEPTED

    def _enter_takeoff(self, height: float | None) -> MavResult:
        """PX4's takeoff mode, also when disarmed; a vehicle that is higher already stays there."""
        self.takeoff_goal = height if height is not None and 0.0 < height < 1e4 else None
        if height is None:
            self.say(f"Using default takeoff altitude: {self.takeoff_height:.1f} m\t")
        target = self.takeoff_height if height is None else height
        if self.vehicle.airborne and self.homing.ground - self.vehicle.place[2] > target:
            self.say("Already higher than takeoff altitude\t")
            return self.command_role(Role.HOLD)
        return self.command_role(Role.TAKEOFF)

    def start_mission(self, first: int | None = None) -> MavResult:
        """MISSION_START: enters the mission mode, from an item or from the current one."""
        if first is not None and not self.mission.jump(first):
            return self.refuse(f"Mission: there is no item {first}")
        if self.flavour.takeoff_mode and self.mission.items and not self.armed:
            self.enter(self.kind.mode_for(Role.HOLD))
            if (result := self.arm(text="Armed by mission start\t")) is not MavResult.ACCEPTED:
                return result
        return self.command_role(Role.MISSION)

    def go_home(self) -> MavResult:
        """NAV_RETURN_TO_LAUNCH."""
        return self.command_role(Role.RETURN)

    def refuse(self, text: str) -> MavResult:
        """Sends the reason, and returns this autopilot's result for a refusal."""
        self.say(text)
        return self.flavour.refusal

    # -- guided flight --------------------------------------------------------------------------------

    def set_yaw(self, yaw: float) -> MavResult:
        """CONDITION_YAW to an absolute heading in radians; other modes accept it without effect."""
        if self.role not in (Role.GUIDED, Role.MISSION):
            return MavResult.ACCEPTED
        self.vehicle.yaw_goal, self.vehicle.yaw_rate_goal = yaw, None
        return MavResult.ACCEPTED

    def set_speed(self, speed: float) -> MavResult:
        """DO_CHANGE_SPEED over ground."""
        return self.speed_control.change(speed)

    def reposition(
        self, place: Vector, yaw: float | None, *, change_mode: bool, speed: float | None = None
    ) -> MavResult:
        """DO_REPOSITION, with a speed or None: ArduPilot flies there in GUIDED, PX4 holds there."""
        if not self.failsafes.fences.accepts(place):
            return MavResult.ACCEPTED if self.flavour.needs_stream else MavResult.FAILED
        role = Role.HOLD if self.flavour.needs_stream else Role.GUIDED
        if self.role is not role and not change_mode:
            return MavResult.DENIED
        self.command_role(role)
        if not self.speed_control.start(SetpointControl.PLACE, speed):
            return MavResult.FAILED
        if self.armed and (self.vehicle.airborne or not self.flies):
            self.vehicle.goal, self.vehicle.yaw_goal = Reach(place), yaw
        return MavResult.ACCEPTED

    def orbit(self, circle: Orbit) -> MavResult:
        """DO_ORBIT of PX4: also accepted on the ground, without effect."""
        if not self.vehicle.airborne or circle.radius <= 0.0:
            return MavResult.ACCEPTED
        result = self.command_role(Role.ORBIT)
        self.vehicle.goal = circle
        return result

    def guide(self, setpoint: Setpoint) -> None:
        """Follows a setpoint; ignored when it cannot be followed, as by the real autopilot."""
        if self.setpoints_over or not self.setpoint_at > -math.inf:
            self.stream_at = self.now
        self.setpoint_at = self.now
        # An ArduCopter on the ground ignores setpoints until a takeoff.
        lifted = self.vehicle.airborne or not self.flies or self.flavour.needs_stream
        falls = self.motor_failed and isinstance(self.vehicle.goal, Fall)
        if self.role is not Role.GUIDED or not self.armed or not lifted or falls:
            return
        if isinstance(setpoint.goal, Lean) and self.flavour.ignored_text:
            self.say(self.flavour.ignored_text)
            return
        if setpoint.goal is None and not self.flavour.needs_stream:
            if self.flies:
                return
            # A rover takes a heading alone as a velocity of zero.
            setpoint = replace(setpoint, goal=Keep(ZERO))
        if isinstance(setpoint.goal, Reach) and not self.failsafes.fences.accepts(setpoint.goal.place):
            return
        if setpoint.goal is not None:
            self.speed_control.start(setpoint.control)
            # A yaw rate ends with the next setpoint without one; a heading remains.
            self.vehicle.goal, self.vehicle.yaw_rate_goal = setpoint.goal, None
        if setpoint.yaw is not None or setpoint.yaw_rate is not None:
            self.vehicle.yaw_goal, self.vehicle.yaw_rate_goal = setpoint.yaw, setpoint.yaw_rate
