"""Checks of what a vehicle keeps: mission, fence, rally points. What was there before is there afterwards."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from lfield.driver import DeviceError
from lfield.driver.kit import Bench, CheckFailed, Kit, NotTried
from lfield_mavlink.geo import Place

PLANS = Kit()

#: Metres: how far waypoints are from here, how high above home, and the radius of the fence.
FAR, HEIGHT, FENCE = 20.0, 5.0, 500.0
#: How exactly a plan must come back: degrees, and metres.
DEGREES, METRES = 1e-6, 0.1


@dataclass(frozen=True, slots=True)
class _Plan:
    """A list of points {latitude, longitude, metres}: what they are called, and the instructions for it."""

    points: str
    read: str
    write: str
    clear: str


_MISSION = _Plan("waypoints", "missionWaypoints", "uploadMission", "clearMission")
_RALLY = _Plan("rally points", "rallyPoints", "setRallyPoints", "clearRallyPoints")


@PLANS.check("a mission is uploaded, read back and cleared", moves=True)
async def mission(bench: Bench) -> str:
    """Three waypoints around where it stands."""
    far, height = _within_limits(bench)
    return await _tried(bench, _MISSION, [(*corner, height) for corner in _around(bench, far, 3)])


@PLANS.check("a fence is set, read back and cleared", moves=True)
async def fence(bench: Bench) -> str:
    """A circle, then a polygon with a zone outside in it, around where it stands; it acts as before then."""
    zones = await bench.call("fence")
    if zones:
        raise NotTried(f"it has a fence of its own, which is left as it is: {zones.splitlines()[0]}")
    latitude, longitude, _ = bench.query("globalPosition")
    before = await _switches(bench)
    seen = []
    try:
        await bench.call("setFenceCircle", latitude, longitude, FENCE)
        seen.append(await bench.call("fence"))
        await bench.call(
            "setFencePolygon", [value for corner in _around(bench, FENCE, 4) for value in corner]
        )
        await bench.call("excludeCircle", *_around(bench, FENCE / 2, 1)[0], FENCE / 10)
        seen += (await bench.call("fence")).splitlines()
    finally:
        await bench.call("clearFence")
        for name, value in before.items():
            await bench.call("setParameter", name, value)
    kinds = [line.split()[:2] for line in seen]
    if kinds != [["inside", "circle"], ["inside", "polygon"], ["outside", "circle"]]:
        raise CheckFailed(f"what came back is {'; '.join(seen) or 'nothing'}")
    circle = [float(word) for word in seen[0].split()[2:]]
    _same([latitude, longitude, FENCE], circle, "a circle")
    left = await bench.call("fence")
    if left:
        raise CheckFailed(f"after clearFence() there was {left}")
    return f"{seen[0]}; a polygon with a circle outside; now none, as before"


@PLANS.check("rally points are set, read back and cleared", moves=True)
async def rally(bench: Bench) -> str:
    """Two, near where it stands."""
    far, height = _within_limits(bench)
    return await _tried(bench, _RALLY, [(*corner, height) for corner in _around(bench, far, 2)])


def _within_limits(bench: Bench) -> tuple[float, float]:
    """Metres from here and above home that the binding allows."""
    limits = bench.binding.limits
    return min(FAR, limits.get("radius", math.inf) / 2), min(HEIGHT, limits.get("altitude", math.inf))


async def _tried(bench: Bench, plan: _Plan, points: Sequence[tuple[float, float, float]]) -> str:
    """Write a plan, read it back and clear it; then the vehicle has its own again, whatever has happened."""
    before = await _kept(bench, plan)
    wanted = [value for point in points for value in point]
    try:
        await bench.call(plan.write, wanted)
        _same(wanted, await bench.call(plan.read), plan.points)
        await bench.call(plan.clear)
        left = await bench.call(plan.read)
        if left:
            raise CheckFailed(f"{len(left) // 3} {plan.points} were left after {plan.clear}()")
    finally:
        await _give_back(bench, plan, before)
    return f"{len(points)} {plan.points}; now it holds {len(before) // 3}, as before"


async def _kept(bench: Bench, plan: _Plan) -> list[float]:
    """What the vehicle holds, to be given back to it. Raises NotTried for what could not be.

    That it can be is tried while nothing is lost yet: a limit of the binding may forbid a plan that the
    vehicle has from elsewhere.
    """
    try:
        kept: list[float] = await bench.call(plan.read)
        if kept:
            await bench.call(plan.write, kept)
    except DeviceError as error:
        if error.kind == "DeviceTimeoutException":
            raise
        raise NotTried(f"what it holds would be lost: {error.reason}") from None
    return kept


async def _give_back(bench: Bench, plan: _Plan, before: list[float]) -> None:
    """Have it hold what it held. Raises CheckFailed: that this failed matters more than why it was tried."""
    try:
        if before:
            await bench.call(plan.write, before)
        else:
            await bench.call(plan.clear)
    except DeviceError as error:
        held = f"its {len(before) // 3} {plan.points} were" if before else "its empty plan was"
        raise CheckFailed(f"{held} not given back: {error.reason}") from error


async def _switches(bench: Bench) -> dict[str, float]:
    """The parameters of ArduPilot's fence that the driver changes; PX4 has none."""
    if not bench.identity.startswith("ArduPilot"):
        return {}
    return {name: await bench.call("parameter", name) for name in ("FENCE_TYPE", "FENCE_ENABLE")}


def _around(bench: Bench, far: float, count: int) -> list[tuple[float, float]]:
    """Latitude and longitude of so many places around where it stands, so far away."""
    here = Place(*bench.query("globalPosition"))
    angles = [math.tau * number / count for number in range(count)]
    places = [here.shifted((far * math.cos(angle), far * math.sin(angle), 0.0)) for angle in angles]
    return [(place.latitude, place.longitude) for place in places]


def _same(wanted: list[float], seen: list[float], what: str) -> None:
    """Raise CheckFailed unless {latitude, longitude, metres}* came back as they were sent."""
    near = [DEGREES, DEGREES, METRES] * (len(wanted) // 3)
    fits = len(seen) == len(wanted) and all(
        abs(now - then) <= most for now, then, most in zip(seen, wanted, near, strict=True)
    )
    if not fits:
        raise CheckFailed(f"of {what}, {wanted} came back as {seen}")
