"""Missions: waypoints flown by the autopilot; uploaded, verified, started and monitored."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from typing import Any

from lfield.driver import DeviceError
from lfield_mavlink import log_messages
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.limits import Limits
from lfield_mavlink.link.dialect import AUTOPILOT, dialect
from lfield_mavlink.modes import ARDUPILOT, PX4
from lfield_mavlink.monitors.mission_changes import CHANGED, MissionChanges, MissionTarget
from lfield_mavlink.parts.motion_control import Motion
from lfield_mavlink.parts.returns import Returns
from lfield_mavlink.services.mission_check import Situation
from lfield_mavlink.services.mission_commands import CURVES, has_command, starts_with_takeoff
from lfield_mavlink.services.mission_rules import check_mission
from lfield_mavlink.services.plan_items import WAYPOINT, Item, PlanKind, coordinates, waypoints
from lfield_mavlink.services.plan_transfer import PlanTransfer

#: Seconds to wait for the current item that was set, which PX4 reports once a second; number of attempts.
ANSWER_TIMEOUT, ATTEMPTS = 1.2, 4
#: Seconds after the last indication of a change in which a transfer by another station may continue.
UNDER_WAY = 2.0

#: The default radius of a circle, by autopilot and kind of vehicle: parameter names, with units per metre.
_LOITER_RADII = {
    (ARDUPILOT, "copter"): {"CIRCLE_RADIUS_M": 1.0, "CIRCLE_RADIUS": 100.0},
    (ARDUPILOT, "rover"): {"CIRC_RADIUS": 1.0},
    (ARDUPILOT, "plane"): {"WP_LOITER_RAD": 1.0},
    (PX4, "copter"): {"NAV_LOITER_RAD": 1.0},
    (PX4, "plane"): {"NAV_LOITER_RAD": 1.0},
}
_CIRCLES = (
    dialect.MAV_CMD_NAV_LOITER_UNLIM,
    dialect.MAV_CMD_NAV_LOITER_TURNS,
    dialect.MAV_CMD_NAV_LOITER_TIME,
    dialect.MAV_CMD_NAV_LOITER_TO_ALT,
    dialect.MAV_CMD_DO_REPOSITION,
)
#: MISSION_STATEs of a mission that is complete, or unknown.
_NOT_STARTED_STATES = (
    dialect.MISSION_STATE_UNKNOWN,
    dialect.MISSION_STATE_NO_MISSION,
    dialect.MISSION_STATE_COMPLETE,
)
_CURRENT = dialect.MAVLINK_MSG_ID_MISSION_CURRENT


class Missions:
    """Waypoints are numbered from 0, also for ArduPilot, whose own numbers start with home."""

    def __init__(
        self, vehicle: Contact, motion: Motion, limits: Limits, plans: PlanTransfer, returns: Returns
    ) -> None:
        self._vehicle, self._state, self._motion = vehicle, vehicle.state, motion
        self._limits, self._plans, self._returns = limits, plans, returns
        self._count = 0
        # Whether the mission may have curves, whose path depends on their starting points.
        self._curved = True
        self._current = self._reached = -1
        # The time when the mission was last complete.
        self._completed_at = -math.inf
        # Whether the vehicle reports that its mission has not started, and so starts with waypoint 0.
        self._is_starting = True
        # Indications of a changed mission in flight: '' requires a check, other texts are reasons to hold.
        self._changes = MissionChanges()
        self._target = MissionTarget(*limits.places)
        self._change_signs: asyncio.Queue[str] = asyncio.Queue()
        vehicle.on(_CURRENT, self._on_current)
        vehicle.on(dialect.MAVLINK_MSG_ID_PARAM_VALUE, self._on_parameter)
        vehicle.on(dialect.MAVLINK_MSG_ID_STATUSTEXT, self._on_text)
        vehicle.on(dialect.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT, self._on_target)
        vehicle.on(dialect.MAVLINK_MSG_ID_MISSION_ITEM_REACHED, self._on_reached)

    @property
    def _first(self) -> int:
        """The autopilot's number of waypoint 0."""
        return 0 if self._vehicle.profile.px4 else 1

    # -- instructions ---------------------------------------------------------------------------------

    async def do_upload_mission(self, values: list[float]) -> None:
        """Replaces the mission: {latitude, longitude, height above home} per waypoint."""
        try:
            items = waypoints(values, yaw=math.nan if self._vehicle.profile.px4 else 0.0)
        except ValueError as error:
            raise self._vehicle.error(f"uploadMission: {error}") from None
        await self.upload("uploadMission", items)

    async def do_mission_waypoints(self) -> list[float]:
        """The stored waypoints, in the format of uploadMission."""
        try:
            return coordinates(await self._plans.download(PlanKind.MISSION), WAYPOINT)
        except ValueError as error:
            raise self._vehicle.error(f"its mission is not made of waypoints alone: {error}") from None

    async def do_start_mission(self) -> None:
        """Flies the stored mission from its current waypoint. Done when it has started."""
        await self.start("startMission")

    async def upload(self, action: str, items: Sequence[Item]) -> None:
        """Replaces the mission, and makes its first item the current one. Raises DeviceError."""
        await self._check(action, items)
        self._check_not_flown(action)
        await self._plans.upload(PlanKind.MISSION, items)
        self._count, self._reached, self._completed_at = len(items), -1, -math.inf
        await self._make_current(action, 0)

    async def start(self, action: str) -> None:
        """Flies the stored mission from its current waypoint. Raises DeviceError."""
        profile = self._vehicle.profile
        self._motion.check_bounded(action, profile.mission)
        self._motion.start_motion(action)
        if not self._state.armed:
            raise self._vehicle.error(f"{action} refused: the vehicle is not armed; call arm() first")
        items = await self._plans.download(PlanKind.MISSION)
        if not items:
            raise self._vehicle.error(
                f"{action} refused: the vehicle has no mission; call uploadMission() first"
            )
        await self._check(action, items, starts=True)
        if profile.flies and self._state.landed:
            self._check_takeoff(items)
        self._count = len(items)
        start = dialect.MAV_CMD_MISSION_START
        await self._motion.enter(action, profile.mission, start, 0.0, 0.0)
        if profile.px4:
            # The vehicle stays in this mode when the mission is complete.
            self._motion.claim(profile.mission, profile.hold)
        try:
            await self._motion.speed.apply_target()
            if self._limits.bounds_anything:
                # Another station may have changed it meanwhile.
                await self._check(action, await self._plans.download(PlanKind.MISSION), starts=True)
        except DeviceError as error:
            await self._motion.halt("its speed or its mission is not known to stay within the limits")
            raise self._vehicle.error(f"{action}: holding, {error.reason}") from None

    def is_complete(self, since: float) -> bool:
        """Whether the mission has become complete after a time of the monotonic clock."""
        return self._completed_at >= since

    async def do_pause_mission(self) -> None:
        """Stops and holds; startMission continues the mission."""
        self._motion.start_motion("pauseMission")
        if self._state.mode != self._vehicle.profile.mission:
            raise self._vehicle.error(
                f"pauseMission: no mission is running, the vehicle is in {self._state.mode}"
            )
        await self._motion.hold()

    async def do_set_mission_item(self, number: int) -> None:
        """Sets the next waypoint."""
        if not 0 <= number < 0xFFFF:
            raise self._vehicle.error(f"setMissionItem: there is no waypoint {number}")
        if self._curved and self._is_flown:
            await self._check("setMissionItem", await self._plans.download(PlanKind.MISSION), starts=True)
        await self._make_current("setMissionItem", number)

    async def do_clear_mission(self) -> None:
        """Removes the mission."""
        self._check_not_flown("clearMission")
        await self._plans.clear(PlanKind.MISSION)
        self._count, self._reached = 0, -1

    # -- changes by others ----------------------------------------------------------------------------

    async def run(self) -> None:
        """Holds when another station changes the running mission to one that may leave the limits."""
        while True:
            sign: str | None = await self._change_signs.get()
            while sign is not None and self._is_ours:
                if reason := sign or await self._recheck():
                    await self._hold(reason)
                    break
                # A transfer may be in progress without other notice.
                sign = await self._next_sign(UNDER_WAY)

    async def _recheck(self) -> str:
        """Reads and checks the running mission; returns the reason why it must stop, '' when it may
        continue.
        """
        try:
            await self._check("its mission", await self._plans.download(PlanKind.MISSION), starts=True)
        except DeviceError as error:
            return error.reason
        return ""

    async def _next_sign(self, seconds: float) -> str | None:
        """The next sign within so many seconds, None without one; earlier ones are merged."""
        while self._change_signs.qsize() > 1:
            self._change_signs.get_nowait()
        try:
            return await asyncio.wait_for(self._change_signs.get(), seconds)
        except TimeoutError:
            return None

    async def _hold(self, reason: str) -> None:
        self._vehicle.note(log_messages.MISSION_CHANGED.line(reason=reason))
        try:
            await self._motion.halt(reason)
        except DeviceError as error:
            self._vehicle.note(log_messages.NOT_HOLDING.line(reason=error.reason))

    @property
    def _is_ours(self) -> bool:
        """Whether a mission of this program with limits is running."""
        return self._is_flown and self._motion.is_ours and self._limits.bounds_anything

    def _on_parameter(self, message: Any) -> None:
        if self._changes.on_parameter(message):
            self._add_sign()

    def _on_text(self, message: Any) -> None:
        if message.text.startswith(CHANGED):
            self._add_sign()

    def _on_target(self, message: Any) -> None:
        state = self._state
        if state.profile is None or state.home is None or not self._is_ours:
            return
        if reason := self._target.excess(message, state.home, flies=self._vehicle.profile.flies):
            self._add_sign(reason)

    def _add_sign(self, reason: str = "") -> None:
        if self._state.profile is not None and self._is_ours:
            self._change_signs.put_nowait(reason)

    # -- steps ----------------------------------------------------------------------------------------

    async def _make_current(self, action: str, number: int) -> None:
        """Sets the current item and confirms it. Raises DeviceError."""
        sequence = number + self._first
        message = dialect.MAVLink_mission_set_current_message(self._vehicle.system, AUTOPILOT, sequence)

        def is_set(reply: Any) -> bool:
            return bool(reply.get_msgId() == _CURRENT and reply.seq == sequence)

        for _ in range(ATTEMPTS):
            self._vehicle.send(message)
            if await self._vehicle.expect(is_set, ANSWER_TIMEOUT):
                return
        raise self._vehicle.error(f"{action}: waypoint {number} did not become the current one", timeout=True)

    @property
    def _is_flown(self) -> bool:
        return self._state.armed and self._state.mode == self._vehicle.profile.mission

    def _check_takeoff(self, items: Sequence[Item]) -> None:
        """Refuses a mission that would not start with a takeoff on the ground. Raises DeviceError.

        ArduPilot continues with its current item, PX4 starts with the first.
        """
        first = 0 if self._vehicle.profile.px4 or self._is_starting else max(self._current, 0)
        if starts_with_takeoff(items[first:]):
            return
        number = f", and waypoint {first} is not a takeoff" if first else ""
        raise self._vehicle.error(f"startMission refused: it is on the ground{number}; call takeoff() first")

    def _check_not_flown(self, action: str) -> None:
        if self._is_flown:
            raise self._vehicle.error(f"{action} refused: a mission is running; call pauseMission() first")

    async def _check(self, action: str, items: Sequence[Item], *, starts: bool = False) -> None:
        """Refuses a mission that leaves the limits of the binding, also of other stations. Raises
        DeviceError.
        """
        self._curved = self._limits.bound_places and has_command(items, *CURVES)
        return_command = dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH
        returns = [
            number + self._first for number, item in enumerate(items) if item.command == return_command
        ]
        self._changes.on_checked(curved=self._curved, returns=returns)
        check_mission(action, items, self._limits, self._vehicle.error, await self._situation(items, starts))

    async def _situation(self, items: Sequence[Item], starts: bool) -> Situation:
        """The data for the check; requests only data that these items need."""
        profile, state, limits = self._vehicle.profile, self._state, self._limits
        autopilot, returns = profile.autopilot, has_command(items, dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH)
        radius, climb, rally = None, None, list[Item]()
        if limits.bounds_radius and has_command(items, *_CIRCLES):
            radius, _ = await self._returns.metres(_LOITER_RADII.get((autopilot, profile.kind), {}))
        if returns:
            climb, rally = await self._returns.climb(), await self._returns.rally()
        home = state.home if state.knows_frames else None
        return Situation(
            profile.kind, profile.px4, home, state.position, radius, climb, rally, starts_here=starts
        )

    # -- telemetry ------------------------------------------------------------------------------------

    def _on_current(self, message: Any) -> None:
        if self._state.profile is None:
            return  # the first number is unknown before its first heartbeat
        if self._changes.on_current(message):
            self._add_sign()
        previous, self._current = self._current, max(message.seq - self._first, -1)
        self._is_starting = message.mission_state in _NOT_STARTED_STATES
        # The message that an item was reached comes once and may be lost.
        if self._state.mode == self._vehicle.profile.mission:
            if self._current == previous + 1:
                self._reached = max(self._reached, previous)
            if message.mission_state == dialect.MISSION_STATE_COMPLETE:
                self._reached = max(self._reached, self._count - 1)
        if message.mission_state == dialect.MISSION_STATE_COMPLETE:
            self._completed_at = self._vehicle.clock.monotonic()
        self._publish_mission()

    def _on_reached(self, message: Any) -> None:
        if self._state.profile is not None:
            self._reached = max(message.seq - self._first, -1)
            self._publish_mission()

    def _publish_mission(self) -> None:
        self._vehicle.publish(missionItem=self._current, missionReached=self._reached)
