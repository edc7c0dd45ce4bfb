"""A pilot who moves the sticks: a PX4 hands over in the modes that COM_RC_OVERRIDE names."""

from __future__ import annotations

from lfield_sim.autopilot.flavours import Role
from lfield_sim.autopilot.pilot import Pilot

#: Bits of COM_RC_OVERRIDE: in modes that it flies by itself, and in OFFBOARD.
IN_AUTO, IN_OFFBOARD = 1, 2
#: The mode that the sticks lead to.
BY_STICKS = "POSCTL"


def hand_over(pilot: Pilot) -> None:
    """Let the sticks have it, where they may. ArduPilot takes no notice of them in GUIDED."""
    if not (pilot.sticks and pilot.armed and pilot.flavour.needs_stream) or pilot.role is Role.MANUAL:
        return
    bit = IN_OFFBOARD if pilot.role is Role.GUIDED else IN_AUTO
    if int(pilot.value("COM_RC_OVERRIDE")) & bit:
        pilot.say("Pilot took over using sticks\t")
        pilot.command(BY_STICKS)
