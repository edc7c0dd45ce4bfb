"""Checks of what a vehicle keeps: mission, fence, rally points. What was there before is there afterwards."""

from __future__ import annotations

import math

from lfield.driver.kit import Bench, CheckFailed, Kit, NotTried
from lfield.errors import DeviceError
from lfield_mavlink.geo import Place

PLANS = Kit()

#: Metres: how far waypoints are from here, how high above home, and the radius of the fence.
FAR, HEIGHT, FENCE = 20.0, 5.0, 500.0
#: How exactly a plan must come back: degrees, and metres.
DEGREES, METRES = 1e-6, 0.1


@PLANS.check("a mission is uploaded, read back and cleared", moves=True)
async def mission(bench: Bench) -> str:
    """Three waypoints around where it stands."""
    before = await _kept(bench, "missionWaypoints")
    limits = bench.binding.limits
    far, height = min(FAR, limits.get("radius", math.inf) / 2), min(HEIGHT, limits.get("altitude", math.inf))
    wanted = [value for corner in _around(bench, far, 3) for value in (*corner, height)]
    await bench.call("uploadMission", wanted)
    try:
        _same(wanted, await bench.call("missionWaypoints"), "waypoints")
    finally:
        await bench.call("clearMission")
    left = await bench.call("missionWaypoints")
    if before:
        await bench.call("uploadMission", before)
    if left:
        raise CheckFailed(f"{len(left) // 3} waypoints were left after clearMission()")
    return f"3 waypoints; now it holds {len(before) // 3}, as before"


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
    before = await _kept(bench, "rallyPoints")
    wanted = [value for corner in _around(bench, FAR, 2) for value in (*corner, HEIGHT)]
    await bench.call("setRallyPoints", wanted)
    try:
        _same(wanted, await bench.call("rallyPoints"), "rally points")
    finally:
        await bench.call("clearRallyPoints")
    left = await bench.call("rallyPoints")
    if before:
        await bench.call("setRallyPoints", before)
    if left:
        raise CheckFailed(f"{len(left) // 3} rally points were left after clearRallyPoints()")
    return f"2 points; now it holds {len(before) // 3}, as before"


async def _kept(bench: Bench, query: str) -> list[float]:
    """What the vehicle holds, to be given back to it. Raises NotTried for what could not be."""
    try:
        kept: list[float] = await bench.call(query)
    except DeviceError as error:
        if error.kind == "DeviceTimeoutException":
            raise
        raise NotTried(f"what it holds would be lost: {error.reason}") from None
    return kept


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
