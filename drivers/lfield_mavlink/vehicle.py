"""One vehicle: what it can do, part by part.

Every part is a mixin of Contact, in a file of its own. What a part keeps is made in `_set_up`; what it must
ask or set before the vehicle is used, and again when it was lost and is back, it does in `_prepare`.
"""

from __future__ import annotations

from lfield_mavlink.guidance import Guidance
from lfield_mavlink.payload import Payload
from lfield_mavlink.streams import Streams
from lfield_mavlink.upkeep import Upkeep


class MavlinkVehicle(Guidance, Payload, Upkeep, Streams):
    """A vehicle with an autopilot that speaks MAVLink 2."""
