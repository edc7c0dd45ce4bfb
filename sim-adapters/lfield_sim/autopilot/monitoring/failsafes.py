"""The failsafes of one autopilot: ground station, setpoints, battery, position.

The rules are data (`flavours`); times and texts as measured on the real ones. A failsafe's mode remains until
another is commanded.
"""

from __future__ import annotations

from lfield_sim.autopilot.flavours import BatteryLevel, Role
from lfield_sim.autopilot.monitoring.fence_monitor import FenceMonitor
from lfield_sim.autopilot.pilot import Pilot

#: FS_OPTIONS bit 3: a landing continues on any failure; bit 4: a pilot's mode continues without a station,
#: and so does BRAKE (Copter::failsafe_gcs_on_event and Mode::is_autopilot of ArduCopter 4.7).
CONTINUE_LANDING, CONTINUE_PILOT = 0x8, 0x10
BY_A_PILOT = (Role.MANUAL, Role.HOLD)
CONTINUES = "GCS Failsafe - Continuing Pilot Control"
#: Seconds from a start until ArduPilot first checks the station (all recordings; the real figure is 0.137,
#: and received messages are a step late here).
FIRST_CHECK = 0.117
#: Seconds that an ArduCopter hovers before a failsafe landing, except for its fence.
LANDING_PAUSE = 4.0
#: COM_OBL_RC_ACT: PX4's action when setpoints end; without a radio control others mean return.
SETPOINT_ACTIONS = {4: Role.LAND, 5: Role.HOLD}
#: PX4's text when it acts at once.
FAILSAFE = "Failsafe activated\t"
#: Bits of COM_RC_OVERRIDE, and the mode that the sticks select.
STICKS_IN_AUTO, STICKS_IN_OFFBOARD, BY_STICKS = 1, 2, "POSCTL"


class Failsafes:
    """The failsafes of one autopilot; except for the ground station's they are checked while it is armed."""

    def __init__(self, pilot: Pilot) -> None:
        self._pilot = pilot
        self._rules = pilot.flavour
        self.gcs_contact_at: float | None = None
        self.gcs_lost = False
        self._is_reported_only = False
        self._is_gcs_back = False
        self._pending_action: tuple[float, Role] | None = None
        self._reported_levels: set[str] = set()
        #: Whether the battery failsafe has acted: it does so once, and an ArduPilot cannot be armed
        #: afterwards.
        self.battery_acted = False
        self._was_blind = False
        self._stream_missed = False
        self.fences = FenceMonitor(pilot)

    def heartbeat(self, system: int, *, station: bool) -> None:
        """Handles a heartbeat of another system; ArduPilot counts one system's, PX4 every ground station's.

        The link does not matter to either.
        """
        rule = self._rules.gcs
        if rule.station:
            first, last = (int(self._pilot.value(name)) for name in (rule.station, rule.stations_to))
            station = first <= system <= max(first, last)
        if not station:
            return
        self.gcs_contact_at = self._pilot.station_at = self._pilot.now
        if self.gcs_lost:
            self._is_gcs_back = True

    @property
    def station_lost(self) -> bool:
        """Whether the ground station was missing at the last check; PX4 updates it at once."""
        missed = self.gcs_lost and not self._is_reported_only
        return missed and (not self._is_gcs_back or self._rules.gcs.check_period > 0.0)

    def commanded(self) -> None:
        """Drops pending actions because of another command."""
        self._pending_action = None
        self.fences.commanded()
        if self._rules.needs_stream and not self.gcs_lost:
            self._pilot.critical = False

    def check(self, dt: float) -> None:
        """Runs all checks."""
        if (role := self.fences.check()) is not None:
            self._leave_fence(role)
        if self._is_check_due(dt):
            self._check_gcs()
        self._check_sticks()
        self._check_setpoints()
        self._check_battery()
        self._check_position()
        if self._pending_action is not None and self._pilot.now >= self._pending_action[0]:
            (_, role), self._pending_action = self._pending_action, None
            self._pilot.say(FAILSAFE)
            self._pilot.fall_back(role)

    # -- ground station and setpoints -----------------------------------------------------------------

    def _is_check_due(self, dt: float) -> bool:
        """Whether the station check is due: ArduPilot checks in a slow loop."""
        period, elapsed = self._rules.gcs.check_period, self._pilot.uptime - FIRST_CHECK
        return not period or elapsed % period < dt

    def _check_gcs(self) -> None:
        self._clear_gcs()
        pilot, rule = self._pilot, self._rules.gcs
        action = int(pilot.value(rule.action))
        is_disabled = rule.enable and not pilot.value(rule.enable)
        if self.gcs_contact_at is None or self.gcs_lost or is_disabled or not (action or rule.lost_text):
            return
        delay = pilot.value(rule.late) if isinstance(rule.late, str) else rule.late
        if pilot.now - self.gcs_contact_at <= pilot.value(rule.timeout) + delay:
            return
        if rule.acts_disarmed and pilot.role in (Role.HOLD, Role.RETURN):
            return
        self.gcs_lost, self._is_reported_only, self._is_gcs_back = True, not action, False
        for text in (rule.lost_text, rule.unfit_text if action else ""):
            if text:
                pilot.say(text)
        if not action:
            return
        if pilot.armed or rule.acts_disarmed:
            self._lose_gcs(rule.actions.get(action))
        elif not rule.pause:
            pilot.critical = True
            pilot.say(rule.text)

    def _clear_gcs(self) -> None:
        """Handles the return of the station: the failsafe ends a moment later."""
        pilot, rule = self._pilot, self._rules.gcs
        if not self._is_gcs_back:
            return
        # PX4's action remains a failsafe until another mode is commanded.
        pilot.critical = pilot.critical and bool(rule.pause) and pilot.mode != pilot.intended
        self.gcs_lost = False
        self._is_gcs_back, self._pending_action = False, None
        pilot.say(rule.cleared)

    def _lose_gcs(self, role: Role | None) -> None:
        pilot, rule = self._pilot, self._rules.gcs
        pilot.critical = True
        pause = pilot.value(rule.pause) if rule.pause and role is not Role.HOLD else 0.0
        lands_on = self._lands_on()
        hold_text = rule.hold_text.format(pause=pause) if pause else rule.text
        if not lands_on and pilot.role in BY_A_PILOT and self._has_option(CONTINUE_PILOT):
            pilot.say(CONTINUES)
            return
        pilot.say(rule.continue_text if lands_on else hold_text)
        if role is not None and not lands_on:
            self._act_after(pause, role)

    def _leave_fence(self, role: Role) -> None:
        """Starts the action outside the fence: ArduPilot's at once and not critical; PX4 holds for a while
        first.
        """
        pilot, rule = self._pilot, self._rules.fence
        if not rule.pause:
            if not self._lands_on():
                pilot.fall_back(role)
            return
        pilot.critical = True
        pause = 0.0 if role is Role.HOLD else pilot.value(rule.pause)
        pilot.say(rule.hold_text.format(pause=pause) if pause else FAILSAFE)
        self._act_after(pause, role)

    def _act_after(self, pause: float, role: Role) -> None:
        """Takes a role, after a hold of so many seconds if there is one."""
        if pause > 0.0:
            self._pilot.fall_back(Role.HOLD)
            self._pending_action = (self._pilot.now + pause, role)
        else:
            self._pilot.fall_back(role, pause=LANDING_PAUSE)

    def _lands_on(self) -> bool:
        """Whether the vehicle is landing and FS_OPTIONS bit 3 lets it continue."""
        return self._pilot.role is Role.LAND and self._has_option(CONTINUE_LANDING)

    def _has_option(self, bit: int) -> bool:
        options = self._rules.gcs.options
        return bool(options and int(self._pilot.value(options)) & bit)

    def _check_setpoints(self) -> None:
        """Handles the end of setpoints: ArduPilot stops a velocity, PX4 leaves the mode."""
        pilot = self._pilot
        if not self._is_guided() or not pilot.setpoints_over:
            self._stream_missed = False
            return
        if not self._rules.needs_stream:
            if self._rules.setpoint_text:
                pilot.say(self._rules.setpoint_text)
            pilot.stop_moving()
        elif pilot.armed and not self._stream_missed:
            self._stream_missed = pilot.critical = True
            pilot.say(FAILSAFE)
            pilot.fall_back(SETPOINT_ACTIONS.get(int(pilot.value("COM_OBL_RC_ACT")), Role.RETURN))

    def _check_sticks(self) -> None:
        """Gives control to moved sticks on a PX4 in the modes of COM_RC_OVERRIDE.

        ArduPilot ignores them in GUIDED.
        """
        pilot = self._pilot
        if not (pilot.sticks and pilot.armed and self._rules.needs_stream) or pilot.role is Role.MANUAL:
            return
        bit = STICKS_IN_OFFBOARD if pilot.role is Role.GUIDED else STICKS_IN_AUTO
        if int(pilot.value("COM_RC_OVERRIDE")) & bit:
            pilot.say("Pilot took over using sticks\t")
            pilot.command(BY_STICKS)

    def _is_guided(self) -> bool:
        """Whether setpoints are expected; also while a failsafe of PX4 holds the vehicle instead."""
        pilot = self._pilot
        holds = (
            self._rules.needs_stream
            and pilot.critical
            and pilot.role is Role.HOLD
            and self._pending_action is None
        )
        return pilot.role is Role.GUIDED or (holds and pilot.kind.modes[pilot.intended].role is Role.GUIDED)

    # -- battery ---------------------------------------------------------------------------------------

    def _check_battery(self) -> None:
        pilot = self._pilot
        for level in self._rules.battery:
            if (
                level.text not in self._reported_levels
                and pilot.armed
                and pilot.battery.charge < self._share(level)
            ):
                self._reported_levels.add(level.text)
                text = level.text.format(volts=pilot.battery.volts, used=pilot.battery.used)
                pilot.say(text)
                self._act(level.actions.get(int(pilot.value(level.action))))
        if pilot.battery.charge == 0.0 and pilot.vehicle.airborne and pilot.role is not Role.LAND:
            pilot.critical = True
            pilot.say("Battery 1 is empty: landing")
            pilot.fall_back(Role.LAND)

    def _share(self, level: BatteryLevel) -> float:
        threshold = self._pilot.value(level.threshold)
        return threshold / self._pilot.battery.capacity if level.of_capacity else threshold

    def _act(self, role: Role | None) -> None:
        if role is not None and not self._lands_on():
            self._pilot.critical = self.battery_acted = True
            if self._rules.battery_text:
                self._pilot.say(self._rules.battery_text)
            self._pilot.fall_back(role, pause=LANDING_PAUSE)

    # -- position --------------------------------------------------------------------------------------

    def _check_position(self) -> None:
        pilot = self._pilot
        blind = pilot.estimate.is_lost
        if self._was_blind and not blind and not self._rules.needs_stream:
            pilot.critical = False
        if blind and not self._was_blind and pilot.armed and pilot.role is not Role.MANUAL:
            pilot.critical = True
            if not self._rules.needs_stream:
                pilot.say("EKF variance")
            pilot.say(self._rules.position_lost)
            pilot.fall_back(Role.LAND, pause=LANDING_PAUSE)
        self._was_blind = blind and pilot.armed
