"""What an autopilot does with a vehicle: arming, modes, guided flight, missions, as commands ask for it.

Times and refusals are those measured on ArduPilot 4.7 and PX4 1.17; what tells them apart is data in
`flavours`. Pure: `step(dt)` moves time, everything else answers at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from lfield_sim.autopilot.body.goals import ZERO, Circle, Fall, Goal, Keep, Lean, Reach, Vector
from lfield_sim.autopilot.flavours import Control, Kind, Result, Role
from lfield_sim.autopilot.flight import fly, suffer
from lfield_sim.autopilot.lifting import begin_takeoff, disarm_when_idle, rise
from lfield_sim.autopilot.missions import why_no_mission
from lfield_sim.autopilot.pace import RoverPace
from lfield_sim.autopilot.pilot import Pilot
from lfield_sim.autopilot.stacks import ardupilot, px4
from lfield_sim.autopilot.watch.failsafes import Failsafes
from lfield_sim.autopilot.watch.readiness import Unfit, news, why_unfit

#: Every vehicle there is, by flavour and kind.
FLAVOURS: Mapping[str, Mapping[str, Kind]] = {"ardupilot": ardupilot.KINDS, "px4": px4.KINDS}
KINDS = FLAVOURS["ardupilot"]
#: What needs a position, in PX4's words.
PLACED = {
    Role.GUIDED: "Offboard",
    Role.HOLD: "Hold",
    Role.RETURN: "Return",
    Role.MISSION: "Mission",
    Role.ORBIT: "Orbit",
    Role.TAKEOFF: "Takeoff",
}


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What a guided vehicle is to do; a motion and a heading, each may be left open."""

    goal: Goal | None = None
    yaw: float | None = None
    yaw_rate: float | None = None
    control: Control = Control.VELOCITY


@dataclass(slots=True)
class Autopilot(Pilot):
    """One vehicle with its autopilot: a pilot that takes commands and has failsafes (faults: see `Pilot`).

    `board` is the number of its board, in 96 bits, which nothing changes; 0 when it tells none.
    """

    kind: Kind = KINDS["copter"]
    board: int = 0
    failsafes: Failsafes = field(init=False)

    def __post_init__(self) -> None:
        # A class with slots is made twice: super() without arguments would mean the first one.
        Pilot.__post_init__(self)
        self.failsafes = Failsafes(self)

    def step(self, dt: float) -> None:
        """Let `dt` seconds pass."""
        self.now += dt
        if self.booting:
            return
        for text in news(self, dt):
            self.say(text)
        for text in self.estimate.step(
            dt,
            gps_lost=self.gps_lost,
            glitch=self.gps_glitch,
            compass_failed=self.compass_failed,
            talks=self.flies and not self.flavour.submodes,
        ):
            self.say(text)
        self.failsafes.check(dt)
        if self.flavour.drifts:
            self.homing.step(dt, self.vehicle.place, flying=self.vehicle.airborne)
        self.vehicle.limits.cruise = self.pace.speed
        if isinstance(self.pace, RoverPace):
            self.vehicle.limits.shoots_over = self.pace.is_commanded
        self.payload.step(dt)
        self.battery.step(dt, armed=self.armed, flying=self.vehicle.airborne, load=self.vehicle.wind.load)
        self.vehicle.wind.step(dt)
        fly(self)
        rise(self)
        disarm_when_idle(self)
        suffer(self)
        if self.armed or self.vehicle.airborne or self.vehicle.velocity != ZERO:
            self.vehicle.step(dt)

    # -- arming ---------------------------------------------------------------------------------------

    @property
    def unfit(self) -> Unfit | None:
        """Why it cannot be armed now, None when it can."""
        rule = self.flavour.gcs
        if rule.forbids and self.failsafes.station_lost:
            return Unfit((rule.refusal,) if rule.refusal else None)
        if self.failsafes.battery_acted and self.flavour.battery_refusal:
            return Unfit((self.flavour.battery_refusal,))
        if self.failsafes.fences.breach and self.flavour.submodes:
            return Unfit(())
        if not (self.flies or self.flavour.submodes or self.kind.modes[self.mode].armable):
            return Unfit((self.flavour.unarmable.format(mode=self.mode),))
        if self.flavour.submodes and self.role in (Role.MANUAL, Role.TERMINATE):
            # By hand it needs a transmitter; after a termination nothing helps.
            return Unfit(())
        return why_unfit(self)

    def arm(self, *, force: bool = False, text: str = "") -> Result:
        """COMPONENT_ARM_DISARM 1: accepted too when it is armed already."""
        if self.armed or self.deaf_to_arming:
            return Result.ACCEPTED
        if not self.kind.modes[self.mode].armable:
            return self._deny_arming(Unfit((self.flavour.unarmable.format(mode=self.mode),)))
        if (unfit := self.unfit) and not force:
            return self._deny_arming(unfit)
        self.armed, self.armed_at, self.armed_first, self.touched_at = True, self.now, self.now, None
        self.take_home(self.vehicle.place)
        self.pace.arm()
        self.say(text or self.flavour.armed)
        return Result.ACCEPTED

    def _deny_arming(self, unfit: Unfit) -> Result:
        texts = [] if unfit.reasons is None else [self.flavour.denial.format(reason=r) for r in unfit.reasons]
        if unfit.reasons is not None and self.flavour.verdict:
            texts.append(self.flavour.verdict)
        for text in texts:
            self.say(text)
        return self.flavour.refusal

    def reboot(self) -> Result:
        """PREFLIGHT_REBOOT_SHUTDOWN: refused while armed; silent for a moment, then as after a start."""
        if self.armed:
            return Result.DENIED if self.flavour.submodes else Result.FAILED
        self.restart()
        self.failsafes = Failsafes(self)
        return Result.ACCEPTED

    # -- modes ----------------------------------------------------------------------------------------

    def set_mode(self, number: int) -> Result:
        """DO_SET_MODE with a custom mode, or SET_MODE. PX4 says yes to one that it does not have."""
        name = self.kind.mode_name(number)
        if name:
            return self.command_mode(name)
        if self.flavour.submodes:
            return Result.ACCEPTED
        self.say(f"No such mode {number}")
        return Result.FAILED

    def command_mode(self, name: str) -> Result:
        """A mode by name. PX4 says yes to one that is not available, and stays in the one that it is in."""
        if texts := self._why_not(name):
            for text in texts:
                self.say(text)
            # PX4 accepts a mode that is not available, but for one that lacks a position.
            accepts = self.flavour.submodes and not self._is_lost
            return Result.ACCEPTED if accepts else self.flavour.refusal
        self.failsafes.commanded()
        self.command(name)
        return Result.ACCEPTED

    @property
    def _is_lost(self) -> bool:
        """Whether it flies and knows no position any more."""
        return self.estimate.is_lost and self.armed

    def _why_not(self, name: str) -> tuple[str, ...]:
        """What is said when a mode cannot be entered now, nothing when it can."""
        role, flavour = self.kind.modes[name].role, self.flavour
        if self._is_lost and role in PLACED:
            return (flavour.blind.refusal.format(mode=PLACED[role] if flavour.submodes else name),)
        if role is Role.MISSION:
            return why_no_mission(self)
        if role is Role.GUIDED and flavour.needs_stream and not self.streams:
            return (flavour.unavailable.format(mode="Offboard"),)
        if role is Role.MANUAL and flavour.submodes and self.vehicle.airborne:
            return (flavour.unavailable.format(mode="Altitude" if name == "ALTCTL" else "Position"),)
        return ()

    def command_role(self, role: Role) -> Result:
        """The mode that has a role; UNSUPPORTED when there is none (a rover does not land)."""
        name = self.kind.mode_for(role)
        return self.command_mode(name) if name else Result.UNSUPPORTED

    def takeoff(self, height: float | None) -> Result:
        """NAV_TAKEOFF to a height above home; None is the one PX4 has as a parameter.

        ArduPilot: only armed, in GUIDED, from the ground. PX4 enters a mode and says yes in any case.
        """
        if not self.kind.lands:
            return Result.UNSUPPORTED
        if self.flavour.takeoff_mode:
            return self._enter_takeoff(height)
        ready = self.armed and self.role is Role.GUIDED and not self.vehicle.airborne
        if not ready or height is None or not 0.0 < height < 1e4:
            return Result.FAILED
        begin_takeoff(self, self.home[2] - height)
        return Result.ACCEPTED

    def _enter_takeoff(self, height: float | None) -> Result:
        """PX4's mode for it, disarmed too; whoever is higher already stays there."""
        self.takeoff_goal = height if height is not None and 0.0 < height < 1e4 else None
        if height is None:
            self.say(f"Using default takeoff altitude: {self.takeoff_height:.1f} m\t")
        wanted = self.takeoff_height if height is None else height
        if self.vehicle.airborne and self.homing.ground - self.vehicle.place[2] > wanted:
            self.say("Already higher than takeoff altitude\t")
            return self.command_role(Role.HOLD)
        return self.command_role(Role.TAKEOFF)

    def start_mission(self, first: int | None = None) -> Result:
        """MISSION_START: the mission mode, from an item or from where it was left."""
        if first is not None and not self.mission.jump(first):
            return self.refuse(f"Mission: there is no item {first}")
        if self.flavour.takeoff_mode and self.mission.items and not self.armed:
            self.enter(self.kind.mode_for(Role.HOLD))
            if (result := self.arm(text="Armed by mission start\t")) is not Result.ACCEPTED:
                return result
        return self.command_role(Role.MISSION)

    def go_home(self) -> Result:
        """NAV_RETURN_TO_LAUNCH."""
        return self.command_role(Role.RETURN)

    def refuse(self, text: str) -> Result:
        """Say why not, with this autopilot's result for it."""
        self.say(text)
        return self.flavour.refusal

    # -- guided flight --------------------------------------------------------------------------------

    def set_yaw(self, yaw: float) -> Result:
        """CONDITION_YAW to an absolute heading in radians; other modes accept it and do not turn."""
        if self.role not in (Role.GUIDED, Role.MISSION):
            return Result.ACCEPTED
        self.vehicle.yaw_goal, self.vehicle.yaw_rate_goal = yaw, None
        return Result.ACCEPTED

    def set_speed(self, speed: float) -> Result:
        """DO_CHANGE_SPEED over ground."""
        return self.pace.change(speed)

    def reposition(
        self, place: Vector, yaw: float | None, *, change_mode: bool, speed: float | None = None
    ) -> Result:
        """DO_REPOSITION, with a speed or None: ArduPilot goes there in GUIDED, PX4 holds there."""
        if not self.failsafes.fences.takes(place):
            return Result.ACCEPTED if self.flavour.needs_stream else Result.FAILED
        role = Role.HOLD if self.flavour.needs_stream else Role.GUIDED
        if self.role is not role and not change_mode:
            return Result.DENIED
        self.command_role(role)
        if not self.pace.begin(Control.PLACE, speed):
            return Result.FAILED
        if self.armed and (self.vehicle.airborne or not self.flies):
            self.vehicle.goal, self.vehicle.yaw_goal = Reach(place), yaw
        return Result.ACCEPTED

    def orbit(self, circle: Circle) -> Result:
        """DO_ORBIT, PX4's: accepted on the ground too, where nothing comes of it."""
        if not self.vehicle.airborne or circle.radius <= 0.0:
            return Result.ACCEPTED
        result = self.command_role(Role.ORBIT)
        self.vehicle.goal = circle
        return result

    def guide(self, setpoint: Setpoint) -> None:
        """A setpoint; ignored, as on the real thing, when it cannot be followed."""
        if self.setpoints_over or not self.setpoint_at > -math.inf:
            self.stream_at = self.now
        self.setpoint_at = self.now
        # An ArduCopter on the ground follows no setpoint: it takes a takeoff to leave it.
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
            # A rover takes a heading alone for a velocity of nothing.
            setpoint = replace(setpoint, goal=Keep(ZERO))
        if isinstance(setpoint.goal, Reach) and not self.failsafes.fences.takes(setpoint.goal.place):
            return
        if setpoint.goal is not None:
            self.pace.begin(setpoint.control)
            # A rate of turn ends with the next setpoint that does not name one; a heading stays.
            self.vehicle.goal, self.vehicle.yaw_rate_goal = setpoint.goal, None
        if setpoint.yaw is not None or setpoint.yaw_rate is not None:
            self.vehicle.yaw_goal, self.vehicle.yaw_rate_goal = setpoint.yaw, setpoint.yaw_rate
