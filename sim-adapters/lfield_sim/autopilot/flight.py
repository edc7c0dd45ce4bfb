"""What a vehicle does as time passes: by its mode, and whatever its mode.

Modes that are not listed here go on with what was decided when they were entered, or when a setpoint came.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from lfield_sim.autopilot.flavours import Role, Severity
from lfield_sim.autopilot.missions import AT_HEIGHT, fly_mission
from lfield_sim.autopilot.pilot import Pilot
from lfield_sim.autopilot.vehicle import Descend, Fall, Reach, Rest


def fly(pilot: Pilot) -> None:
    """Let the present mode have its way."""
    if pilot.armed and pilot.role in _MODES:
        _MODES[pilot.role](pilot)


def _return(pilot: Pilot) -> None:
    """Up to the return height, over to home, a moment there, down."""
    vehicle, home = pilot.vehicle, pilot.home
    north, east, down = vehicle.place
    far = math.dist((north, east), home[:2])
    height = home[2] - pilot.return_height
    if not pilot.flies:
        vehicle.goal = Reach(home)
    elif not vehicle.airborne:
        vehicle.goal = Rest()
    elif far < AT_HEIGHT and math.hypot(*vehicle.velocity[:2]) < 0.5:
        if pilot.over_home_at is None:
            pilot.over_home_at = pilot.now
        vehicle.goal = Descend() if pilot.now - pilot.over_home_at >= pilot.return_pause else Rest()
    elif far > 1.0 and down > height + AT_HEIGHT:
        vehicle.goal = Reach((north, east, height))
    else:
        vehicle.goal = Reach((home[0], home[1], min(down, height)))


def _take_off(pilot: Pilot) -> None:
    """PX4's mode: up to MIS_TAKEOFF_ALT, then hold there."""
    goal = pilot.homing.ground - pilot.takeoff_height
    north, east, down = pilot.vehicle.place
    if down <= goal + AT_HEIGHT:
        pilot.go_on(Role.HOLD)
        pilot.vehicle.goal = Reach((north, east, goal))
    elif not isinstance(pilot.vehicle.goal, Reach):
        pilot.vehicle.goal = Reach((north, east, goal))


_MODES: Mapping[Role, Callable[[Pilot], None]] = {
    Role.RETURN: _return,
    Role.TAKEOFF: _take_off,
    Role.MISSION: fly_mission,
}


def disarm_when_idle(pilot: Pilot) -> None:
    """A copter that landed, or never took off, disarms itself."""
    if not pilot.flies or not pilot.armed:
        return
    if pilot.vehicle.airborne:
        pilot.touched_at, pilot.armed_at = math.inf, pilot.now
        return
    if pilot.touched_at == math.inf:
        pilot.touched_at = pilot.now
    delay = pilot.value(pilot.flavour.disarm_delay)
    if _is_over(pilot):
        pilot.disarm(text=pilot.flavour.landed_text)
        if pilot.flavour.takeoff_mode:
            # PX4 leaves a mode that has done what it is for.
            pilot.go_on(Role.HOLD)
    elif isinstance(pilot.vehicle.goal, Rest) and 0.0 < delay < pilot.now - pilot.armed_at:
        pilot.disarm(text=pilot.flavour.idle_text)


def _is_over(pilot: Pilot) -> bool:
    """Whether a landing has ended so long ago that the motors go off."""
    if pilot.role not in (Role.LAND, Role.RETURN) or not pilot.landed:
        return False
    delay = pilot.flavour.land_delay
    wait = pilot.value(delay) if isinstance(delay, str) else delay
    return pilot.touched_at is None or pilot.now - pilot.touched_at >= pilot.flavour.settles + wait


def suffer(pilot: Pilot) -> None:
    """A copter with a dead motor spins and comes down; a rover stands."""
    vehicle = pilot.vehicle
    if not pilot.motor_failed or not pilot.armed:
        return
    falling = isinstance(vehicle.goal, Fall)
    if not pilot.flies:
        vehicle.goal = Rest()
    elif falling and not vehicle.airborne:
        pilot.say("Crash: Disarming", Severity.CRITICAL)
        pilot.disarm(force=True)
    elif vehicle.airborne:
        if not falling:
            pilot.say("Potential Thrust Loss (1)", Severity.CRITICAL)
        vehicle.goal, vehicle.yaw_rate_goal = Fall(), math.tau
