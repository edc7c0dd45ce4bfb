"""Missions: waypoints that the autopilot flies by itself, uploaded, seen to be there, started, followed."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from typing import Any

from lfield.driver import DeviceError
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.limits import Limits
from lfield_mavlink.link.dialect import AUTOPILOT, dialect
from lfield_mavlink.modes import ARDUPILOT, PX4
from lfield_mavlink.monitors.mission_changes import CHANGED, MissionChanges, MissionTarget
from lfield_mavlink.parts.motion import Motion
from lfield_mavlink.parts.returns import Returns
from lfield_mavlink.services.mission_check import Situation
from lfield_mavlink.services.mission_commands import CURVES, begins_with_takeoff, has_command
from lfield_mavlink.services.mission_rules import check_mission
from lfield_mavlink.services.plan_items import WAYPOINT, Item, PlanKind, coordinates, waypoints
from lfield_mavlink.services.plan_transfer import PlanTransfer

#: Seconds to wait until the current item is the one that was set, which PX4 tells once a second, and how
#: often it is set.
PATIENCE, QUESTIONS = 1.2, 4
#: Seconds after the last sign of a change in which a transfer by another station may go on.
UNDER_WAY = 2.0

#: The radius in metres of a circle whose item names none, by autopilot and kind of vehicle: the parameter by
#: its names, and in how many units to a metre.
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
#: MISSION_STATEs of a mission that is over, or of which nothing is known.
_BEGINS = (
    dialect.MISSION_STATE_UNKNOWN,
    dialect.MISSION_STATE_NO_MISSION,
    dialect.MISSION_STATE_COMPLETE,
)
_CURRENT = dialect.MAVLINK_MSG_ID_MISSION_CURRENT


class Missions:
    """Waypoints are numbered from 0 here, also for ArduPilot, whose own numbers begin with home."""

    def __init__(
        self, vehicle: Contact, motion: Motion, limits: Limits, plans: PlanTransfer, returns: Returns
    ) -> None:
        self._vehicle, self._state, self._motion = vehicle, vehicle.state, motion
        self._limits, self._plans, self._returns = limits, plans, returns
        self._count = 0
        # Whether the mission may have curves, whose path follows from where they begin.
        self._curved = True
        self._current = self._reached = -1
        # Whether it has not told that it is in the middle of its mission, and so begins with waypoint 0.
        self._begins = True
        # Signs that others have changed the mission under way: '' for a look at it, else why it must hold.
        self._changes = MissionChanges()
        self._target = MissionTarget(*limits.places)
        self._signs: asyncio.Queue[str] = asyncio.Queue()
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
        """{latitude, longitude, height above home} for each waypoint, in place of what was there."""
        try:
            items = waypoints(values, yaw=math.nan if self._vehicle.profile.px4 else 0.0)
        except ValueError as error:
            raise self._vehicle.error(f"uploadMission: {error}") from None
        await self._check("uploadMission", items)
        self._check_not_flown("uploadMission")
        await self._plans.upload(PlanKind.MISSION, items)
        self._count, self._reached = len(items), -1
        await self._make_current("uploadMission", 0)

    async def do_mission_waypoints(self) -> list[float]:
        """The waypoints that the vehicle holds, as uploadMission takes them."""
        try:
            return coordinates(await self._plans.download(PlanKind.MISSION), WAYPOINT)
        except ValueError as error:
            raise self._vehicle.error(f"its mission is not made of waypoints alone: {error}") from None

    async def do_start_mission(self) -> None:
        """Fly the mission that the vehicle holds, on from its current waypoint. Done when it has begun."""
        profile = self._vehicle.profile
        self._motion.check_bounded("startMission", profile.mission)
        self._motion.begin("startMission")
        if not self._state.armed:
            raise self._vehicle.error("startMission refused: the vehicle is not armed; call arm() first")
        items = await self._plans.download(PlanKind.MISSION)
        if not items:
            raise self._vehicle.error(
                "startMission refused: the vehicle holds no mission; call uploadMission() first"
            )
        await self._check("startMission", items, starts=True)
        if profile.flies and self._state.landed:
            self._check_takeoff(items)
        self._count = len(items)
        start = dialect.MAV_CMD_MISSION_START
        await self._motion.enter("startMission", profile.mission, start, 0.0, 0.0)
        if profile.px4:
            # It stays there when the mission is over.
            self._motion.claim(profile.mission, profile.hold)
        try:
            await self._motion.speed.keep_wanted()
            if self._limits.bounds_anything:
                # Another station may have changed it meanwhile.
                await self._check("startMission", await self._plans.download(PlanKind.MISSION), starts=True)
        except DeviceError as error:
            await self._motion.halt("its speed or its mission is not known to stay inside the limits")
            raise self._vehicle.error(f"startMission: it holds, since {error.reason}") from None

    async def do_pause_mission(self) -> None:
        """Stop and stay; startMission goes on from here."""
        self._motion.begin("pauseMission")
        if self._state.mode != self._vehicle.profile.mission:
            raise self._vehicle.error(
                f"pauseMission: no mission is being flown, the vehicle is in {self._state.mode}"
            )
        await self._motion.hold()

    async def do_set_mission_item(self, number: int) -> None:
        """The waypoint that is flown to next."""
        if not 0 <= number < 0xFFFF:
            raise self._vehicle.error(f"setMissionItem: there is no waypoint {number}")
        if self._curved and self._is_flown:
            await self._check("setMissionItem", await self._plans.download(PlanKind.MISSION), starts=True)
        await self._make_current("setMissionItem", number)

    async def do_clear_mission(self) -> None:
        """Leave the vehicle without a mission."""
        self._check_not_flown("clearMission")
        await self._plans.clear(PlanKind.MISSION)
        self._count, self._reached = 0, -1

    # -- changes by others ----------------------------------------------------------------------------

    async def keep(self) -> None:
        """Hold when another station changes the mission under way to one that may leave the limits."""
        while True:
            sign: str | None = await self._signs.get()
            while sign is not None and self._is_ours:
                if why := sign or await self._look():
                    await self._hold(why)
                    break
                # A transfer may be under way of which nothing else is told.
                sign = await self._next_sign(UNDER_WAY)

    async def _look(self) -> str:
        """Read and check the mission under way: why it must not go on, '' when it may."""
        try:
            await self._check("its mission", await self._plans.download(PlanKind.MISSION), starts=True)
        except DeviceError as error:
            return error.reason
        return ""

    async def _next_sign(self, seconds: float) -> str | None:
        """The next sign within so many seconds, None when there is none; those of before count as one."""
        while self._signs.qsize() > 1:
            self._signs.get_nowait()
        try:
            return await asyncio.wait_for(self._signs.get(), seconds)
        except TimeoutError:
            return None

    async def _hold(self, why: str) -> None:
        self._vehicle.note(f"the mission was changed in flight: {why}; the vehicle holds")
        try:
            await self._motion.halt(why)
        except DeviceError as error:
            self._vehicle.note(f"it does not hold: {error.reason}")

    @property
    def _is_ours(self) -> bool:
        """Whether a mission is being flown for this program, within limits."""
        return self._is_flown and self._motion.ours and self._limits.bounds_anything

    def _on_parameter(self, message: Any) -> None:
        if self._changes.on_parameter(message):
            self._sign()

    def _on_text(self, message: Any) -> None:
        if message.text.startswith(CHANGED):
            self._sign()

    def _on_target(self, message: Any) -> None:
        state = self._state
        if state.profile is None or state.home is None or not self._is_ours:
            return
        if why := self._target.beyond(message, state.home, flies=self._vehicle.profile.flies):
            self._sign(why)

    def _sign(self, why: str = "") -> None:
        if self._state.profile is not None and self._is_ours:
            self._signs.put_nowait(why)

    # -- steps ----------------------------------------------------------------------------------------

    async def _make_current(self, what: str, number: int) -> None:
        """Set the current item and see that it is. Raises DeviceError."""
        wanted = number + self._first
        message = dialect.MAVLink_mission_set_current_message(self._vehicle.system, AUTOPILOT, wanted)

        def is_set(news: Any) -> bool:
            return bool(news.get_msgId() == _CURRENT and news.seq == wanted)

        for _ in range(QUESTIONS):
            self._vehicle.send(message)
            if await self._vehicle.expect(is_set, PATIENCE):
                return
        raise self._vehicle.error(f"{what}: waypoint {number} did not become the current one", timeout=True)

    @property
    def _is_flown(self) -> bool:
        return self._state.armed and self._state.mode == self._vehicle.profile.mission

    def _check_takeoff(self, items: Sequence[Item]) -> None:
        """Refuse a mission that would begin on the ground with something else. Raises DeviceError.

        ArduPilot goes on with its current item on the ground, too; PX4 begins with the first one.
        """
        first = 0 if self._vehicle.profile.px4 or self._begins else max(self._current, 0)
        if begins_with_takeoff(items[first:]):
            return
        number = f", and waypoint {first} is no takeoff" if first else ""
        raise self._vehicle.error(
            f"startMission refused: it stands on the ground{number}; call takeoff() first"
        )

    def _check_not_flown(self, what: str) -> None:
        if self._is_flown:
            raise self._vehicle.error(f"{what} refused: a mission is being flown; call pauseMission() first")

    async def _check(self, what: str, items: Sequence[Item], *, starts: bool = False) -> None:
        """Refuse a mission that leaves the limits of the binding, whoever made it. Raises DeviceError."""
        self._curved = self._limits.bound_places and has_command(items, *CURVES)
        back = dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH
        returns = [number + self._first for number, item in enumerate(items) if item.command == back]
        self._changes.checked(curved=self._curved, returns=returns)
        check_mission(what, items, self._limits, self._vehicle.error, await self._situation(items, starts))

    async def _situation(self, items: Sequence[Item], starts: bool) -> Situation:
        """What the items are checked against; asks the vehicle only for what these items need."""
        profile, state, limits = self._vehicle.profile, self._state, self._limits
        autopilot, returns = profile.autopilot, has_command(items, dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH)
        radius, climb, rally = None, None, list[Item]()
        if limits.bounds_radius and has_command(items, *_CIRCLES):
            radius, _ = await self._returns.metres(_LOITER_RADII.get((autopilot, profile.kind), {}))
        if returns:
            climb, rally = await self._returns.climb(), await self._returns.rally()
        home = state.home if state.knows_frames else None
        return Situation(
            profile.kind, profile.px4, home, state.position, radius, climb, rally, begins_here=starts
        )

    # -- telemetry ------------------------------------------------------------------------------------

    def _on_current(self, message: Any) -> None:
        if self._state.profile is None:
            return  # from which number it counts is not known before its first heartbeat
        if self._changes.on_current(message):
            self._sign()
        before, self._current = self._current, max(message.seq - self._first, -1)
        self._begins = message.mission_state in _BEGINS
        # The word that an item was reached comes once and may be lost.
        if self._state.mode == self._vehicle.profile.mission:
            if self._current == before + 1:
                self._reached = max(self._reached, before)
            if message.mission_state == dialect.MISSION_STATE_COMPLETE:
                self._reached = max(self._reached, self._count - 1)
        self._tell_mission()

    def _on_reached(self, message: Any) -> None:
        if self._state.profile is not None:
            self._reached = max(message.seq - self._first, -1)
            self._tell_mission()

    def _tell_mission(self) -> None:
        self._vehicle.publish(missionItem=self._current, missionReached=self._reached)
