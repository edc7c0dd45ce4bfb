"""Takeoff and landing: motion, texts, and disarming.

Times from the traces `f-fence-landing` and `l-px4-rover`. A takeoff is accepted at once; the motors spin up
before it leaves the ground. PX4's rover "takes off" and "lands" on the spot.
"""

from __future__ import annotations

import math
from enum import IntEnum

from lfield_sim.autopilot.body.goals import Descend, Reach, Rest, Rise
from lfield_sim.autopilot.flavours import Role
from lfield_sim.autopilot.pilot import Pilot

#: Tolerance of a height in metres; climb after which an ArduCopter reports its takeoff.
AT_HEIGHT, LIFTED = 0.3, 0.2
#: PX4's rover: metres from home at which its return is complete, the speed in m/s above which it is on its
#: way.
AT_HOME, ROLLS = 0.5, 0.3


class LandedState(IntEnum):
    """MAV_LANDED_STATE."""

    UNDEFINED = 0
    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


def landed_state(pilot: Pilot) -> LandedState:
    """The reported landed state; ArduPilot's rover reports none."""
    if not pilot.kind.lands:
        return LandedState.UNDEFINED
    if not pilot.flies:
        # PX4's rover reports its whole return as a landing.
        returns = LandedState.LANDING if pilot.role is Role.RETURN else LandedState.IN_AIR
        return LandedState.ON_GROUND if pilot.landed else returns
    if not (pilot.armed or pilot.flavour.takeoff_mode):
        # ArduPilot reports this whenever its motors are off, even in a fall.
        return LandedState.ON_GROUND
    if pilot.lifts_at is not None:
        return LandedState.TAKEOFF if _has_lifted(pilot) else LandedState.ON_GROUND
    if pilot.landed:
        return LandedState.ON_GROUND
    # After the touch-down of a return, the autopilot still reports a landing for a while.
    touched = pilot.role is Role.RETURN and not pilot.aloft
    descends = pilot.role is Role.LAND or isinstance(pilot.vehicle.goal, Descend) or touched
    return LandedState.LANDING if descends else LandedState.IN_AIR


def _has_lifted(pilot: Pilot) -> bool:
    if pilot.flavour.takeoff_mode:
        return pilot.now >= (pilot.lifts_at or 0.0)
    return pilot.vehicle.place[2] < -LIFTED


def start_takeoff(pilot: Pilot, down: float) -> None:
    """Climbs vertically to a height, once the motors have spun up."""
    pilot.speed_control.enter(guided=True)
    pilot.lifts_at = pilot.now
    if not pilot.vehicle.airborne:
        limits = pilot.kind.limits
        pilot.lifts_at = max(pilot.now + limits.spool, pilot.armed_first + limits.awake)
    pilot.lift_goal = down
    pilot.vehicle.goal = Rest()


def rise(pilot: Pilot) -> None:
    """Continues a takeoff, until the vehicle is at its height or another command is given."""
    if pilot.lifts_at is None:
        return
    vehicle = pilot.vehicle
    if not pilot.armed or not isinstance(vehicle.goal, Rest | Rise):
        pilot.lifts_at = None
    elif vehicle.place[2] <= pilot.lift_goal + AT_HEIGHT:
        pilot.lifts_at = None
        vehicle.goal = pilot.risen_to = Reach((*vehicle.place[:2], pilot.lift_goal))
    elif pilot.now >= pilot.lifts_at:
        vehicle.goal = Rise(pilot.lift_goal, vehicle.limits.takeoff)


def disarm_when_idle(pilot: Pilot) -> None:
    """Disarms a vehicle that landed, or never took off; ArduPilot's rover stays armed."""
    if not pilot.kind.lands or not pilot.armed:
        return
    _count_as_flying(pilot)
    _say_landed(pilot)
    if pilot.aloft:
        pilot.touched_at, pilot.armed_at = math.inf, pilot.now
        return
    if pilot.touched_at == math.inf:
        pilot.touched_at = pilot.now
    delay = pilot.value(pilot.flavour.disarm_delay)
    if _is_over(pilot):
        pilot.disarm(text=pilot.flavour.landed_text)
        if pilot.flavour.takeoff_mode:
            # PX4 leaves a completed mode; after a landing for the previous mode.
            lands = pilot.role is Role.LAND
            pilot.command(pilot.resumes if lands else pilot.kind.mode_for(Role.HOLD))
    elif isinstance(pilot.vehicle.goal, Rest) and 0.0 < delay < pilot.now - pilot.armed_at:
        pilot.disarm(text=pilot.flavour.idle_text)


def _count_as_flying(pilot: Pilot) -> None:
    """Counts PX4's rover as flying from its start until it lands, or is back home."""
    if pilot.flies:
        return
    vehicle = pilot.vehicle
    speed, distance = math.hypot(*vehicle.velocity[:2]), math.dist(vehicle.place[:2], pilot.home[:2])
    if pilot.role is Role.LAND or (pilot.role is Role.RETURN and distance < AT_HOME and speed < ROLLS):
        pilot.on_its_way = False
    elif speed > ROLLS:
        pilot.on_its_way = True


def _say_landed(pilot: Pilot) -> None:
    """Sends PX4's texts about takeoff and landing."""
    is_landed = pilot.landed
    if is_landed != pilot.was_landed and pilot.flavour.takeoff_mode:
        pilot.say("Landing detected\t" if is_landed else "Takeoff detected\t")
    pilot.was_landed = is_landed


def _is_over(pilot: Pilot) -> bool:
    """Whether the motors go off after a landing."""
    # PX4 needs no mode for that: after a flight, rest means landed.
    lands = pilot.role in (Role.LAND, Role.RETURN)
    lands = lands or (pilot.flavour.takeoff_mode and pilot.touched_at is not None)
    if not lands or not pilot.landed:
        return False
    delay = pilot.flavour.land_delay
    if isinstance(delay, str) and pilot.parameters[delay] < 0.0:
        # COM_DISARM_LAND = -1: they stay on.
        return False
    wait = pilot.value(delay) if isinstance(delay, str) else delay
    return pilot.touched_at is None or pilot.now - pilot.touched_at >= pilot.settles + wait
