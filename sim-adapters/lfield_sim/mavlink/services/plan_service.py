"""Plans of one vehicle: uploaded missions are flown, uploaded fences enforced."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.body.goals import Vector
from lfield_sim.autopilot.flavours import MavResult, Role
from lfield_sim.autopilot.mission_flight import report_started
from lfield_sim.autopilot.plans import NO_ITEM, MissionItem
from lfield_sim.mavlink.geo import GeoOrigin, is_near
from lfield_sim.mavlink.mav_command import CommandAnswer, MavCommand
from lfield_sim.mavlink.services.fence_shapes import UploadedFence, shapes_of
from lfield_sim.mavlink.services.plan_items import (
    ABOVE_HOME,
    ABOVE_SEA,
    PLACE_COMMANDS,
    RALLY,
    TAKEOFF,
    VTOL_TAKEOFF,
    WAYPOINT,
    PlanItem,
    PlanResult,
    PlanType,
)
from lfield_sim.mavlink.services.plan_protocol import ARDUPILOT, HANDLED, PX4, PlanProtocol
from lfield_sim.mavlink.services.service import VehicleService

#: MISSION_ITEM.current of an item for guided flight; the messages of items; PX4's total of no mission.
GUIDED_PLACE, GUIDED_HEIGHT = 2, 3
ITEMS = (dialect.MAVLINK_MSG_ID_MISSION_ITEM, dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT)
NO_TOTAL = 65535
#: Seconds after which PX4 repeats that an item was reached.
REPEATS = (1.0, 2.0)
#: ArduPilot's counters of stored items.
COUNTS = {PlanType.MISSION: "MIS_TOTAL", PlanType.FENCE: "FENCE_TOTAL", PlanType.RALLY: "RALLY_TOTAL"}


class PlanService(VehicleService):
    """The mission protocol of one vehicle, and the commands that start, stop and move within a mission."""

    def __init__(self, autopilot: Autopilot, place: GeoOrigin) -> None:
        super().__init__(autopilot, place)
        self._home_first = autopilot.flavour.home_item
        style = ARDUPILOT if self._home_first else PX4
        self._protocol = PlanProtocol(style, self._home, self._on_change, autopilot.say)
        self._fence = autopilot.fence = UploadedFence()
        self._reported = self._progress
        self._repeats: list[tuple[float, int]] = []
        self.handles = dict.fromkeys(HANDLED, self._on_plan)
        self.handles[dialect.MAVLINK_MSG_ID_MISSION_SET_CURRENT] = self._on_set_current
        self.commands = {
            dialect.MAV_CMD_DO_SET_MISSION_CURRENT: self._jump,
            dialect.MAV_CMD_MISSION_START: self._start,
            dialect.MAV_CMD_DO_PAUSE_CONTINUE: self._pause_or_go_on,
            dialect.MAV_CMD_DO_FENCE_ENABLE: self._enable_fence,
        }
        self.messages = {dialect.MAVLINK_MSG_ID_MISSION_CURRENT: self._current}

    def advance(self, now: float) -> list[Any]:
        """Messages of the protocol, reached items, and changes of the mission state."""
        messages = self._protocol.advance(now)
        reached = self.autopilot.mission.pop_reached()
        if reached:
            self._repeats = [] if self._home_first else [(now + pause, reached[-1]) for pause in REPEATS]
        while self._repeats and now >= self._repeats[0][0]:
            reached.append(self._repeats.pop(0)[1])
        messages += [dialect.MAVLink_mission_item_reached_message(number) for number in reached]
        self._protocol.current = self._number
        if self._progress != self._reported:
            self._reported = self._progress
            messages.append(self._current())
        return messages

    def reboot(self) -> None:
        """Aborts a running upload; stored plans stay."""
        self._protocol.forget()

    # -- the protocol ---------------------------------------------------------------------------------

    def _on_plan(self, message: Any) -> list[Any]:
        guided = getattr(message, "current", 0) in (GUIDED_PLACE, GUIDED_HEIGHT)
        if guided and message.get_msgId() in ITEMS and self._home_first:
            return self._on_guided(message)
        return self._protocol.receive(message, self.autopilot.now)

    def _on_guided(self, message: Any) -> list[Any]:
        """Handles an item that is not part of a mission but a goal (2) or a new height (3, without
        effect).
        """
        place = self._place(PlanItem.read(message))
        accepted = message.current == GUIDED_HEIGHT
        if message.current == GUIDED_PLACE and place is not None and is_near(place):
            accepted = self.autopilot.reposition(place, None, change_mode=False) is MavResult.ACCEPTED
        result = PlanResult.ACCEPTED if accepted else PlanResult.ERROR
        peer = message.get_srcSystem(), message.get_srcComponent()
        return [dialect.MAVLink_mission_ack_message(*peer, int(result), int(PlanType.MISSION))]

    def _on_change(self, kind: PlanType, whole: bool) -> None:
        """Handles a changed plan: a `whole` one is flown on command, or enforced from now on."""
        items = self._protocol.items[kind]
        if COUNTS[kind] in self.autopilot.parameters:
            self.autopilot.parameters[COUNTS[kind]] = float(len(items))
        if kind is PlanType.MISSION:
            self._change_mission([self._to_fly(item) for item in items], whole)
        elif kind is PlanType.FENCE:
            self._fence.shapes = shapes_of(items, self.place)
        else:
            points = (self._place(item) for item in items)
            self.autopilot.homing.rally = [point for point in points if point is not None]

    def _change_mission(self, items: list[MissionItem], whole: bool) -> None:
        """Changes the mission: ArduPilot in it continues with the current item, and restarts it if it has
        changed.
        """
        pilot = self.autopilot
        if not (self._home_first and pilot.armed and pilot.role is Role.MISSION):
            pilot.mission.items = items
            if whole:
                pilot.mission.restart()
        elif pilot.mission.change(items):
            pilot.say("Auto mission changed, restarted command")

    def _home(self) -> PlanItem:
        """Item 0 of an ArduPilot mission."""
        north, east, down = self.autopilot.home
        return PlanItem(
            WAYPOINT, 0, (0.0, 0.0, 0.0, 0.0), *self.place.at(north, east), self.place.altitude - down
        )

    def _to_fly(self, item: PlanItem) -> MissionItem:
        return MissionItem(item.command, (*item.values, *item.degrees, item.z), self._place(item))

    def _place(self, item: PlanItem) -> Vector | None:
        """The local position; None for a command without one, and for 0, 0: "here".

        A takeoff goes straight up to its height and ignores its position.
        """
        somewhere = (item.x, item.y) != (0, 0) or item.command in (TAKEOFF, VTOL_TAKEOFF)
        if item.command not in PLACE_COMMANDS | {RALLY} or not somewhere:
            return None
        # The ground is flat at down 0, which is the terrain.
        base = 0.0
        if item.frame in ABOVE_SEA:
            base = self.place.altitude
        elif item.frame in ABOVE_HOME:
            base = self.autopilot.home[2]
        return (*self.place.local(item.x, item.y), base - item.z)

    # -- flight ----------------------------------------------------------------------------------------

    @property
    def _number(self) -> int:
        """The number of the current item; the last one remains current at the end."""
        mission = self.autopilot.mission
        return max(0, min(mission.current, len(mission.items) - 1))

    def _current(self) -> Any:
        return dialect.MAVLink_mission_current_message(*self._progress, self._mission_mode)

    @property
    def _mission_mode(self) -> int:
        """The reported mode: 1 in a mission mode; in others PX4 reports 2 and ArduPilot 0."""
        if self._flies_missions:
            return 1
        return 0 if self._home_first else 2

    @property
    def _flies_missions(self) -> bool:
        """Whether the vehicle is in a mission mode; for PX4 that includes takeoff and landing."""
        role = self.autopilot.role
        flies = role is Role.MISSION and (self._home_first or bool(self.autopilot.mission.items))
        return flies or (not self._home_first and role in (Role.TAKEOFF, Role.LAND))

    @property
    def _progress(self) -> tuple[int, int, int]:
        """The current item, the number of items (without home), and the MISSION_STATE."""
        total = len(self.autopilot.mission.items)
        if self._home_first:
            total = max(0, total - 1)
        return self._number, total or self._no_total, self._state

    @property
    def _no_total(self) -> int:
        return 0 if self._home_first else NO_TOTAL

    @property
    def _state(self) -> int:
        mission, total = self.autopilot.mission, len(self.autopilot.mission.items)
        if total <= int(self._home_first):
            return int(dialect.MISSION_STATE_NO_MISSION)
        if mission.current >= total:
            return int(dialect.MISSION_STATE_COMPLETE)
        if self._flies_missions and (self.autopilot.armed or self._home_first):
            return int(dialect.MISSION_STATE_ACTIVE)
        has_started = mission.last_reached != NO_ITEM
        return int(dialect.MISSION_STATE_PAUSED if has_started else dialect.MISSION_STATE_NOT_STARTED)

    def _on_set_current(self, message: Any) -> list[Any]:
        """Sets the current item; ArduPilot reports it at once, PX4 in its stream."""
        if self._jump_to(message.seq):
            self._reported = self._progress
            return [self._current()] if self._home_first else []
        if not self._home_first:
            self.autopilot.say("WPM: WP CURR CMD: Not in list\t")
        return []

    def _jump_to(self, number: int) -> bool:
        """Jumps to an item; 0 of ArduPilot is home, and 1 is meant."""
        mission = self.autopilot.mission
        return mission.jump(max(number, 1) if self._home_first and len(mission.items) > 1 else number)

    def _jump(self, command: MavCommand) -> CommandAnswer:
        if not self._home_first:
            return MavResult.UNSUPPORTED, []
        if not self._jump_to(command.whole(1)):
            return MavResult.DENIED, []
        if not self.autopilot.armed:
            self._report_started(1)
        return MavResult.ACCEPTED, [self._current()]

    def _start(self, command: MavCommand) -> CommandAnswer:
        """Starts a mission: PX4 restarts on the ground for item 0; else 0 means continue."""
        first, pilot = command.whole(1), self.autopilot
        has_started = self._home_first or pilot.vehicle.airborne or not pilot.mission.items
        continues = first < 0 or (first == 0 and has_started)
        result = pilot.start_mission(None if continues else first)
        if result is MavResult.ACCEPTED:
            # A copter reports the item once more than a rover; an armed one starts the item, and reports the
            # start.
            self._report_started(int(pilot.flies) + int(not pilot.armed))
        return result, []

    def _report_started(self, times: int) -> None:
        """Reports the started item of ArduPilot in AUTO, even if it is disarmed and starts none."""
        item = self.autopilot.mission.item
        if item is None or not self._home_first or self.autopilot.role is not Role.MISSION:
            return
        for _ in range(times):
            report_started(self.autopilot, item)

    def _pause_or_go_on(self, command: MavCommand) -> CommandAnswer:
        requested = command.whole(1)
        if not self._home_first:
            return MavResult.UNSUPPORTED, []
        if requested in (0, 1) and self.autopilot.role is Role.GUIDED:
            return MavResult.ACCEPTED, []
        if requested not in (0, 1) or (self.autopilot.role is not Role.MISSION and not requested):
            return MavResult.DENIED, []
        if requested:
            return self.autopilot.start_mission(None), []
        return self.autopilot.command_role(Role.HOLD), []

    def _enable_fence(self, command: MavCommand) -> CommandAnswer:
        """Enables ArduPilot's fence; PX4 has only the parameter of its action."""
        if not self._home_first:
            return MavResult.UNSUPPORTED, []
        if command.whole(1) not in (0, 1):
            return MavResult.FAILED, []
        self.autopilot.parameters["FENCE_ENABLE"] = float(command.whole(1))
        return MavResult.ACCEPTED, []
