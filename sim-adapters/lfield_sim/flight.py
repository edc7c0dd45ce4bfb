"""What the flight modes do as time passes: return, land, take off, fly a mission."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from lfield_sim.flavours import Role
from lfield_sim.mission import MissionItem
from lfield_sim.vehicle import Circle, Descend, Reach, Rest, Vector

if TYPE_CHECKING:
    from lfield_sim.autopilot import Autopilot

# MAV_CMDs of mission items that are flown; others are done at once.
WAYPOINT, LOITER, LOITER_TURNS, LOITER_TIME, RETURN, LAND, TAKEOFF = 16, 17, 18, 19, 20, 21, 22
DELAY, JUMP = 93, 177
#: What needs to be in the air.
FLOWN = frozenset({WAYPOINT, LOITER, LOITER_TURNS, LOITER_TIME})
#: Metres within which a place and a height are reached.
AT_PLACE, AT_HEIGHT = 1.0, 0.3
#: Half the longest time that an item can wait, in seconds.
LONGEST = 1e6


def fly(pilot: Autopilot) -> None:
    """Let the present mode have its way."""
    if pilot.armed:
        _MODES.get(pilot.role, _stay)(pilot)


def why_no_mission(pilot: Autopilot) -> str:
    """Why a mission cannot be flown, '' when it can."""
    items = pilot.mission.items[1 if pilot.flavour.home_item else 0 :]
    if not items:
        return f"Mode change to {pilot.kind.mode_for(Role.MISSION)} failed: no mission"
    grounded = pilot.flies and pilot.armed and not pilot.vehicle.airborne
    if grounded and not pilot.flavour.takeoff_mode and items[0].command != TAKEOFF:
        return "Auto: Missing Takeoff Cmd"
    return ""


def circle_ahead(pilot: Autopilot) -> Circle:
    """ArduCopter's CIRCLE: the centre is a radius (cm) ahead; CIRCLE_RATE is in degrees per second."""
    radius = min(max(pilot.value("CIRCLE_RADIUS") / 100.0, 1.0), 2000.0)
    north, east, down = pilot.vehicle.place
    yaw = pilot.vehicle.yaw
    centre = (north + radius * math.cos(yaw), east + radius * math.sin(yaw), down)
    return Circle(centre, radius, math.radians(min(pilot.value("CIRCLE_RATE"), 90.0)) * radius)


def _stay(_: Autopilot) -> None:
    """What the vehicle does was decided when the mode was entered or a setpoint came."""


def _return(pilot: Autopilot) -> None:
    """Up to the return height, over to home, down."""
    vehicle, home = pilot.vehicle, pilot.home
    north, east, down = vehicle.place
    far = math.dist((north, east), home[:2])
    height = home[2] - pilot.return_height
    if not pilot.flies:
        vehicle.goal = Reach(home)
    elif not vehicle.airborne:
        vehicle.goal = Rest()
    elif far < AT_HEIGHT and math.hypot(*vehicle.velocity[:2]) < 0.5:
        vehicle.goal = Descend()
    elif far > 1.0 and down > height + AT_HEIGHT:
        vehicle.goal = Reach((north, east, height))
    else:
        vehicle.goal = Reach((home[0], home[1], min(down, height)))


def _take_off(pilot: Autopilot) -> None:
    """PX4's mode: up to MIS_TAKEOFF_ALT, then hold."""
    goal = pilot.home[2] - pilot.takeoff_height
    north, east, down = pilot.vehicle.place
    if down <= goal + AT_HEIGHT:
        pilot.fall_back(Role.HOLD)
    elif not isinstance(pilot.vehicle.goal, Reach):
        pilot.vehicle.goal = Reach((north, east, goal))


def _fly_mission(pilot: Autopilot) -> None:
    mission = pilot.mission
    item = mission.item
    if item is None:
        if pilot.flavour.takeoff_mode:
            pilot.say("Mission finished, loitering")
            pilot.fall_back(Role.HOLD)
        return
    if _must_climb_first(pilot, item):
        return
    if mission.begun != mission.current:
        mission.begun = mission.current
        _begin(pilot, item)
    if pilot.role is Role.MISSION and mission.item is item and _done(pilot, item):
        mission.reach()


def _must_climb_first(pilot: Autopilot, item: MissionItem) -> bool:
    """PX4 takes off by itself when a mission begins with a waypoint."""
    north, east, down = pilot.vehicle.place
    goal = pilot.home[2] - pilot.takeoff_height
    climbing = pilot.flies and item.command in FLOWN and pilot.mission.begun != pilot.mission.current
    if climbing and not pilot.vehicle.airborne:
        pilot.vehicle.goal = Reach((north, east, goal))
    return climbing and pilot.vehicle.goal == Reach((north, east, goal)) and down > goal + AT_HEIGHT


def _begin(pilot: Autopilot, item: MissionItem) -> None:
    place = item.place or pilot.vehicle.place
    if item.command in FLOWN or item.command == LAND:
        pilot.vehicle.goal = Reach(place)
    elif item.command == TAKEOFF and pilot.flies:
        pilot.vehicle.goal = Reach((*pilot.vehicle.place[:2], place[2]))
    elif item.command == RETURN:
        # The mission has done its part; the way home is the other mode's.
        pilot.mission.reach()
        pilot.fall_back(Role.RETURN)
    elif item.command == JUMP:
        _jump(pilot, item)
    elif item.command != DELAY:
        pilot.perform(item)


def _jump(pilot: Autopilot, item: MissionItem) -> None:
    mission, here = pilot.mission, pilot.mission.current
    goal, times = (int(_bounded(value)) for value in item.values[:2])
    taken = mission.jumps.get(here, 0)
    if (times < 0 or taken < times) and mission.jump(goal):
        mission.jumps[here] = taken + 1


def _done(pilot: Autopilot, item: MissionItem) -> bool:
    if item.command in FLOWN:
        return _arrived(pilot, item) and item.command != LOITER and _waited(pilot, _stay_time(pilot, item))
    if item.command == TAKEOFF and pilot.flies:
        return pilot.vehicle.place[2] <= (item.place or pilot.vehicle.place)[2] + AT_HEIGHT
    if item.command == LAND:
        return _landed(pilot, item)
    return item.command != DELAY or _waited(pilot, _bounded(item.values[0]))


def _arrived(pilot: Autopilot, item: MissionItem) -> bool:
    """Whether it is, or has been, at the item's place; turns begin there."""
    mission, vehicle = pilot.mission, pilot.vehicle
    if mission.arrived is None and _near(pilot, item.place):
        mission.arrived = pilot.now
        if item.command == LOITER_TURNS and item.place is not None:
            vehicle.goal = Circle(item.place, abs(_bounded(item.values[2])) or 5.0, vehicle.limits.cruise / 2)
    return mission.arrived is not None


def _near(pilot: Autopilot, place: Vector | None) -> bool:
    return place is None or math.dist(pilot.vehicle.place, place) < AT_PLACE


def _stay_time(pilot: Autopilot, item: MissionItem) -> float:
    """How long an item is stayed at, in seconds."""
    if item.command == LOITER_TURNS:
        radius = abs(_bounded(item.values[2])) or 5.0
        return abs(_bounded(item.values[0])) * math.tau * radius / (pilot.vehicle.limits.cruise / 2)
    return _bounded(item.values[0])


def _waited(pilot: Autopilot, seconds: float) -> bool:
    if pilot.mission.arrived is None:
        pilot.mission.arrived = pilot.now
    return pilot.now - pilot.mission.arrived >= seconds


def _landed(pilot: Autopilot, item: MissionItem) -> bool:
    vehicle = pilot.vehicle
    over = item.place is None or math.dist(vehicle.place[:2], item.place[:2]) < AT_PLACE
    if pilot.flies and over:
        vehicle.goal = Descend()
    landed = over and not vehicle.airborne
    if landed and pilot.flies:
        pilot.disarm()
    return landed


def _bounded(value: float) -> float:
    """A value of an item as a number that can be counted with; NaN is 0."""
    return 0.0 if math.isnan(value) else max(-LONGEST, min(LONGEST, value))


_MODES: Mapping[Role, Callable[[Autopilot], None]] = {
    Role.RETURN: _return,
    Role.TAKEOFF: _take_off,
    Role.MISSION: _fly_mission,
}
