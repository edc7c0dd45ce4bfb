"""Checks the autopilot's own return against the limits: height, rally points, mission.

ArduPilot: https://ardupilot.org/copter/docs/rtl-mode.html; PX4:
https://docs.px4.io/main/en/flight_modes/return.html.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress

from lfield.driver import DeviceError
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.geodesy import Place, Vector
from lfield_mavlink.limits import Limits
from lfield_mavlink.modes import ARDUPILOT, PX4
from lfield_mavlink.services.mission_check import Climb, Situation
from lfield_mavlink.services.mission_rules import check_mission, check_rally
from lfield_mavlink.services.parameters import Parameters
from lfield_mavlink.services.plan_items import Item, PlanKind
from lfield_mavlink.services.plan_transfer import PlanTransfer

#: Minimum height above its destination and minimum climb: parameter names, with units per metre.
RETURN_HEIGHTS: Mapping[tuple[int, str], Mapping[str, float]] = {
    (ARDUPILOT, "copter"): {"RTL_ALT_M": 1.0, "RTL_ALT": 100.0},
    (ARDUPILOT, "plane"): {"RTL_ALTITUDE": 1.0, "ALT_HOLD_RTL": 100.0},
    (PX4, "copter"): {"RTL_RETURN_ALT": 1.0},
    (PX4, "plane"): {"RTL_RETURN_ALT": 1.0},
}
_CLIMBS: Mapping[tuple[int, str], Mapping[str, float]] = {
    (ARDUPILOT, "copter"): {"RTL_CLIMB_MIN_M": 1.0, "RTL_CLIMB_MIN": 100.0},
}
#: Values of PX4's RTL_TYPE with which a return may follow the mission, or its landing.
_BY_MISSION = frozenset({1, 2, 3, 4})


class Returns:
    """The vehicle's return, from its parameters and plans."""

    def __init__(self, vehicle: Contact, limits: Limits, parameters: Parameters, plans: PlanTransfer) -> None:
        self._vehicle, self._limits = vehicle, limits
        self._parameters, self._plans = parameters, plans

    async def climb(self) -> Climb | None:
        """The height of a return; None if it is not limited or unknown. Raises DeviceError."""
        profile = self._vehicle.profile
        key = profile.autopilot, profile.kind
        if not self._limits.bounds_heights or key not in RETURN_HEIGHTS:
            return None
        height, name = await self.metres(RETURN_HEIGHTS[key])
        minimum, minimum_name = await self.metres(_CLIMBS.get(key, {}))
        return None if height is None else Climb(height, name, minimum or 0.0, minimum_name)

    async def rally(self) -> list[Item]:
        """The rally points, if positions are limited. Raises DeviceError."""
        return await self._plans.download(PlanKind.RALLY) if self._limits.bound_places else []

    async def ends(self) -> list[Vector]:
        """Possible destinations in metres of home: home, or a nearer rally point."""
        home, points = self._vehicle.state.home, list[Item]()
        with suppress(DeviceError):
            points = await self._plans.download(PlanKind.RALLY)
        places = [Place(point.x / 1e7, point.y / 1e7, home.altitude) for point in points if home is not None]
        return [(0.0, 0.0, 0.0), *(home.vector_to(place) for place in places if home is not None)]

    async def check(self, action: str) -> None:
        """Refuses a return that may leave the limits. Raises DeviceError.

        The safe state and failsafes are not affected.
        """
        vehicle, limits, state = self._vehicle, self._limits, self._vehicle.state
        if not limits.bound_places:
            return
        profile, climb = vehicle.profile, await self.climb()
        if climb is not None:
            limits.check_return(action, climb.height, climb.name)
            if climb.minimum:
                limits.check_return(action, max(state.height or 0.0, 0.0) + climb.minimum, climb.minimum_name)
        home = state.home if state.knows_frames else None
        situation = Situation(profile.kind, profile.px4, home, state.position, climb=climb)
        check_rally(action, await self.rally(), limits, vehicle.error, situation)
        kind = await self._parameters.read("RTL_TYPE") if profile.px4 else None
        if kind is not None and int(kind) in _BY_MISSION:
            items = await self._plans.download(PlanKind.MISSION)
            check_mission(
                f"{action} by its mission (RTL_TYPE {kind:g})", items, limits, vehicle.error, situation
            )

    async def metres(self, units: Mapping[str, float]) -> tuple[float | None, str]:
        """The first of these parameters that the vehicle has, in metres, and its name. Raises DeviceError."""
        if not units:
            return None, ""
        name, value = await self._parameters.read_any(units)
        return (None if value is None else abs(value) / units[name]), name
