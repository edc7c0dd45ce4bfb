"""`flyPlan` against both fakes: upload, flight to the end, refusal, cancellation."""

from __future__ import annotations

import asyncio
import json

import pytest
from coroutine_tests import on_bench

from lfield.errors import DeviceError
from lfield_mavlink.services.plan_items import PlanKind

TAKEOFF, WAYPOINT, LAND, RETURN = 22, 16, 21, 20
FIRMWARE = {"ardupilot": 3, "px4": 12}
BOTH = pytest.mark.parametrize("flavour", ["ardupilot", "px4"])


def at(b, north, east):
    return [value / 1e7 for value in b.fakes[1].place.at(north, east)]


def item(b, command, north=0.0, east=0.0, height=8.0, frame=3):
    return {
        "type": "SimpleItem",
        "command": command,
        "frame": frame,
        "params": [0, 0, 0, None, *at(b, north, east), height],
    }


def plan(b, flavour, *items, fence=(), rally=(), vehicle=2):
    polygon = [{"inclusion": True, "polygon": [at(b, *corner) for corner in fence]}] if fence else []
    tree = {
        "fileType": "Plan",
        "version": 1,
        "mission": {
            "version": 2,
            "firmwareType": FIRMWARE[flavour],
            "vehicleType": vehicle,
            "plannedHomePosition": [*at(b, 0.0, 0.0), 488.0],
            "items": list(items),
        },
        "geoFence": {"version": 2, "polygons": polygon, "circles": []},
        "rallyPoints": {"version": 2, "points": [[*at(b, *point[:2]), point[2]] for point in rally]},
    }
    return f"field.plan\n{json.dumps(tree)}"


async def stored(fc, kind):
    return [item.command for item in await fc.plans.download(kind)]


@pytest.mark.few(0)
@BOTH
@on_bench("bench", given="flavour")
async def test_plan_that_ends_in_the_air_is_flown_twice(b, fc, /, flavour):
    places = [(20.0, 0.0), (20.0, 20.0)]
    text = plan(
        b, flavour, item(b, TAKEOFF), *(item(b, WAYPOINT, *place) for place in places),
        fence=[(-50, -50), (-50, 50), (50, 50), (50, -50)], rally=[(0.0, -10.0, 8.0)],
    )  # fmt: skip
    await fc.execute("arm", [])
    await fc.execute("flyPlan", [text])
    assert b.values["position"] == pytest.approx([20.0, 20.0, -8.0], abs=3.0)
    assert b.values["missionReached"] == 2
    assert await stored(fc, PlanKind.MISSION) == [TAKEOFF, WAYPOINT, WAYPOINT]
    assert await stored(fc, PlanKind.FENCE) == [5001] * 4
    assert await stored(fc, PlanKind.RALLY) == [5100]
    # The program is in control: the next instruction works.
    await fc.execute("hold", [])
    # Again, from its first item.
    await fc.execute("flyPlan", [text])
    assert b.values["missionReached"] == 2


@pytest.mark.few(0)
@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@pytest.mark.parametrize("last", [LAND, RETURN])
@on_bench("bench", given="flavour")
async def test_plan_that_ends_on_the_ground_disarms(b, fc, /, flavour, last):
    end = item(b, LAND, 15.0, 0.0, 0.0) if last == LAND else item(b, RETURN, frame=2)
    await fc.execute("arm", [])
    await fc.execute("flyPlan", [plan(b, flavour, item(b, TAKEOFF), item(b, WAYPOINT, 15.0), end)])
    assert not b.autopilot.armed
    north, _, down = b.autopilot.vehicle.place
    assert down == pytest.approx(0.0, abs=0.3)
    assert north == pytest.approx(15.0 if last == LAND else 0.0, abs=2.0)


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@on_bench("bench", kind="rover", given="flavour")
async def test_rover_drives_a_plan(b, fc, /, flavour):
    places = [(15.0, 0.0), (15.0, 15.0)]
    text = plan(b, flavour, *(item(b, WAYPOINT, *place, 0.0) for place in places), vehicle=10)
    await fc.execute("arm", [])
    await fc.execute("flyPlan", [text])
    assert b.values["position"][:2] == pytest.approx([15.0, 15.0], abs=3.0)


@pytest.mark.few(1)
@BOTH
@on_bench("bench", given="flavour")
async def test_cancelled_plan_holds(b, fc, /, flavour):
    text = plan(b, flavour, item(b, TAKEOFF), item(b, WAYPOINT, 400.0))
    await fc.execute("arm", [])
    flight = asyncio.ensure_future(fc.execute("flyPlan", [text]))
    await asyncio.sleep(20.0)
    assert not flight.done()
    flight.cancel()
    await fc.execute("hold", [])
    await asyncio.sleep(20.0)
    place = b.values["position"]
    await asyncio.sleep(5.0)
    assert b.values["position"] == pytest.approx(place, abs=0.3)
    assert place[0] < 390.0


@BOTH
@on_bench("bench", given="flavour")
async def test_plan_ends_with_an_exception_under_foreign_control(b, fc, /, flavour):
    await fc.execute("arm", [])
    flight = asyncio.ensure_future(
        fc.execute("flyPlan", [plan(b, flavour, item(b, TAKEOFF), item(b, WAYPOINT, 400.0))])
    )
    await asyncio.sleep(20.0)
    b.autopilot.go_home()
    with pytest.raises(DeviceError, match="ended early"):
        await flight


@BOTH
@on_bench("bench", limits={"radius": 100.0, "altitude": 30.0}, given="flavour")
async def test_invalid_plan_is_refused_before_upload(b, fc, /, flavour):
    up, other = item(b, TAKEOFF), {"ardupilot": "px4", "px4": "ardupilot"}[flavour]
    good = plan(b, flavour, up, item(b, WAYPOINT, 20.0))
    with pytest.raises(DeviceError, match="not armed"):
        await fc.execute("flyPlan", [good])
    await fc.execute("arm", [])
    fence = [(-9, -9), (9, -9), (9, 9), (-9, 9)]
    refused = {
        "item 2": plan(b, flavour, up, {"type": "SimpleItem"}),
        "waypoint 2": plan(b, flavour, up, item(b, WAYPOINT, 200.0)),
        "waypoint 1": plan(b, flavour, item(b, TAKEOFF, height=50.0)),
        "does not begin": plan(b, flavour, item(b, WAYPOINT, 20.0)),
        "made for a rover": plan(b, flavour, up, vehicle=10),
        f"made for {other}": plan(b, other, up),
        "item 2 is outside": plan(b, flavour, up, item(b, WAYPOINT, 60.0), fence=fence),
        "neither": "hello",
    }
    for reason, text in refused.items():
        with pytest.raises(DeviceError, match=reason):
            await fc.execute("flyPlan", [text])
    assert await stored(fc, PlanKind.MISSION) == []
