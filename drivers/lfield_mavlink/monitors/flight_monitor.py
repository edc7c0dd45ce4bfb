"""Monitors of one vehicle: messages in; exceptions for motions and lock-outs for crashes out."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from lfield.driver import DeviceError
from lfield_mavlink import log_messages
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.geodesy import Place, Vector
from lfield_mavlink.link.dialect import dialect, request_message
from lfield_mavlink.modes import ARDUPILOT, PX4
from lfield_mavlink.monitors.descent_monitor import DESCENT, DescentMonitor, Expected, Finding
from lfield_mavlink.monitors.position_monitor import FIX, PositionMonitor
from lfield_mavlink.monitors.target_monitor import CourseMonitor, TargetMonitor
from lfield_mavlink.services.parameters import Parameters
from lfield_mavlink.setpoints.motion_orders import Order
from lfield_mavlink.setpoints.trajectory import ONLY_POSITION, POSITION_AND_YAW, Target

#: Seconds until the result for a vehicle whose motors went off in the air is known.
SETTLES = 2.5
#: Seconds after which a second receiver is queried again while the first has no fix.
GPS_RETRY_INTERVAL = 0.4
#: Seconds until the descent speeds are read, and until they are read again.
FIRST_READ_DELAY, REREAD_INTERVAL = 2.0, 60.0
#: Instructions that are allowed during a fall.
STOPS = ("land", "hold", "disarm", "mode ", "returnHome")
#: Instructions and modes that need no position.
NEEDS_NONE = ("land", "arm", "disarm")
BLIND_MODES = frozenset(
    {
        "STABILIZE", "ACRO", "ALT_HOLD", "LAND", "MANUAL", "HOLD", "FBWA", "TRAINING", "SURFACE",
        "STABILIZED", "ALTCTL", "AUTO.LAND",
    }
)  # fmt: skip
#: MAV_FRAMEs with heights above mean sea level.
ABOVE_SEA = (dialect.MAV_FRAME_GLOBAL, dialect.MAV_FRAME_GLOBAL_INT)
#: type_mask: no horizontal position, no height, no velocity.
NO_PLACE, NO_HEIGHT, NO_VELOCITY = 0x3, 0x4, 0x38
#: The autopilot's own descent speeds. Each has parameter names by version, with units per m/s;
#: https://ardupilot.org/copter/docs/parameters.html, and PX4's parameter reference.
DESCENTS: Mapping[tuple[int, str], tuple[Mapping[str, float], ...]] = {
    (ARDUPILOT, "copter"): (
        {"WP_SPD_DN": 1.0, "WPNAV_SPEED_DN": 100.0},
        {"LAND_SPD_HIGH_MS": 1.0, "LAND_SPEED_HIGH": 100.0},
    ),
    (PX4, "copter"): ({"MPC_Z_VEL_MAX_DN": 1.0},),
}
#: The autopilot's landing speeds, likewise.
LANDINGS: Mapping[tuple[int, str], tuple[Mapping[str, float], ...]] = {
    (ARDUPILOT, "copter"): ({"LAND_SPD_MS": 1.0, "LAND_SPEED": 100.0},),
    (PX4, "copter"): ({"MPC_LAND_SPEED": 1.0},),
}


class FlightMonitor:
    """Monitors one vehicle.

    `others` names another station that has just commanded it; `is_ours` returns whether this program selected
    its mode.
    """

    def __init__(
        self, vehicle: Contact, parameters: Parameters, others: Callable[[], str], is_ours: Callable[[], bool]
    ) -> None:
        self.others, self.is_ours = others, is_ours
        self._vehicle, self._state, self._parameters = vehicle, vehicle.state, parameters
        self._descent, self._position = DescentMonitor(), PositionMonitor()
        self._target, self._course = TargetMonitor(level=vehicle.state.kind != "rover"), CourseMonitor()
        #: The foreign controller, until it is released or on the ground; '' for none.
        self.foreign = ""
        # The modes of the last command, in which its targets are compared.
        self._modes: frozenset[str] = frozenset()
        self._booted, self._booted_at = 0, -math.inf
        self._second_at = -math.inf
        handlers = {
            dialect.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            dialect.MAVLINK_MSG_ID_CURRENT_MODE: self._on_mode,
            dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._on_position,
            dialect.MAVLINK_MSG_ID_ATTITUDE: self._on_attitude,
            dialect.MAVLINK_MSG_ID_STATUSTEXT: self._on_text,
            dialect.MAVLINK_MSG_ID_GPS_RAW_INT: self._on_gps,
            dialect.MAVLINK_MSG_ID_GPS2_RAW: self._on_second_gps,
            dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT: self._on_estimate,
            dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: self._on_estimate,
            dialect.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: self._on_global_target,
            dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: self._on_local_target,
            dialect.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: self._on_distance,
        }
        for kind, handler in handlers.items():
            vehicle.on(kind, handler)

    # -- queries ------------------------------------------------------------------------------------------

    @property
    def crashed(self) -> str:
        """The reason why the vehicle must not fly before an inspection, '' while it may."""
        return self._descent.crashed

    @property
    def falling(self) -> str:
        """The reason of a fall, '' while the vehicle does not fall."""
        return self._descent.falling

    @property
    def lost_position(self) -> str:
        """The reason of a lost position, '' while it is known or the vehicle is at rest."""
        return self._position.lost(self._now) if self._state.armed and self._is_position_monitored else ""

    @property
    def is_blind(self) -> bool:
        """Whether the reported position and speed are unreliable, in the air or not."""
        return bool(self._position.lost(self._now))

    @property
    def commanded_by(self) -> str:
        """Another station that has just commanded the vehicle, to explain a foreign mode; '' for none."""
        return f", commanded by {others}" if (others := self.others()) else ""

    def check_start(self, action: str) -> None:
        """Raises DeviceError when a motion must not start, or needs a position that is lost."""
        if self.crashed:
            raise self._vehicle.error(
                f"{action} refused: {self.crashed}. Inspect it; then run 'lfield estop --lift' and call "
                "release()"
            )
        if (reason := self.lost_position) and self._needs_position(action):
            raise self._vehicle.error(f"{action} refused: {reason}; {self._needs_none} needs no position")
        if self.falling and not action.startswith(STOPS):
            raise self._vehicle.error(f"{action} refused: {self.falling}")
        self._course.start(None)

    async def check(self, action: str, order: Order, remaining: float) -> None:
        """Raises DeviceError when a running motion, `remaining` metres from its goal, must end."""
        await self.settle()
        descent = self._descent
        if descent.falling:
            raise self._vehicle.error(f"{action} ended early: {descent.falling}")
        if (reason := self.lost_position) and self._needs_position(action):
            raise self._vehicle.error(f"{action} ended early: {reason}; {self._needs_none} needs no position")
        if self.foreign:
            raise self._vehicle.error(f"{action} ended early: {self.foreign}; release() takes control again")
        if order.has_destination and self._course.leaves:
            text = f"{remaining:.1f} m from its goal it moves elsewhere, at {self._course.leaves:.1f} m/s"
            if others := self.others():
                self._on_takeover(f"{text}: {others}")
            raise self._vehicle.error(f"{action} ended early: {self.foreign or text}")

    async def check_landed(self, action: str) -> None:
        """Raises DeviceError when a landing was a crash."""
        await self.settle()
        if self.crashed:
            raise self._vehicle.error(f"{action} ended early: {self.crashed}")

    async def settle(self) -> None:
        """Waits for the result if the motors went off in the air."""
        await self._vehicle.wait_for(lambda: not self._descent.is_undecided, SETTLES)

    def safe_mode(self, state: str) -> str:
        """The mode for a safe state: without a position only a landing, for a rover a stop."""
        profile = self._vehicle.profile
        lands = self.lost_position and profile.kind in ("copter", "rover")
        return profile.land if lands else profile.safe(state)

    def _needs_position(self, action: str) -> bool:
        profile = self._vehicle.profile
        mode = profile.hold if action == "hold" else action.removeprefix("mode ")
        return not (action.startswith(NEEDS_NONE) or mode in BLIND_MODES)

    @property
    def _needs_none(self) -> str:
        stops = "hold()" if self._vehicle.profile.hold in BLIND_MODES else "disarm()"
        return "land()" if self._flies else stops

    # -- commands -----------------------------------------------------------------------------------------

    def on_order(self, order: Order) -> None:
        """Records the start of a command."""
        self._target.clear(self._now)
        self._modes = order.modes | {self._vehicle.profile.guided}
        if not order.has_destination:
            return
        self._expect(Expected(math.inf if order.goal is None else -order.goal[2]))
        if order.command is not None and order.command.place is not None and order.goal is not None:
            self._on_sent_place(order.goal)

    def on_mode(self, mode: str) -> None:
        """Records that a mode without targets of this program is commanded."""
        profile = self._vehicle.profile
        self._target.clear(self._now)
        self._modes = frozenset({profile.guided})
        self._expect(Expected(math.inf) if mode in (profile.hold, profile.guided) else DESCENT)

    def on_sent(self, target: Target) -> None:
        """Records a sent setpoint."""
        if target.mask in (ONLY_POSITION, POSITION_AND_YAW):
            self._modes |= {self._vehicle.profile.guided}
            self._on_sent_place(target.place)
            return
        self._target.on_velocity(target.velocity, self._now)
        self._descent.on_velocity(target.velocity[2], self._now)

    def goes_to(self, goal: Vector) -> None:
        """Starts to monitor a straight motion to a position, in metres of home."""
        self._course.start(goal)

    def release(self) -> None:
        """Resets the monitors when the program takes control again after an inspection or a takeover."""
        self.foreign = ""
        self._target.clear(self._now)
        self._descent.clear()

    async def run(self) -> None:
        """Reads the autopilot's descent speeds periodically, until cancelled."""
        await asyncio.sleep(FIRST_READ_DELAY)
        vehicle_type = self._state.autopilot, self._state.kind
        descents, landings = list(DESCENTS.get(vehicle_type, ())), list(LANDINGS.get(vehicle_type, ()))
        while descents or landings:
            descends, lands = await self._greatest_speed(descents), await self._greatest_speed(landings)
            self._descent.may_descend(descends, lands)
            await asyncio.sleep(REREAD_INTERVAL)

    async def _greatest_speed(self, name_groups: list[Mapping[str, float]]) -> float:
        """The greatest of some speeds in m/s; missing parameters are not requested again."""
        values = [0.0]
        for names in list(name_groups):
            if self._vehicle.lost or self._vehicle.is_quiet:
                continue
            with suppress(DeviceError):
                name, value = await self._parameters.read_any(names)
                if value is None:
                    name_groups.remove(names)
                elif math.isfinite(value):
                    values.append(value / names[name])
        return max(values)

    # -- messages -----------------------------------------------------------------------------------------

    def _on_heartbeat(self, message: Any) -> None:
        state = self._state
        if not state.armed:
            self.foreign = ""
        self._on_finding(self._descent.on_armed(state.armed, landed=self._landed, now=self._now))
        self._on_mode(message)

    def _on_mode(self, _: Any) -> None:
        """Handles a mode: a foreign target is a takeover once the mode is known to be still ours."""
        if self._state.mode not in self._modes or not self._state.armed or self.foreign:
            return
        if target := self._target.on_guided(self._now):
            others = self.others()
            reason = f"another station has sent it elsewhere, {target}"
            self._on_takeover(f"{reason}: {others}" if others else reason)

    def _on_takeover(self, reason: str) -> None:
        self.foreign = reason
        self._vehicle.note(log_messages.FOREIGN_CONTROL.line(reason=reason))

    def _on_position(self, message: Any) -> None:
        state = self._state
        self._check_clock(message.time_boot_ms)
        if state.height is None or not math.isfinite(message.vz):
            return
        finding = self._descent.on_motion(state.height, message.vz, self._now, is_ours=self._is_height_ours)
        self._on_finding(finding)
        if state.position is not None:
            self._course.on_motion(state.position, state.velocity, self._now)

    def _on_attitude(self, message: Any) -> None:
        roll, pitch = message.roll, message.pitch
        if math.isfinite(roll) and math.isfinite(pitch):
            self._on_finding(self._descent.on_attitude(roll, pitch, self._now, is_ours=self._is_height_ours))

    def _on_text(self, message: Any) -> None:
        now = self._now
        for text in self._vehicle.texts.since(now):
            self._on_finding(self._descent.on_text(text))

    def _check_clock(self, booted: int) -> None:
        now = self._now
        if booted < self._booted - 1000.0:
            self._on_finding(self._descent.on_restart(now - self._booted_at))
            self._position.restart()
        self._booted, self._booted_at = booted, now

    def _on_gps(self, message: Any) -> None:
        self._position.on_fix(0, message.fix_type, self._now)
        second = self._state.armed and message.fix_type < FIX and not self._vehicle.is_quiet
        if second and self._now - self._second_at >= GPS_RETRY_INTERVAL:
            # A second receiver does not report by itself.
            self._second_at = self._now
            self._vehicle.send(request_message(self._vehicle.system, dialect.MAVLINK_MSG_ID_GPS2_RAW))

    def _on_second_gps(self, message: Any) -> None:
        self._position.on_fix(1, message.fix_type, self._now)

    def _on_estimate(self, message: Any) -> None:
        self._position.on_estimate(message.flags)

    def _on_global_target(self, message: Any) -> None:
        """Handles the goal of ArduPilot, and of PX4 in automatic modes; in OFFBOARD PX4 sends an old one."""
        state = self._state
        if self._vehicle.state.profile is None or message.type_mask & NO_PLACE:
            return
        if self._vehicle.profile.px4 and state.mode == self._vehicle.profile.guided:
            return
        place = Place(message.lat_int / 1e7, message.lon_int / 1e7, message.alt)
        if state.origin is not None:
            north, east, down = state.origin.vector_to(place, state.radius)
        elif state.home is not None:
            north, east, down = (
                w + h
                for w, h in zip(state.home.vector_to(place, state.radius), state.home_offset, strict=True)
            )
        else:
            return
        level = message.coordinate_frame in ABOVE_SEA and not message.type_mask & NO_HEIGHT
        self._on_target_place((north, east, down if level and state.origin else math.nan))

    def _on_local_target(self, message: Any) -> None:
        """Handles the setpoint in the mode for setpoints; PX4 sends its next target in automatic modes.

        The position of an ArduCopter is in the other message.
        """
        state = self._state
        if state.profile is None or state.mode != self._vehicle.profile.guided:
            return
        place, velocity = (message.x, message.y, message.z), (message.vx, message.vy, message.vz)
        if not message.type_mask & NO_PLACE and all(map(math.isfinite, place[:2])):
            if self._vehicle.profile.px4:
                self._on_target_place(place)
        elif self._is_aloft and not message.type_mask & NO_VELOCITY and all(map(math.isfinite, velocity)):
            self._target.on_reported_velocity(velocity, self._now)

    def _on_distance(self, message: Any) -> None:
        """Handles the distance to the target; only ArduRovers were recorded to report 0 on a velocity."""
        state = self._state
        if state.kind == "rover" and state.position is not None:
            position, speed = self._local(state.position), math.hypot(*state.velocity[:2])
            self._target.on_reported_distance(message.wp_dist, position, speed, self._now)

    def _on_target_place(self, place: Vector) -> None:
        position = self._state.position
        local = None if position is None else self._local(position)
        self._target.on_reported_place(place, self._now, local, aloft=self._is_aloft)

    # -- steps --------------------------------------------------------------------------------------------

    @property
    def _now(self) -> float:
        return self._vehicle.clock.monotonic()

    @property
    def _flies(self) -> bool:
        return self._state.profile is not None and self._state.profile.flies

    @property
    def _landed(self) -> bool | None:
        """Whether the vehicle is on the ground; a vehicle that does not fly always is."""
        return self._state.landed if self._flies else True

    @property
    def _is_aloft(self) -> bool:
        return self._flies and self._state.landed is False

    @property
    def _is_height_ours(self) -> bool:
        """Whether the vehicle is a copter whose height this program controls."""
        copter = self._state.profile is not None and self._state.profile.kind == "copter"
        return copter and self.is_ours()

    @property
    def _is_position_monitored(self) -> bool:
        """Whether the position is monitored; a submarine has no GNSS under water."""
        return self._state.kind != "submarine" and (not self._flies or self._state.landed is False)

    def _expect(self, expected: Expected) -> None:
        self._descent.expect(expected)

    def _on_sent_place(self, place: Vector) -> None:
        local, state = self._local(place), self._state
        stop_place = None if state.position is None else self._local(state.position)
        self._target.on_place(local, self._now, stop_place)

    def _local(self, place: Vector) -> Vector:
        """A position relative to home, in the autopilot's local frame."""
        north, east, down = (p + h for p, h in zip(place, self._state.home_offset, strict=True))
        return north, east, down

    def _on_finding(self, finding: Finding | None) -> None:
        if finding is None:
            return
        message = log_messages.CRASHED if finding.crashed else log_messages.FALLING
        self._vehicle.note(message.line(reason=finding.text))
        if finding.crashed:
            self._vehicle.lock_out(f"it crashed: {finding.text}")
