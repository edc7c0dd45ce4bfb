"""What a vehicle does as time passes: by its mode, and whatever its mode.

Modes that are not listed here go on with what was decided when they were entered, or when a setpoint came.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from lfield_sim.autopilot.flavours import Role
from lfield_sim.autopilot.lifting import AT_HEIGHT, AT_HOME, begin_takeoff
from lfield_sim.autopilot.missions import fly_mission
from lfield_sim.autopilot.pilot import Pilot
from lfield_sim.autopilot.vehicle import Descend, Fall, Reach, Rest

#: Metres from a goal within which a rover has reached it.
AT_GOAL = 0.3


def fly(pilot: Pilot) -> None:
    """Let the present mode have its way."""
    if pilot.armed and pilot.role in _MODES:
        _MODES[pilot.role](pilot)


def _return(pilot: Pilot) -> None:
    """Up to the return height, over to home, a moment there, down."""
    vehicle, home = pilot.vehicle, pilot.home
    north, east, down = vehicle.place
    far = math.dist((north, east), home[:2])
    height = home[2] - pilot.return_height_at(far)
    if not pilot.flies:
        vehicle.goal = Reach(home)
        if far < AT_HOME:
            _come_home(pilot)
    elif not vehicle.airborne:
        vehicle.goal = Rest()
    elif far < AT_HEIGHT and math.hypot(*vehicle.velocity[:2]) < 0.5:
        _come_home(pilot)
        vehicle.goal = Descend() if pilot.now - (pilot.over_home_at or 0.0) >= pilot.return_pause else Rest()
    elif far > 1.0 and down > height + AT_HEIGHT:
        vehicle.goal = Reach((north, east, height))
    else:
        vehicle.goal = Reach((home[0], home[1], min(down, height)))


def _come_home(pilot: Pilot) -> None:
    """It is over home from now on, which PX4 tells."""
    if pilot.over_home_at is None and pilot.flavour.takeoff_mode:
        pilot.say("RTL: land at destination\t")
    pilot.over_home_at = pilot.now if pilot.over_home_at is None else pilot.over_home_at


def _guided(pilot: Pilot) -> None:
    """ArduRover tells a goal that it has reached as item 0."""
    goal = pilot.vehicle.goal
    if pilot.flies or pilot.flavour.takeoff_mode or goal is pilot.told_goal or not isinstance(goal, Reach):
        return
    if math.dist(pilot.vehicle.place[:2], goal.place[:2]) < AT_GOAL:
        pilot.told_goal = goal
        pilot.mission.tell(0)


def _take_off(pilot: Pilot) -> None:
    """PX4's mode: up to MIS_TAKEOFF_ALT, then hold there; a rover is where it is to be at once."""
    goal = pilot.homing.ground - pilot.takeoff_height
    if not pilot.flies:
        pilot.on_its_way = True
        pilot.go_on(Role.HOLD)
    elif pilot.vehicle.place[2] <= goal + AT_HEIGHT:
        place = (*pilot.vehicle.place[:2], goal)
        pilot.go_on(Role.HOLD)
        pilot.vehicle.goal = Reach(place)
    elif pilot.lifts_at is None:
        begin_takeoff(pilot, goal)


def _land(pilot: Pilot) -> None:
    """Down where it is, when it is to go down."""
    if pilot.flies and isinstance(pilot.vehicle.goal, Rest) and pilot.now >= pilot.sinks_at:
        pilot.vehicle.goal = Descend()


_MODES: Mapping[Role, Callable[[Pilot], None]] = {
    Role.GUIDED: _guided,
    Role.LAND: _land,
    Role.RETURN: _return,
    Role.TAKEOFF: _take_off,
    Role.MISSION: fly_mission,
}


def suffer(pilot: Pilot) -> None:
    """A copter with a dead motor spins and comes down; a rover stands."""
    vehicle = pilot.vehicle
    if not pilot.motor_failed or not pilot.armed:
        return
    falling = isinstance(vehicle.goal, Fall)
    if not pilot.flies:
        vehicle.goal = Rest()
    elif falling and not vehicle.airborne:
        pilot.say("Crash: Disarming")
        pilot.disarm(force=True)
    elif vehicle.airborne:
        if not falling:
            pilot.say("Potential Thrust Loss (1)")
        vehicle.goal, vehicle.yaw_rate_goal = Fall(), math.tau
