"""Flies a mission, item by item, by MAV_CMD."""

from __future__ import annotations

import math
from collections.abc import Sequence

from lfield_sim.autopilot.body.curves import arc, spline
from lfield_sim.autopilot.body.goals import Descend, Orbit, Reach, Vector
from lfield_sim.autopilot.flavours import Role
from lfield_sim.autopilot.pilot import Pilot
from lfield_sim.autopilot.plans import MissionItem
from lfield_sim.autopilot.takeoff_landing import AT_HEIGHT, start_takeoff

# MAV_CMDs of mission items that are flown; others are executed at once.
WAYPOINT, LOITER, LOITER_TURNS, LOITER_TIME, RETURN, LAND, TAKEOFF = 16, 17, 18, 19, 20, 21, 22
CLIMB_ON, LOITER_TO_HEIGHT, ARC, SPLINE, VTOL_TAKEOFF, VTOL_LAND = 30, 31, 36, 82, 84, 85
GUIDED, DELAY, PLACE_PAYLOAD, JUMP, TAG, JUMP_TO_TAG = 92, 93, 94, 177, 600, 601
#: ArduPilot's names of items in its texts.
NAMES = {
    WAYPOINT: "WP", LOITER: "LoitUnlim", LOITER_TURNS: "LoitTurns", LOITER_TIME: "LoitTime", RETURN: "RTL",
    LAND: "Land", TAKEOFF: "Takeoff", DELAY: "Delay", LOITER_TO_HEIGHT: "LoitAltitude", ARC: "ArcWP",
    SPLINE: "SplineWP", VTOL_TAKEOFF: "VTOLTakeoff", VTOL_LAND: "VTOLLand", GUIDED: "GuidedEnable",
    PLACE_PAYLOAD: "PayloadPlace",
}  # fmt: skip
#: Items that must be in the air.
FLOWN = frozenset({WAYPOINT, LOITER, LOITER_TURNS, LOITER_TIME, LOITER_TO_HEIGHT, ARC, SPLINE})
CURVES = frozenset({ARC, SPLINE})
TAKEOFFS, LANDINGS = frozenset({TAKEOFF, VTOL_TAKEOFF}), frozenset({LAND, VTOL_LAND})
#: Navigation items, which need a takeoff first. CLIMB_ON is skipped by copters.
NAVIGATION = FLOWN | TAKEOFFS | LANDINGS | {RETURN, CLIMB_ON, GUIDED, PLACE_PAYLOAD}
#: Items whose parameter 1 is a time in seconds.
TIMED = frozenset({WAYPOINT, LOITER_TIME, SPLINE})
#: Metres above the ground at which a payload is released.
PUT_DOWN = 0.2
#: Metres within which a position is reached; lead on a curve in metres.
AT_PLACE, AHEAD = 1.0, 3.0
#: Half the longest wait of an item, in seconds.
LONGEST = 1e6


def mission_refusal(pilot: Pilot) -> tuple[str, ...]:
    """The texts when a mission cannot be flown, empty when it can. PX4 enters the mode on the ground."""
    items = pilot.mission.items[1 if pilot.flavour.home_item else 0 :]
    if not items:
        waits = pilot.flavour.takeoff_mode and not pilot.armed
        return () if waits else pilot.flavour.no_mission
    grounded = pilot.flies and pilot.armed and not pilot.vehicle.airborne
    if grounded and not pilot.flavour.takeoff_mode and not _starts_with_takeoff(items):
        return ("Auto: Missing Takeoff Cmd",)
    return ()


def _starts_with_takeoff(items: Sequence[MissionItem]) -> bool:
    """Whether the first navigation item is a takeoff; delays and immediate items may precede it."""
    first = next((item.command for item in items if item.command in NAVIGATION), None)
    return first in TAKEOFFS


def fly_mission(pilot: Pilot) -> None:
    """Flies the current item, and continues with the next when it is done."""
    mission = pilot.mission
    item = mission.item
    if item is None:
        if pilot.flavour.takeoff_mode and mission.items:
            pilot.say("Mission finished, loitering\t")
            pilot.go_on(Role.HOLD)
        return
    if _must_climb_first(pilot, item):
        return
    if mission.started != mission.current:
        mission.started = mission.current
        report_started(pilot, item)
        _start_item(pilot, item)
    _follow_curve(pilot)
    if pilot.role is Role.MISSION and mission.item is item and _done(pilot, item):
        _report_reached(pilot, item)
        mission.reach()


def report_started(pilot: Pilot, item: MissionItem) -> None:
    """Sends the text for the start of an item."""
    number = pilot.mission.current
    if pilot.flavour.home_item and item.command in NAMES:
        pilot.say(f"Mission: {number} {NAMES[item.command]}")
    elif pilot.flavour.takeoff_mode and number == 0:
        pilot.say("Executing Mission\t")
        if item.command in TAKEOFFS and item.place is not None:
            pilot.say(f"Climb to {pilot.home[2] - item.place[2]:.1f} meters above home\t")


def _report_reached(pilot: Pilot, item: MissionItem) -> None:
    """Sends ArduPilot's text for a reached item; a rover also reports the last one."""
    mission = pilot.mission
    if not pilot.flavour.home_item or item.command not in FLOWN:
        return
    pilot.say(f"Reached {'command' if pilot.flies else 'waypoint'} #{mission.current}")
    if not pilot.flies and mission.current == len(mission.items) - 1:
        pilot.say("Mission Complete")


def _must_climb_first(pilot: Pilot, item: MissionItem) -> bool:
    """Whether PX4 takes off by itself because a mission starts with a waypoint."""
    north, east, down = pilot.vehicle.place
    goal = pilot.homing.ground - pilot.takeoff_height
    climbing = pilot.flies and item.command in FLOWN and pilot.mission.started != pilot.mission.current
    if climbing and not pilot.vehicle.airborne:
        pilot.vehicle.goal = Reach((north, east, goal))
    return climbing and pilot.vehicle.goal == Reach((north, east, goal)) and down > goal + AT_HEIGHT


def _start_item(pilot: Pilot, item: MissionItem) -> None:
    place = item.place or pilot.vehicle.place
    if pilot.flavour.takeoff_mode and item.command in FLOWN | TAKEOFFS:
        # PX4's fourth value is a heading; with NaN it follows the path.
        heading = item.values[3]
        pilot.vehicle.yaw_goal = None if math.isnan(heading) else math.radians(_bounded(heading))
    if item.command == PLACE_PAYLOAD:
        # At the present height; the vehicle descends on arrival.
        pilot.vehicle.goal = Reach((*place[:2], pilot.vehicle.place[2]))
    elif item.command in FLOWN | LANDINGS:
        curved = item.command in CURVES and pilot.flies
        pilot.mission.curve = _curve_to(pilot, item, place) if curved else []
        pilot.mission.leg = None if item.values[0] else pilot.vehicle.place
        pilot.vehicle.goal = Reach(place)
    elif item.command in TAKEOFFS and pilot.flies:
        start_takeoff(pilot, place[2])
    elif item.command == RETURN:
        # The mission is complete; the return is another mode.
        pilot.mission.reach()
        pilot.fall_back(Role.RETURN)
    elif item.command in (JUMP, JUMP_TO_TAG):
        _jump(pilot, item)
    elif item.command not in (CLIMB_ON, DELAY, GUIDED, TAG):
        pilot.perform(item)


def _curve_to(pilot: Pilot, item: MissionItem, place: Vector) -> list[Vector]:
    """The curve from the present position; a spline stops at an end where it waits, or has no neighbour."""
    start, mission = pilot.vehicle.place, pilot.mission
    if item.command == ARC:
        return list(arc(start, place, _bounded(item.values[0])))
    later = (each for each in mission.items[mission.current + 1 :] if each.command in NAVIGATION)
    after = None if item.values[0] else next(later, None)
    if after is None or after.command not in FLOWN or after.place is None:
        return list(spline(mission.leg, start, place, None))
    return list(spline(mission.leg, start, place, after.place, straight_on=after.command != SPLINE))


def _follow_curve(pilot: Pilot) -> None:
    """Flies to a point slightly ahead on its curve; the last one is the goal."""
    curve = pilot.mission.curve
    if not curve:
        return
    while len(curve) > 1 and math.dist(pilot.vehicle.place, curve[0]) < AHEAD:
        curve.pop(0)
    if pilot.mission.arrived is None:
        pilot.vehicle.goal = Reach(curve[0])


def _jump(pilot: Pilot, item: MissionItem) -> None:
    mission, index = pilot.mission, pilot.mission.current
    goal, times = (int(_bounded(value)) for value in item.values[:2])
    if item.command == JUMP_TO_TAG:
        tags = (n for n, each in enumerate(mission.items) if each.command == TAG and each.values[0] == goal)
        goal = next(tags, -1)
    count = mission.jumps.get(index, 0)
    if (times < 0 or count < times) and mission.jump(goal):
        mission.jumps[index] = count + 1


def _done(pilot: Pilot, item: MissionItem) -> bool:
    if item.command in FLOWN:
        return _arrived(pilot, item) and item.command != LOITER and _waited(pilot, _stay_time(pilot, item))
    if item.command in TAKEOFFS and pilot.flies:
        return pilot.vehicle.place[2] <= (item.place or pilot.vehicle.place)[2] + AT_HEIGHT
    if item.command in LANDINGS:
        return _landed(pilot, item)
    if item.command == PLACE_PAYLOAD:
        return _placed(pilot, item)
    if item.command == GUIDED:
        return not item.values[0] > 0.5
    return item.command != DELAY or _waited(pilot, _bounded(item.values[0]))


def _arrived(pilot: Pilot, item: MissionItem) -> bool:
    """Whether the vehicle has reached the item's position; turns start there."""
    mission, vehicle = pilot.mission, pilot.vehicle
    if mission.arrived is None and len(mission.curve) < 2 and _is_near(pilot, item.place):
        mission.arrived = pilot.now
        if item.command == LOITER_TURNS and item.place is not None:
            vehicle.goal = Orbit(item.place, abs(_bounded(item.values[2])) or 5.0, vehicle.limits.cruise / 2)
    return mission.arrived is not None


def _is_near(pilot: Pilot, place: Vector | None) -> bool:
    # A rover ignores heights.
    parts = 3 if pilot.flies else 2
    return place is None or math.dist(pilot.vehicle.place[:parts], place[:parts]) < AT_PLACE


def _stay_time(pilot: Pilot, item: MissionItem) -> float:
    """The time to stay at an item, in seconds."""
    if item.command == LOITER_TURNS:
        radius = abs(_bounded(item.values[2])) or 5.0
        return abs(_bounded(item.values[0])) * math.tau * radius / (pilot.vehicle.limits.cruise / 2)
    return _bounded(item.values[0]) if item.command in TIMED else 0.0


def _waited(pilot: Pilot, seconds: float) -> bool:
    if pilot.mission.arrived is None:
        pilot.mission.arrived = pilot.now
    return pilot.now - pilot.mission.arrived >= seconds


def _landed(pilot: Pilot, item: MissionItem) -> bool:
    vehicle = pilot.vehicle
    is_over = item.place is None or math.dist(vehicle.place[:2], item.place[:2]) < AT_PLACE
    if pilot.flies and is_over:
        vehicle.goal = Descend()
    landed = is_over and pilot.landed
    if landed and pilot.flies:
        pilot.disarm()
    return landed


def _placed(pilot: Pilot, item: MissionItem) -> bool:
    """Descends over the position by at most parameter 1 in metres, and climbs back."""
    mission, vehicle = pilot.mission, pilot.vehicle
    place = vehicle.place
    is_over = item.place is None or math.dist(place[:2], item.place[:2]) < AT_PLACE
    goal = vehicle.goal
    if not (is_over and isinstance(goal, Reach)):
        return False
    if mission.arrived is None:
        deepest = _bounded(item.values[0])
        ground = pilot.homing.ground - PUT_DOWN
        down = min(place[2] + deepest, ground) if deepest > 0.0 else ground
        mission.arrived, mission.height = pilot.now, place[2]
        vehicle.goal = Reach((*place[:2], down))
    elif goal.place[2] != mission.height and abs(place[2] - goal.place[2]) < AT_HEIGHT:
        vehicle.goal = Reach((*place[:2], mission.height))
    return goal.place[2] == mission.height and abs(place[2] - mission.height) < AT_HEIGHT


def _bounded(value: float) -> float:
    """A value of an item as a finite number; NaN is 0."""
    return 0.0 if math.isnan(value) else max(-LONGEST, min(LONGEST, value))
