"""Facts of a vehicle beyond telemetry: chassis, speed limit, extent of its own fence.

Parameters are read after the first contact and every READ_INTERVAL seconds, since a program or a ground
station may change them.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from contextlib import suppress

from lfield.driver import DeviceBinding, DeviceError
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.modes import ARDUPILOT, PX4
from lfield_mavlink.parts.fences import OwnFence
from lfield_mavlink.services.parameters import Parameters

#: Seconds between two readings, and from opening to the first, after the start of a mission.
READ_INTERVAL, FIRST_READ_DELAY = 30.0, 1.0
#: Metres that stand for no fence.
UNBOUNDED = 1.0e6

#: The maximum speed to a goal: by autopilot and kind, parameter names by version, with units per m/s.
SPEEDS: Mapping[tuple[int, str], Mapping[str, float]] = {
    (ARDUPILOT, "copter"): {"WP_SPD": 1.0, "WPNAV_SPEED": 100.0},
    (ARDUPILOT, "rover"): {"WP_SPEED": 1.0},
    (PX4, "copter"): {"MPC_XY_VEL_MAX": 1.0},
    (PX4, "rover"): {"RO_SPEED_LIM": 1.0},
}

#: The registry's chassis name by MAV_TYPE, else by the kind in the binding.
_BY_TYPE = {11: "hull"}
_BY_KIND = {"copter": "multirotor", "rover": "wheels", "plane": "fixed_wing", "submarine": "hull"}


class VehicleFacts:
    """Publishes `chassis`, `speedLimit`, `fenceRadius` and `fenceHeight` of one vehicle."""

    def __init__(
        self, vehicle: Contact, parameters: Parameters, fence: OwnFence, binding: DeviceBinding
    ) -> None:
        self._vehicle, self._parameters, self._fence = vehicle, parameters, fence
        self._limit = binding.limits.get("speed", math.inf)

    async def run(self) -> None:
        """Reads periodically; a missing answer is read the next time."""
        await asyncio.sleep(FIRST_READ_DELAY)
        while True:
            if not (self._vehicle.lost or self._vehicle.is_quiet):
                with suppress(DeviceError):
                    await self._read()
            await asyncio.sleep(READ_INTERVAL)

    async def _read(self) -> None:
        state, profile = self._vehicle.state, self._vehicle.profile
        self._vehicle.publish(chassis=_BY_TYPE.get(state.type) or _BY_KIND[profile.kind])
        height, radius = await self._fence.edges()
        self._vehicle.publish(fenceRadius=radius or UNBOUNDED, fenceHeight=height or UNBOUNDED)
        units = SPEEDS.get((profile.autopilot, profile.kind), {})
        name, value = await self._parameters.read_any(units)
        if value:
            self._vehicle.publish(speedLimit=min(value / units[name], self._limit))
