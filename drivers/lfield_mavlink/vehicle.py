"""One vehicle: what it can do, part by part.

Every part is a mixin of Contact, in a file of its own. What a part keeps is made in `_set_up`; what it must
ask or set before the vehicle is used, and again when it was lost and is back, it does in `_prepare`.
"""

from __future__ import annotations

from lfield_mavlink.fences import Fences
from lfield_mavlink.files import Files
from lfield_mavlink.link_health import LinkHealth
from lfield_mavlink.missions import Missions
from lfield_mavlink.payload import Payload
from lfield_mavlink.rally import Rally
from lfield_mavlink.settings import Settings
from lfield_mavlink.upkeep import Upkeep


class MavlinkVehicle(Missions, Payload, Upkeep, Fences, Rally, Settings, Files, LinkHealth):
    """A vehicle with an autopilot that speaks MAVLink 2."""
