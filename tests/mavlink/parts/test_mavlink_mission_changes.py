"""Another station changes a mission in flight: the vehicle holds before it leaves the limits."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench

from lfield_mavlink.link.dialect import Reader, dialect
from lfield_mavlink.services.plan_items import HOME, Item, PlanKind
from lfield_sim.mavlink.link.codec import PacketWriter

RADIUS, CEILING = 50.0, 20.0
VEHICLES = [("ardupilot", "copter"), ("ardupilot", "rover"), ("px4", "copter")]
SPLINE, ARC, RETURN, SPEED, RALLY = 82, 36, 20, 178, 5100


def item(b, north, east=0.0, height=8.0, command=16, parameters=(0.0, 0.0, 0.0, 0.0)):
    return Item(command, 6, *b.fakes[1].place.at(north, east), height, parameters)


def to(b, *messages):
    """Sends messages of another station on a separate link; returns the answers."""
    writer, reader, answers = (
        b.__dict__.setdefault("another", (PacketWriter(77, 190), Reader())),
        Reader(),
        [],
    )
    for message in messages:
        for data in b.fakes[1].receive("another link", writer[0].pack(message)):
            answers += reader.feed(data)
    return answers


def change(b, items, kind=PlanKind.MISSION):
    """Another station uploads a plan on a link that this computer does not receive."""
    first = [HOME] if b.autopilot.flavour.home_item and kind is PlanKind.MISSION else []
    wire, number = [*first, *items], 0
    answers = to(b, dialect.MAVLink_mission_count_message(1, 1, len(wire), int(kind)))
    while answers:
        requests = [m for m in answers if m.get_type() in ("MISSION_REQUEST", "MISSION_REQUEST_INT")]
        if not requests:
            assert [m.type for m in answers if m.get_type() == "MISSION_ACK"] == [0]
            return
        number = requests[0].seq
        answers = to(b, wire[number].message(1, number, kind))
    raise AssertionError(f"no item requested after {number}")


async def begin(b, fc, items):
    """Uploads and starts a mission."""
    await fc.plans.upload(PlanKind.MISSION, items)
    await fc.execute("arm", [])
    if b.autopilot.flies:
        await fc.execute("takeoff", [8.0])
    await fc.execute("startMission", [])


async def farthest(b, seconds):
    """The greatest distance from home and height in this time, in metres."""
    far = high = 0.0
    for _ in range(int(seconds * 10)):
        await asyncio.sleep(0.1)
        north, east, down = b.autopilot.vehicle.place
        far, high = max(far, math.hypot(north, east)), max(high, -down)
    return far, high


def changes(b, name):
    """Plans of another station that lead beyond the limits."""
    near, far = item(b, 10.0, 5.0), item(b, 900.0)
    return {
        "longer": [item(b, 20.0), item(b, 20.0, 20.0), far],
        "as long": [item(b, 20.0), far],
        "at once": [far, near],
        "high": [item(b, 20.0), item(b, 25.0, height=90.0)],
        "spline": [item(b, 20.0), item(b, 45.0, 20.0, command=SPLINE), item(b, 45.0, -45.0 / 2)],
        "arc": [item(b, 40.0, 20.0, command=ARC, parameters=(300.0, 0.0, 0.0, 0.0)), near],
    }[name]


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["longer", "as long", "at once", "high", "spline", "arc"])
@pytest.mark.parametrize(("flavour", "kind"), VEHICLES)
def test_vehicle_holds_before_a_changed_mission_leaves_the_limits(bench, flavour, kind, name):
    if (name in ("spline", "arc") and flavour == "px4") or (kind == "rover" and name in ("high", "spline")):
        pytest.skip("it takes no curves, or has no heights")
    b = bench(flavour=flavour, kind=kind, limits={"radius": RADIUS, "altitude": CEILING, "speed": 5.0})

    async def mission(fc):
        await begin(b, fc, [item(b, 20.0), item(b, 20.0, 20.0)])
        await asyncio.sleep(2.0)
        assert b.autopilot.mode == fc.profile.mission
        change(b, changes(b, name))
        far, high = await farthest(b, 40.0)
        assert far < RADIUS
        assert high < CEILING
        assert b.autopilot.mode != fc.profile.mission
        assert [note for note in b.notes if "mission" in note] != []

    b.run(mission)


@pytest.mark.few(1)
@pytest.mark.parametrize(("flavour", "kind"), VEHICLES)
@on_bench("bench", limits={"radius": RADIUS, "altitude": CEILING, "speed": 5.0}, given="flavour kind")
async def test_changed_mission_inside_the_limits_is_flown(b, fc, /, flavour, kind):
    await begin(b, fc, [item(b, 20.0), item(b, 20.0, 20.0)])
    await asyncio.sleep(2.0)
    change(b, [item(b, 20.0), item(b, -20.0), item(b, -20.0, 20.0)])
    async with asyncio.timeout(120.0):
        while math.dist(b.autopilot.vehicle.place[:2], (-20.0, 20.0)) > 2.0:
            await asyncio.sleep(0.1)


@pytest.mark.few(0)
@pytest.mark.parametrize(("flavour", "kind"), VEHICLES)
@on_bench("bench", limits={"radius": RADIUS, "altitude": 70.0}, given="flavour kind")
async def test_vehicle_holds_before_a_return_to_a_rally_point_beyond_limits(b, fc, /, flavour, kind):
    await begin(b, fc, [item(b, 10.0), item(b, 40.0), Item(RETURN, 2, 0, 0)])
    await asyncio.sleep(2.0)
    change(b, [item(b, 70.0, command=RALLY)], PlanKind.RALLY)
    far, _ = await farthest(b, 60.0)
    assert far < RADIUS
    assert b.autopilot.mode not in (fc.profile.mission, fc.profile.home)


@pytest.mark.few(0)
@on_bench("bench", limits={"radius": RADIUS, "altitude": 70.0})
async def test_foreign_jump_to_a_curve_beyond_the_limits_is_held(b, fc, /):
    """The curve is inside the limits from the mission's start, and outside from the foreign start."""
    plan = [item(b, 48.0, 12.0), item(b, 0.0, 10.0), item(b, 30.0, command=SPLINE), item(b, -5.0, -40.0)]
    await begin(b, fc, plan)
    async with asyncio.timeout(60.0):
        while b.values["missionItem"] < 1:
            await asyncio.sleep(0.1)
    to(b, dialect.MAVLink_mission_set_current_message(1, 1, 3))
    await asyncio.sleep(3.0)
    assert b.autopilot.mode != fc.profile.mission
    far, _ = await farthest(b, 60.0)
    assert far < RADIUS


@pytest.mark.few(1)
@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@pytest.mark.parametrize("kind", ["copter", "rover"])
@on_bench("bench", limits={"radius": RADIUS, "altitude": 70.0}, given="flavour kind")
async def test_return_ends_at_a_rally_point(b, fc, /, flavour, kind):
    change(b, [item(b, 30.0, 10.0, command=RALLY)], PlanKind.RALLY)
    await fc.execute("arm", [])
    if kind == "copter":
        await fc.execute("takeoff", [8.0])
    await fc.execute("goTo", [40.0, 0.0, -8.0 if kind == "copter" else 0.0])
    await fc.execute("returnHome", [])
    assert math.dist(b.autopilot.vehicle.place[:2], (30.0, 10.0)) < 2.0
