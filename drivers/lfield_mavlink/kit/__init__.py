"""Conformance kit of MAVLink vehicles, for simulated and real autopilots.

Ground checks first, then motion: a copter climbs to 3 m, all vehicles move 3 m. Stored data (mission, fence,
parameters) is restored at the end.
"""

from __future__ import annotations

from lfield.driver.kit import Kit
from lfield_mavlink.kit.ground_checks import GROUND
from lfield_mavlink.kit.motion_checks import MOTION
from lfield_mavlink.kit.plan_checks import PLANS

KIT = Kit([*GROUND.checks, *PLANS.checks, *MOTION.checks])
