"""One vehicle: what it can do, part by part.

Every part is a mixin of Contact, in a file of its own. A part that needs something at opening, and again
when the vehicle was lost and came back, overrides `_prepare`.
"""

from __future__ import annotations

from lfield_mavlink.flight import Flight


class MavlinkVehicle(Flight):
    """A vehicle with an autopilot that speaks MAVLink 2."""
