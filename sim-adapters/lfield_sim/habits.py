"""What a vehicle does whatever its mode: disarms when it is idle, suffers from a dead motor."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from lfield_sim.flavours import Role, Severity
from lfield_sim.vehicle import Fall, Rest

if TYPE_CHECKING:
    from lfield_sim.autopilot import Autopilot


def disarm_when_idle(pilot: Autopilot) -> None:
    """A copter that landed, or never took off, disarms itself."""
    if not pilot.flies or not pilot.armed:
        return
    if pilot.vehicle.airborne:
        pilot.landed_at, pilot.armed_at = math.inf, pilot.now
        return
    if pilot.landed_at == math.inf:
        pilot.landed_at = pilot.now
    over = pilot.role in (Role.LAND, Role.RETURN)
    wait = pilot.value(pilot.flavour.land_delay) if pilot.flavour.land_delay else 0.0
    delay = pilot.value(pilot.flavour.disarm_delay)
    landed = over and (pilot.landed_at is None or pilot.now - pilot.landed_at >= wait)
    forgotten = isinstance(pilot.vehicle.goal, Rest) and 0.0 < delay < pilot.now - pilot.armed_at
    if landed or forgotten:
        pilot.disarm()


def suffer(pilot: Autopilot) -> None:
    """A copter with a dead motor spins and comes down; a rover stands."""
    vehicle = pilot.vehicle
    if not pilot.motor_failed or not pilot.armed:
        return
    falling = isinstance(vehicle.goal, Fall)
    if not pilot.flies:
        vehicle.goal = Rest()
    elif falling and not vehicle.airborne:
        pilot.say("Crash: Disarming", Severity.CRITICAL)
        pilot.disarm()
    elif vehicle.airborne:
        if not falling:
            pilot.say("Potential Thrust Loss (1)", Severity.CRITICAL)
        vehicle.goal, vehicle.yaw_rate_goal = Fall(), math.tau
