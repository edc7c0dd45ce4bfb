"""What an autopilot does with a vehicle: arming, modes, guided flight, missions, as commands ask for it.

Times and refusals are those measured on ArduPilot 4.7 and PX4 1.17; what tells them apart is data in
`flavours`. Pure: `step(dt)` moves time, everything else answers at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from lfield_sim.autopilot.failsafes import Failsafes
from lfield_sim.autopilot.flavours import Control, Kind, Result, Role, Severity
from lfield_sim.autopilot.flight import disarm_when_idle, fly, suffer
from lfield_sim.autopilot.missions import why_no_mission
from lfield_sim.autopilot.pilot import Pilot
from lfield_sim.autopilot.readiness import Unfit, why_unfit
from lfield_sim.autopilot.stacks import ardupilot, px4
from lfield_sim.autopilot.vehicle import Circle, Goal, Reach, Vector

#: Every vehicle there is, by flavour and kind.
FLAVOURS: Mapping[str, Mapping[str, Kind]] = {"ardupilot": ardupilot.KINDS, "px4": px4.KINDS}
KINDS = FLAVOURS["ardupilot"]


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What a guided vehicle is to do; a motion and a heading, each may be left open."""

    goal: Goal | None = None
    yaw: float | None = None
    yaw_rate: float | None = None
    control: Control = Control.VELOCITY


@dataclass(slots=True)
class Autopilot(Pilot):
    """One vehicle with its autopilot: a pilot that takes commands and has failsafes (faults: see `Pilot`)."""

    kind: Kind = KINDS["copter"]
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
        self.failsafes.check(dt)
        if self.flavour.drifts:
            self.homing.step(dt, self.vehicle.place, flying=self.vehicle.airborne)
        self.vehicle.limits.cruise = self.pace.speed
        self.payload.step(dt)
        self.battery.step(dt, armed=self.armed, flying=self.vehicle.airborne)
        fly(self)
        disarm_when_idle(self)
        suffer(self)
        if self.armed or self.vehicle.airborne:
            self.vehicle.step(dt)

    # -- arming ---------------------------------------------------------------------------------------

    @property
    def unfit(self) -> Unfit | None:
        """Why it cannot be armed now, None when it can."""
        rule = self.flavour.gcs
        if rule.forbids and self.failsafes.station_lost:
            return Unfit((rule.refusal,) if rule.refusal else None)
        return why_unfit(self)

    def arm(self, *, force: bool = False) -> Result:
        """COMPONENT_ARM_DISARM 1: accepted too when it is armed already."""
        if self.armed:
            return Result.ACCEPTED
        if not self.kind.modes[self.mode].armable:
            return self._deny_arming(Unfit((self.flavour.unarmable.format(mode=self.mode),)))
        if (unfit := self.unfit) and not force:
            return self._deny_arming(unfit)
        self.armed, self.armed_at, self.touched_at = True, self.now, None
        self.take_home(self.vehicle.place)
        self.pace.arm()
        self.say(self.flavour.armed)
        return Result.ACCEPTED

    def _deny_arming(self, unfit: Unfit) -> Result:
        texts = [] if unfit.reasons is None else [self.flavour.denial.format(reason=r) for r in unfit.reasons]
        if unfit.reasons is not None and self.flavour.verdict:
            texts.append(self.flavour.verdict)
        for text in texts:
            self.say(text, Severity.CRITICAL)
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
        """DO_SET_MODE with a custom mode, or SET_MODE."""
        name = self.kind.mode_name(number)
        if not name:
            self.say(f"No such mode {number}", Severity.WARNING)
            return Result.FAILED
        return self.command_mode(name)

    def command_mode(self, name: str) -> Result:
        """A mode by name. PX4 says yes to one that is not available, and stays in the one that it is in."""
        role = self.kind.modes[name].role
        if role is Role.MISSION and (reason := why_no_mission(self)):
            return self.refuse(reason)
        if role is Role.GUIDED and self.flavour.needs_stream and not self.streams:
            self.say(self.flavour.unavailable.format(mode="Offboard"), Severity.CRITICAL)
            return Result.ACCEPTED
        self.failsafes.commanded()
        self.command(name)
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
            self.takeoff_goal = height if height is not None and 0.0 < height < 1e4 else None
            return self.command_role(Role.TAKEOFF)
        if not self.armed:
            return self.refuse("Takeoff: not armed")
        if self.role is not Role.GUIDED:
            return self.refuse(f"Takeoff: not possible in {self.mode}")
        if self.vehicle.airborne or height is None or not 0.0 < height < 1e4:
            return Result.FAILED
        north, east, _ = self.vehicle.place
        self.pace.enter(guided=True)
        self.vehicle.goal = Reach((north, east, self.home[2] - height))
        return Result.ACCEPTED

    def start_mission(self, first: int | None = None) -> Result:
        """MISSION_START: the mission mode, from an item or from where it was left."""
        if first is not None and not self.mission.jump(first):
            return self.refuse(f"Mission: there is no item {first}")
        return self.command_role(Role.MISSION)

    def go_home(self) -> Result:
        """NAV_RETURN_TO_LAUNCH."""
        return self.command_role(Role.RETURN)

    def refuse(self, text: str) -> Result:
        """Say why not, with this autopilot's result for it."""
        self.say(text, Severity.CRITICAL)
        return self.flavour.refusal

    # -- guided flight --------------------------------------------------------------------------------

    def set_yaw(self, yaw: float) -> Result:
        """CONDITION_YAW to an absolute heading in radians."""
        if self.role not in (Role.GUIDED, Role.MISSION):
            return Result.FAILED
        self.vehicle.yaw_goal, self.vehicle.yaw_rate_goal = yaw, None
        return Result.ACCEPTED

    def set_speed(self, speed: float) -> Result:
        """DO_CHANGE_SPEED over ground."""
        return self.pace.change(speed)

    def reposition(
        self, place: Vector, yaw: float | None, *, change_mode: bool, speed: float | None = None
    ) -> Result:
        """DO_REPOSITION, with a speed or None: ArduPilot goes there in GUIDED, PX4 holds there."""
        if self.fence_at(place)[0] and not self.flavour.needs_stream:
            return Result.FAILED
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
        """DO_ORBIT: only what flies."""
        if not self.vehicle.airborne or circle.radius <= 0.0:
            return self.refuse("Orbit: not possible now")
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
        if self.role is not Role.GUIDED or not self.armed or not lifted:
            return
        if setpoint.goal is None and not self.flavour.needs_stream and self.flies:
            return
        if setpoint.goal is not None:
            self.pace.begin(setpoint.control)
            self.vehicle.goal = setpoint.goal
        if setpoint.yaw is not None or setpoint.yaw_rate is not None:
            self.vehicle.yaw_goal, self.vehicle.yaw_rate_goal = setpoint.yaw, setpoint.yaw_rate
