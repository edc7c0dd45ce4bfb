"""The autopilot's own geofence (zones, action, switch) and its rally points.

The fence is stored in the vehicle only. Each instruction uploads a whole fence and reads it back. ArduPilot:
https://ardupilot.org/copter/docs/common-geofencing-landing-page.html, PX4:
https://docs.px4.io/main/en/flying/geofence.html.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping
from typing import Any

from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.geodesy import Vector
from lfield_mavlink.limits import Limits
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.modes import ARDUPILOT, PX4
from lfield_mavlink.services.mission_check import Situation
from lfield_mavlink.services.mission_rules import check_rally
from lfield_mavlink.services.parameters import Parameters
from lfield_mavlink.services.plan_items import (
    CIRCLES,
    POLYGONS,
    RALLY_POINT,
    Item,
    PlanKind,
    circle,
    coordinates,
    polygon,
    rally_points,
)
from lfield_mavlink.services.plan_transfer import PlanTransfer

#: Bits of FENCE_TYPE for maximum height and the circle around home, which are parameters.
CEILING, CIRCLE = 1, 2
#: Bit of FENCE_TYPE for uploaded polygons and circles.
ZONES = 4

#: FENCE_ACTION or GF_ACTION by autopilot, kind of vehicle and name.
ACTIONS: Mapping[tuple[int, str], Mapping[str, int]] = {
    (ARDUPILOT, "copter"): {"report": 0, "return": 1, "land": 2, "hold": 4},
    (ARDUPILOT, "rover"): {"report": 0, "return": 1, "hold": 2},
    (ARDUPILOT, "plane"): {"report": 0, "return": 1},
    (ARDUPILOT, "submarine"): {"report": 0, "return": 1, "hold": 2},
    (PX4, "copter"): {"report": 1, "hold": 2, "return": 3, "land": 5},
    (PX4, "rover"): {"report": 1, "hold": 2, "return": 3},
    (PX4, "plane"): {"report": 1, "hold": 2, "return": 3, "land": 5},
}


#: The name of a parameter and its value in metres; 0 for none.
Edge = tuple[str, float]
_NO_EDGE: Edge = ("", 0.0)


class Fences:
    """Inclusion zones (the vehicle must be in one of them) and exclusion zones."""

    def __init__(self, vehicle: Contact, plans: PlanTransfer, parameters: Parameters) -> None:
        self._vehicle, self._plans, self._parameters = vehicle, plans, parameters
        vehicle.on(dialect.MAVLINK_MSG_ID_FENCE_STATUS, self._on_fence_status)
        vehicle.on(dialect.MAVLINK_MSG_ID_SYS_STATUS, self._on_fence_health)

    # -- instructions ---------------------------------------------------------------------------------

    async def do_set_fence_circle(self, latitude: float, longitude: float, radius: float) -> None:
        """Replaces the fence by an inclusion circle, and enables it."""
        await self._set_fence(
            "setFenceCircle", lambda: circle(latitude, longitude, radius, inside=True), add=False
        )

    async def do_set_fence_polygon(self, corners: list[float]) -> None:
        """Replaces the fence by an inclusion polygon, {latitude, longitude} per corner, and enables it."""
        await self._set_fence("setFencePolygon", lambda: polygon(corners, inside=True), add=False)

    async def do_exclude_circle(self, latitude: float, longitude: float, radius: float) -> None:
        """Adds an exclusion circle to the fence."""
        await self._set_fence(
            "excludeCircle", lambda: circle(latitude, longitude, radius, inside=False), add=True
        )

    async def do_exclude_polygon(self, corners: list[float]) -> None:
        """Adds an exclusion polygon to the fence."""
        await self._set_fence("excludePolygon", lambda: polygon(corners, inside=False), add=True)

    async def do_fence(self) -> str:
        """The stored zones, one per line: `inside circle LATITUDE LONGITUDE RADIUS`."""
        return describe(await self._plans.download(PlanKind.FENCE))

    async def do_clear_fence(self) -> None:
        """Removes all zones and disables the fence."""
        await self._plans.clear(PlanKind.FENCE)
        if not self._vehicle.profile.px4:
            await self._parameters.write("FENCE_ENABLE", 0)

    async def do_fence_action(self, action: str) -> None:
        """Sets the action at the edge; enables the fence."""
        profile = self._vehicle.profile
        actions = ACTIONS.get((profile.autopilot, profile.kind), {})
        if action not in actions:
            raise self._vehicle.error(
                f"fenceAction: there is no '{action}' for a {profile.kind} with {profile.stack}; "
                f"it has {', '.join(actions)}"
            )
        await self._parameters.write("GF_ACTION" if profile.px4 else "FENCE_ACTION", actions[action])
        await self._switch_on()

    # -- steps ----------------------------------------------------------------------------------------

    async def _set_fence(self, instruction: str, make_zone: Callable[[], list[Item]], *, add: bool) -> None:
        try:
            zone = make_zone()
        except ValueError as error:
            raise self._vehicle.error(f"{instruction}: {error}") from None
        zones = await self._plans.download(PlanKind.FENCE) if add else []
        await self.replace([*zones, *zone])

    async def replace(self, zones: list[Item]) -> None:
        """Replaces the fence, and enables it. Raises DeviceError."""
        await self._plans.upload(PlanKind.FENCE, zones)
        await self._switch_on()

    async def _switch_on(self) -> None:
        """Enables a stored fence. PX4 has no switch apart from its action."""
        if self._vehicle.profile.px4:
            return
        kinds = await self._parameters.read("FENCE_TYPE")
        if kinds is None:
            raise self._parameters.unknown("FENCE_TYPE")
        if not int(kinds) & ZONES:
            await self._parameters.write("FENCE_TYPE", int(kinds) | ZONES)
        await self._parameters.write("FENCE_ENABLE", 1)

    def _on_fence_status(self, message: Any) -> None:
        self._vehicle.publish(fenceBreached=bool(message.breach_status))

    def _on_fence_health(self, message: Any) -> None:
        """ArduPilot sends no FENCE_STATUS while its fence is off; then it is not breached."""
        is_on = message.onboard_control_sensors_enabled & dialect.MAV_SYS_STATUS_GEOFENCE
        if self._vehicle.state.autopilot == ARDUPILOT and not is_on:
            self._vehicle.publish(fenceBreached=False)


class OwnFence:
    """The autopilot's fence as a reason for a motion that does not start."""

    def __init__(self, vehicle: Contact, parameters: Parameters) -> None:
        self._vehicle, self._parameters = vehicle, parameters

    async def excess_reason(self, goal: Vector, text: str = "the goal is") -> str:
        """The parameter fence that excludes a goal, in metres of home; '' for none.

        ArduPilot silently ignores a setpoint there; PX4 reports that it is outside its fence, but not which.
        """
        ceiling, circle = await self._known_edges()
        distance, height = math.hypot(*goal[:2]), -goal[2]
        if 0.0 < circle[1] < distance:
            return f"{text} {distance:.1f} m from home, but its own fence {circle[0]} ends at {circle[1]:g} m"
        if 0.0 < ceiling[1] < height and self._vehicle.profile.flies:
            return f"{text} {height:.1f} m up, but its own fence {ceiling[0]} ends at {ceiling[1]:g} m"
        return ""

    async def edges(self) -> tuple[float, float]:
        """Maximum height and distance from home of the parameter fence; 0 for no limit."""
        ceiling, circle = await self._known_edges()
        return ceiling[1], circle[1]

    async def _known_edges(self) -> tuple[Edge, Edge]:
        if self._vehicle.profile.px4:
            return await self._edges("GF_ACTION", "GF_MAX_VER_DIST", "GF_MAX_HOR_DIST")
        return await self._switched_edges()

    async def zones_hint(self) -> str:
        """A note that uploaded zones may be the reason; '' without zones."""
        if self._vehicle.profile.px4 or not await self._parameters.read("FENCE_ENABLE"):
            return ""
        zones = int(await self._parameters.read("FENCE_TYPE") or 0) & ZONES
        has_zones = zones and await self._parameters.read("FENCE_TOTAL")
        return "; its own fence has zones, which may be the reason: fence() lists them" if has_zones else ""

    async def _switched_edges(self) -> tuple[Edge, Edge]:
        """ArduPilot's edges, of the enabled kinds."""
        ceiling, circle = await self._edges("FENCE_ENABLE", "FENCE_ALT_MAX", "FENCE_RADIUS")
        kinds = int(await self._parameters.read("FENCE_TYPE") or 0)
        return ceiling if kinds & CEILING else _NO_EDGE, circle if kinds & CIRCLE else _NO_EDGE

    async def _edges(self, switch: str, ceiling: str, circle: str) -> tuple[Edge, Edge]:
        """Height and radius of a fence by parameter names; none when it is disabled."""
        if not await self._parameters.read(switch):
            return _NO_EDGE, _NO_EDGE
        height, radius = await asyncio.gather(self._parameters.read(ceiling), self._parameters.read(circle))
        return (ceiling, height or 0.0), (circle, radius or 0.0)


class Rally:
    """Rally points, where a returning vehicle may go instead of home."""

    def __init__(self, vehicle: Contact, plans: PlanTransfer) -> None:
        self._vehicle, self._plans = vehicle, plans
        self._limits = Limits(vehicle.binding, vehicle.error)

    async def do_set_rally_points(self, values: list[float]) -> None:
        """Replaces the rally points: {latitude, longitude, height above home} each."""
        try:
            items = rally_points(values)
        except ValueError as error:
            raise self._vehicle.error(f"setRallyPoints: {error}") from None
        state, profile = self._vehicle.state, self._vehicle.profile
        home = state.home if state.knows_frames else None
        situation = Situation(profile.kind, profile.px4, home, state.position)
        check_rally("setRallyPoints", items, self._limits, self._vehicle.error, situation)
        await self._plans.upload(PlanKind.RALLY, items)

    async def do_rally_points(self) -> list[float]:
        """The stored rally points, in the format of setRallyPoints."""
        try:
            return coordinates(await self._plans.download(PlanKind.RALLY), RALLY_POINT)
        except ValueError as error:
            raise self._vehicle.error(f"rallyPoints: {error}") from None

    async def do_clear_rally_points(self) -> None:
        """Removes all rally points."""
        await self._plans.clear(PlanKind.RALLY)


def describe(items: list[Item]) -> str:
    """Describes a fence, one line per zone."""
    lines: list[str] = []
    number = 0
    while number < len(items):
        item = items[number]
        latitude, longitude = item.x / 1e7, item.y / 1e7
        count = 1
        if item.command in POLYGONS:
            count = max(int(item.parameters[0]), 1)
            corners = (f"{c.x / 1e7:.7f} {c.y / 1e7:.7f}" for c in items[number : number + count])
            lines.append(f"{_side(item.command, POLYGONS)} polygon {' '.join(corners)}")
        elif item.command in CIRCLES:
            side = _side(item.command, CIRCLES)
            lines.append(f"{side} circle {latitude:.7f} {longitude:.7f} {item.parameters[0]:g}")
        else:
            lines.append(f"return point {latitude:.7f} {longitude:.7f}")
        number += count
    return "\n".join(lines)


def _side(command: int, pair: tuple[int, int]) -> str:
    return "inside" if command == pair[0] else "outside"
