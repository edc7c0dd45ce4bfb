"""How a mission is flown: item after item, by what each MAV_CMD asks for."""

from __future__ import annotations

import math

from lfield_sim.autopilot.body.goals import Circle, Descend, Reach, Vector
from lfield_sim.autopilot.flavours import Role
from lfield_sim.autopilot.lifting import AT_HEIGHT, begin_takeoff
from lfield_sim.autopilot.pilot import Pilot
from lfield_sim.autopilot.plans import MissionItem

# MAV_CMDs of mission items that are flown; others are done at once.
WAYPOINT, LOITER, LOITER_TURNS, LOITER_TIME, RETURN, LAND, TAKEOFF = 16, 17, 18, 19, 20, 21, 22
DELAY, JUMP = 93, 177
#: How ArduPilot calls what it begins, for its texts.
NAMES = {
    WAYPOINT: "WP", LOITER: "LoitUnlim", LOITER_TURNS: "LoitTurns", LOITER_TIME: "LoitTime", RETURN: "RTL",
    LAND: "Land", TAKEOFF: "Takeoff", DELAY: "Delay",
}  # fmt: skip
#: What needs to be in the air.
FLOWN = frozenset({WAYPOINT, LOITER, LOITER_TURNS, LOITER_TIME})
#: Metres within which a place is reached.
AT_PLACE = 1.0
#: Half the longest time that an item can wait, in seconds.
LONGEST = 1e6


def why_no_mission(pilot: Pilot) -> tuple[str, ...]:
    """What is said when a mission cannot be flown, nothing when it can. PX4 on the ground enters the mode."""
    items = pilot.mission.items[1 if pilot.flavour.home_item else 0 :]
    if not items:
        waits = pilot.flavour.takeoff_mode and not pilot.armed
        return () if waits else pilot.flavour.no_mission
    grounded = pilot.flies and pilot.armed and not pilot.vehicle.airborne
    if grounded and not pilot.flavour.takeoff_mode and items[0].command != TAKEOFF:
        return ("Auto: Missing Takeoff Cmd",)
    return ()


def fly_mission(pilot: Pilot) -> None:
    """Fly the current item, and go on to the next when it is done."""
    mission = pilot.mission
    item = mission.item
    if item is None:
        if pilot.flavour.takeoff_mode and mission.items:
            pilot.say("Mission finished, loitering\t")
            pilot.go_on(Role.HOLD)
        return
    if _must_climb_first(pilot, item):
        return
    if mission.begun != mission.current:
        mission.begun = mission.current
        tell_begun(pilot, item)
        _begin(pilot, item)
    if pilot.role is Role.MISSION and mission.item is item and _done(pilot, item):
        _tell_reached(pilot, item)
        mission.reach()


def tell_begun(pilot: Pilot, item: MissionItem) -> None:
    """What is said when an item is begun."""
    number = pilot.mission.current
    if pilot.flavour.home_item and item.command in NAMES:
        pilot.say(f"Mission: {number} {NAMES[item.command]}")
    elif pilot.flavour.takeoff_mode and number == 0:
        pilot.say("Executing Mission\t")
        if item.command == TAKEOFF and item.place is not None:
            pilot.say(f"Climb to {pilot.home[2] - item.place[2]:.1f} meters above home\t")


def _tell_reached(pilot: Pilot, item: MissionItem) -> None:
    """ArduPilot's words, of what is flown to; a rover also says when the last one is reached."""
    mission = pilot.mission
    if not pilot.flavour.home_item or item.command not in FLOWN:
        return
    pilot.say(f"Reached {'command' if pilot.flies else 'waypoint'} #{mission.current}")
    if not pilot.flies and mission.current == len(mission.items) - 1:
        pilot.say("Mission Complete")


def _must_climb_first(pilot: Pilot, item: MissionItem) -> bool:
    """PX4 takes off by itself when a mission begins with a waypoint."""
    north, east, down = pilot.vehicle.place
    goal = pilot.homing.ground - pilot.takeoff_height
    climbing = pilot.flies and item.command in FLOWN and pilot.mission.begun != pilot.mission.current
    if climbing and not pilot.vehicle.airborne:
        pilot.vehicle.goal = Reach((north, east, goal))
    return climbing and pilot.vehicle.goal == Reach((north, east, goal)) and down > goal + AT_HEIGHT


def _begin(pilot: Pilot, item: MissionItem) -> None:
    place = item.place or pilot.vehicle.place
    if pilot.flavour.takeoff_mode and item.command in (*FLOWN, TAKEOFF):
        # PX4's fourth value is a heading; with NaN the nose goes first.
        heading = item.values[3]
        pilot.vehicle.yaw_goal = None if math.isnan(heading) else math.radians(_bounded(heading))
    if item.command in FLOWN or item.command == LAND:
        pilot.vehicle.goal = Reach(place)
    elif item.command == TAKEOFF and pilot.flies:
        begin_takeoff(pilot, place[2])
    elif item.command == RETURN:
        # The mission has done its part; the way home is the other mode's.
        pilot.mission.reach()
        pilot.fall_back(Role.RETURN)
    elif item.command == JUMP:
        _jump(pilot, item)
    elif item.command != DELAY:
        pilot.perform(item)


def _jump(pilot: Pilot, item: MissionItem) -> None:
    mission, here = pilot.mission, pilot.mission.current
    goal, times = (int(_bounded(value)) for value in item.values[:2])
    taken = mission.jumps.get(here, 0)
    if (times < 0 or taken < times) and mission.jump(goal):
        mission.jumps[here] = taken + 1


def _done(pilot: Pilot, item: MissionItem) -> bool:
    if item.command in FLOWN:
        return _arrived(pilot, item) and item.command != LOITER and _waited(pilot, _stay_time(pilot, item))
    if item.command == TAKEOFF and pilot.flies:
        return pilot.vehicle.place[2] <= (item.place or pilot.vehicle.place)[2] + AT_HEIGHT
    if item.command == LAND:
        return _landed(pilot, item)
    return item.command != DELAY or _waited(pilot, _bounded(item.values[0]))


def _arrived(pilot: Pilot, item: MissionItem) -> bool:
    """Whether it is, or has been, at the item's place; turns begin there."""
    mission, vehicle = pilot.mission, pilot.vehicle
    if mission.arrived is None and _near(pilot, item.place):
        mission.arrived = pilot.now
        if item.command == LOITER_TURNS and item.place is not None:
            vehicle.goal = Circle(item.place, abs(_bounded(item.values[2])) or 5.0, vehicle.limits.cruise / 2)
    return mission.arrived is not None


def _near(pilot: Pilot, place: Vector | None) -> bool:
    # What drives knows no heights.
    parts = 3 if pilot.flies else 2
    return place is None or math.dist(pilot.vehicle.place[:parts], place[:parts]) < AT_PLACE


def _stay_time(pilot: Pilot, item: MissionItem) -> float:
    """How long an item is stayed at, in seconds."""
    if item.command == LOITER_TURNS:
        radius = abs(_bounded(item.values[2])) or 5.0
        return abs(_bounded(item.values[0])) * math.tau * radius / (pilot.vehicle.limits.cruise / 2)
    return _bounded(item.values[0])


def _waited(pilot: Pilot, seconds: float) -> bool:
    if pilot.mission.arrived is None:
        pilot.mission.arrived = pilot.now
    return pilot.now - pilot.mission.arrived >= seconds


def _landed(pilot: Pilot, item: MissionItem) -> bool:
    vehicle = pilot.vehicle
    over = item.place is None or math.dist(vehicle.place[:2], item.place[:2]) < AT_PLACE
    if pilot.flies and over:
        vehicle.goal = Descend()
    landed = over and pilot.landed
    if landed and pilot.flies:
        pilot.disarm()
    return landed


def _bounded(value: float) -> float:
    """A value of an item as a number that can be counted with; NaN is 0."""
    return 0.0 if math.isnan(value) else max(-LONGEST, min(LONGEST, value))
