"""The conformance kit of MAVLink vehicles: what any autopilot must do for this driver, fake or real.

First what is tried on the ground, then what moves. That stays small: a copter climbs to 3 m, both go 3 m far.
What the vehicle keeps (mission, fence, parameters) is as before when the kit has ended.
"""

from __future__ import annotations

from lfield.driver.kit import Kit
from lfield_mavlink.kit.ground import GROUND
from lfield_mavlink.kit.motion import MOTION
from lfield_mavlink.kit.plans import PLANS

KIT = Kit([*GROUND.checks, *PLANS.checks, *MOTION.checks])
