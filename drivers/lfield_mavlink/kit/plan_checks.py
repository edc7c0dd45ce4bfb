"""Checks of stored plans: mission, fence, rally points. Previous plans are restored."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

from msgspec import Struct

from lfield.driver import DeviceError
from lfield.driver.kit import Bench, CheckFailed, Kit, NotTried
from lfield_mavlink.geodesy import Place

PLANS = Kit()

#: Metres: distance of waypoints, their height above home, and radius of the fence.
WAYPOINT_DISTANCE, HEIGHT, FENCE = 20.0, 5.0, 500.0
#: Precision of a plan that is read back: degrees, and metres.
DEGREES, METRES = 1e-6, 0.1


class StoredPlan(Struct, frozen=True):
    """A list of points {latitude, longitude, metres}: its name, and its instructions."""

    points: str
    read: str
    write: str
    clear: str


MISSION = StoredPlan("waypoints", "missionWaypoints", "uploadMission", "clearMission")
_RALLY = StoredPlan("rally points", "rallyPoints", "setRallyPoints", "clearRallyPoints")


@PLANS.check("a mission is uploaded, read back and cleared", moves=True)
async def mission(bench: Bench) -> str:
    """Three waypoints around its position."""
    distance, height = _within_limits(bench)
    return await _write_and_clear(
        bench, MISSION, [(*corner, height) for corner in _around(bench, distance, 3)]
    )


@PLANS.check("a fence is set, read back and cleared", moves=True)
async def fence(bench: Bench) -> str:
    """A circle, then a polygon with an exclusion zone, around its position; afterwards its previous fence
    state.
    """
    zones = await bench.call("fence")
    if zones:
        raise NotTried(f"it has a fence, which is not changed: {zones.splitlines()[0]}")
    latitude, longitude, _ = bench.query("globalPosition")
    parameters = await _switches(bench)
    lines = []
    try:
        await bench.call("setFenceCircle", latitude, longitude, FENCE)
        lines.append(await bench.call("fence"))
        await bench.call(
            "setFencePolygon", [value for corner in _around(bench, FENCE, 4) for value in corner]
        )
        await bench.call("excludeCircle", *_around(bench, FENCE / 2, 1)[0], FENCE / 10)
        lines += (await bench.call("fence")).splitlines()
    finally:
        await bench.call("clearFence")
        for name, value in parameters.items():
            await bench.call("setParameter", name, value)
    kinds = [line.split()[:2] for line in lines]
    if kinds != [["inside", "circle"], ["inside", "polygon"], ["outside", "circle"]]:
        raise CheckFailed(f"read back: {'; '.join(lines) or 'nothing'}")
    circle = [float(text) for text in lines[0].split()[2:]]
    _require_equal([latitude, longitude, FENCE], circle, "a circle")
    remaining = await bench.call("fence")
    if remaining:
        raise CheckFailed(f"after clearFence() there was {remaining}")
    return f"{lines[0]}; a polygon with a circle outside; now none, as before"


@PLANS.check("rally points are set, read back and cleared", moves=True)
async def rally(bench: Bench) -> str:
    """Two points near its position."""
    distance, height = _within_limits(bench)
    return await _write_and_clear(
        bench, _RALLY, [(*corner, height) for corner in _around(bench, distance, 2)]
    )


def _within_limits(bench: Bench) -> tuple[float, float]:
    """Horizontal distance and height above home that the binding allows, in metres."""
    limits = bench.binding.limits
    return min(WAYPOINT_DISTANCE, limits.get("radius", math.inf) / 2), min(
        HEIGHT, limits.get("altitude", math.inf)
    )


async def _write_and_clear(
    bench: Bench, plan: StoredPlan, points: Sequence[tuple[float, float, float]]
) -> str:
    """Writes a plan, reads it back and clears it."""
    values = [value for point in points for value in point]
    async with restored(bench, plan) as previous:
        await bench.call(plan.write, values)
        _require_equal(values, await bench.call(plan.read), plan.points)
        await bench.call(plan.clear)
        remaining = await bench.call(plan.read)
        if remaining:
            raise CheckFailed(f"{len(remaining) // 3} {plan.points} remained after {plan.clear}()")
    return f"{len(points)} {plan.points}; now it holds {len(previous) // 3}, as before"


@asynccontextmanager
async def restored(bench: Bench, plan: StoredPlan) -> AsyncIterator[list[float]]:
    """The stored plan, which is restored at the end in every case. Raises NotTried."""
    previous = await _stored_plan(bench, plan)
    try:
        yield previous
    finally:
        await _restore(bench, plan, previous)


async def _stored_plan(bench: Bench, plan: StoredPlan) -> list[float]:
    """Reads the stored plan. Raises NotTried if it could not be restored.

    That is verified before the plan is changed: a limit of the binding may forbid the vehicle's plan.
    """
    try:
        values: list[float] = await bench.call(plan.read)
        if values:
            await bench.call(plan.write, values)
    except DeviceError as error:
        if error.kind == "DeviceTimeoutException":
            raise
        raise NotTried(f"the stored plan could not be restored: {error.reason}") from None
    return values


async def _restore(bench: Bench, plan: StoredPlan, previous: list[float]) -> None:
    """Restores a plan. Raises CheckFailed, which takes precedence over an earlier failure."""
    try:
        if previous:
            await bench.call(plan.write, previous)
        else:
            await bench.call(plan.clear)
    except DeviceError as error:
        subject = f"its {len(previous) // 3} {plan.points} were" if previous else "its empty plan was"
        raise CheckFailed(f"{subject} not restored: {error.reason}") from error


async def _switches(bench: Bench) -> dict[str, float]:
    """The parameters of ArduPilot's fence that the driver changes; PX4 has none."""
    if not bench.identity.startswith("ArduPilot"):
        return {}
    return {name: await bench.call("parameter", name) for name in ("FENCE_TYPE", "FENCE_ENABLE")}


def _around(bench: Bench, distance: float, count: int) -> list[tuple[float, float]]:
    """Latitude and longitude of `count` positions on a circle around the vehicle."""
    position = Place(*bench.query("globalPosition"))
    angles = [math.tau * number / count for number in range(count)]
    places = [
        position.shifted((distance * math.cos(angle), distance * math.sin(angle), 0.0)) for angle in angles
    ]
    return [(place.latitude, place.longitude) for place in places]


def _require_equal(expected: list[float], received: list[float], subject: str) -> None:
    """Raises CheckFailed unless {latitude, longitude, metres}* were read back as sent."""
    tolerances = [DEGREES, DEGREES, METRES] * (len(expected) // 3)
    is_equal = len(received) == len(expected) and all(
        abs(actual - sent) <= tolerance
        for actual, sent, tolerance in zip(received, expected, tolerances, strict=True)
    )
    if not is_equal:
        raise CheckFailed(f"{subject}: expected {expected}, read back {received}")
