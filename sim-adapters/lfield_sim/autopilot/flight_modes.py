"""Behaviour of modes over time, and effects of faults.

Modes that are not listed below keep the goal set when they were entered, or by a setpoint.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from lfield_sim.autopilot.body.goals import Descend, Fall, Reach, Rest
from lfield_sim.autopilot.flavours import Role
from lfield_sim.autopilot.mission_flight import fly_mission
from lfield_sim.autopilot.pilot import Pilot
from lfield_sim.autopilot.takeoff_landing import AT_HEIGHT, AT_HOME, start_takeoff

#: Metres from a goal within which a rover has reached it.
AT_GOAL = 0.3
#: ArduCopter's return: seconds until its climb starts, and seconds to settle over home before its wait;
#: tolerances of that in m/s and m (f-fence-landing, f-fence-breach, i-home-moves).
STOPS, SETTLES, LEVEL = 0.9, 0.8, 0.1
#: The share of one motor's power that holds the height; one at which it sinks, and its m/s then (gauntlet-b:
#: 2.76 at the impact); seconds until its text (2.9 there).
HOLDS, WEAK, SAGS, WARNS_AFTER = 0.8, 0.6, 2.9, 2.9
#: Metres from home within which a return does not climb.
NEAR_HOME = 1.0


def fly(pilot: Pilot) -> None:
    """Applies the present mode."""
    if pilot.armed and pilot.role in _MODES:
        _MODES[pilot.role](pilot)


def _return(pilot: Pilot) -> None:
    """Flies up to the return height, to home or a rally point, pauses, and descends.

    An ArduCopter that was climbing returns to the height of the command, and waits there.
    """
    vehicle, home, pause = pilot.vehicle, pilot.homing.destination, pilot.return_pause
    north, east, down = vehicle.place
    distance = math.dist((north, east), home[:2])
    # ArduPilot approaches a rally point at its height, or higher; PX4's return height is above it.
    above = home[2] if pilot.flavour.takeoff_mode else pilot.home[2]
    height = min(above - pilot.return_height_at(distance), home[2])
    if not pilot.flies:
        vehicle.goal = Reach(home)
        if distance < AT_HOME:
            _come_home(pilot)
    elif not vehicle.airborne:
        vehicle.goal = Rest()
    elif pilot.over_home_at is not None or _is_over_home(pilot, distance):
        _come_home(pilot)
        hover_time = pilot.now - (pilot.over_home_at or 0.0)
        vehicle.goal = Descend() if hover_time >= pause + (SETTLES if pause else 0.0) else Rest()
    elif distance > NEAR_HOME and down > height + AT_HEIGHT:
        is_stopping = bool(pause) and pilot.now - pilot.entered_at < STOPS
        vehicle.goal = Rest() if is_stopping else Reach((north, east, height))
    else:
        return_down = pilot.entered_down if distance <= NEAR_HOME else min(pilot.entered_down, height)
        pilot.entered_down = return_down
        vehicle.goal = Reach((home[0], home[1], return_down if pause else min(down, height)))


def _is_over_home(pilot: Pilot, distance: float) -> bool:
    """Whether a copter has stopped over home; PX4 descends at once."""
    velocity = pilot.vehicle.velocity
    level = abs(velocity[2]) < LEVEL and abs(pilot.vehicle.place[2] - pilot.entered_down) < LEVEL
    return distance < AT_HEIGHT and math.hypot(*velocity[:2]) < 0.5 and (level or not pilot.return_pause)


def _come_home(pilot: Pilot) -> None:
    """Records that the vehicle is over home from now on, which PX4's copter reports."""
    if pilot.over_home_at is None and pilot.flavour.takeoff_mode and pilot.flies:
        pilot.say("RTL: land at destination\t")
    pilot.over_home_at = pilot.now if pilot.over_home_at is None else pilot.over_home_at


def _guided(pilot: Pilot) -> None:
    """Flies to the goal; ArduRover reports a reached goal as item 0."""
    goal = pilot.vehicle.goal
    if pilot.flies or pilot.flavour.takeoff_mode or goal is pilot.sent_goal or not isinstance(goal, Reach):
        return
    if math.dist(pilot.vehicle.place[:2], goal.place[:2]) < AT_GOAL:
        pilot.sent_goal = goal
        pilot.mission.add_reached(0)


def _take_off(pilot: Pilot) -> None:
    """Flies PX4's mode: up to MIS_TAKEOFF_ALT, then hold; a rover completes it at once."""
    goal = pilot.homing.ground - pilot.takeoff_height
    if not pilot.flies:
        pilot.on_its_way = True
        pilot.go_on(Role.HOLD)
    elif pilot.vehicle.place[2] <= goal + AT_HEIGHT:
        place = (*pilot.vehicle.place[:2], goal)
        pilot.go_on(Role.HOLD)
        pilot.vehicle.goal = Reach(place)
    elif pilot.lifts_at is None:
        start_takeoff(pilot, goal)


def _land(pilot: Pilot) -> None:
    """Descends at the present position, when the descent is due."""
    if pilot.flies and isinstance(pilot.vehicle.goal, Rest) and pilot.now >= pilot.sinks_at:
        pilot.vehicle.goal = Descend()


_MODES: Mapping[Role, Callable[[Pilot], None]] = {
    Role.GUIDED: _guided,
    Role.LAND: _land,
    Role.RETURN: _return,
    Role.TAKEOFF: _take_off,
    Role.MISSION: fly_mission,
}


def _lack_power(pilot: Pilot) -> None:
    """Makes a copter with a weak motor sink, which an ArduCopter reports after a while."""
    weak = pilot.flies and pilot.armed and pilot.vehicle.airborne and pilot.motor_power < HOLDS
    pilot.vehicle.sags = (HOLDS - pilot.motor_power) / (HOLDS - WEAK) * SAGS if weak else 0.0
    if not weak:
        pilot.weak_at = math.inf
    elif pilot.weak_at == math.inf:
        pilot.weak_at = pilot.now
    elif -math.inf < pilot.weak_at < pilot.now - WARNS_AFTER:
        if pilot.flavour.thrust_loss:
            pilot.say(pilot.flavour.thrust_loss)
        pilot.weak_at = -math.inf


def apply_motor_faults(pilot: Pilot) -> None:
    """Makes a copter with a dead motor spin and fall, one with a weak motor sink, and stops a rover."""
    _lack_power(pilot)
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
        if not falling and pilot.flavour.thrust_loss:
            pilot.say(pilot.flavour.thrust_loss)
        vehicle.goal, vehicle.yaw_rate_goal = Fall(), math.tau
