"""The services through the driver, against the fake in both flavours."""

from __future__ import annotations

import asyncio

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield.errors import DeviceError
from lfield_mavlink.services.plan_items import Item, PlanKind, waypoints

BOTH = pytest.mark.parametrize("flavour", ["ardupilot", "px4"])


def at(bench, north, east):
    """Latitude and longitude of a position relative to home."""
    latitude, longitude = bench.fakes[1].place.at(north, east)
    return [latitude / 1e7, longitude / 1e7]


def route(bench, *places):
    return [number for north, east, height in places for number in (*at(bench, north, east), height)]


async def until(condition, seconds=60.0):
    async with asyncio.timeout(seconds):
        while not condition():
            await asyncio.sleep(0.1)


@BOTH
@on_bench("bench", given="flavour")
async def test_mission_is_flown_paused_and_finished(b, fc, /, flavour):
    places = [(20.0, 0.0, 8.0), (20.0, 20.0, 8.0), (0.0, 20.0, 8.0)]

    values = route(b, *places)
    await fc.execute("uploadMission", [values])
    assert await fc.execute("missionWaypoints", []) == pytest.approx(values, abs=1e-6)
    await until(lambda: b.values.get("missionItem") == 0, 5.0)
    assert b.values["missionReached"] == -1
    await up(fc)
    await fc.execute("startMission", [])
    await until(lambda: b.values["missionReached"] == 0)
    assert b.values["missionItem"] == 1
    await fc.execute("pauseMission", [])
    await asyncio.sleep(3.0)
    place = b.values["position"]
    await asyncio.sleep(3.0)
    assert b.values["position"] == pytest.approx(place, abs=0.2)
    await fc.execute("startMission", [])
    await until(lambda: b.values["missionReached"] == 2)
    assert b.values["position"] == pytest.approx([0.0, 20.0, -8.0], abs=3.0)


@BOTH
@on_bench("bench", given="flavour")
async def test_mission_item_is_selected_and_an_invalid_one_refused(b, fc, /, flavour):
    await fc.execute("uploadMission", [route(b, (9.0, 0.0, 5.0), (9.0, 9.0, 5.0), (0.0, 9.0, 5.0))])
    await fc.execute("setMissionItem", [2])
    await until(lambda: b.values.get("missionItem") == 2, 5.0)
    with pytest.raises(DeviceError, match="waypoint 3 did not become the current one"):
        await fc.execute("setMissionItem", [3])
    with pytest.raises(DeviceError, match="no waypoint -1"):
        await fc.execute("setMissionItem", [-1])


@BOTH
def test_invalid_mission_start_and_upload_are_refused(bench, flavour):
    b = bench(flavour=flavour, limits={"altitude": 20.0, "radius": 50.0, "speed": 5.0})

    async def refused(work, words):
        with pytest.raises(DeviceError, match=words):
            await work

    async def mission(fc):
        upload = lambda values: fc.execute("uploadMission", [values])  # noqa: E731  # short on purpose
        await refused(fc.execute("startMission", []), "not armed")
        await fc.execute("arm", [])
        await refused(fc.execute("startMission", []), "has no mission")
        b.sent.clear()
        await refused(
            upload(route(b, (9.0, 0.0, 5.0), (9.0, 0.0, 21.0))), "waypoint 1 refused: 21 m is above"
        )
        await refused(upload(route(b, (60.0, 0.0, 5.0))), "waypoint 0 refused: .* beyond the limit of 50 m")
        await refused(upload([1.0]), "which 1 numbers are not")
        await refused(upload([float("nan"), 0.0, 5.0]), "is not a position in degrees")
        # No upload was sent (message 44 is MISSION_COUNT).
        assert not any(packet[7:10] == b"\x2c\0\0" for packet in b.sent)
        await upload(route(b, (30.0, 0.0, 5.0)))
        await refused(fc.execute("startMission", []), "is on the ground")
        await fc.execute("takeoff", [5.0])
        await refused(fc.execute("pauseMission", []), "no mission is running")
        await fc.execute("startMission", [])
        await refused(upload(route(b, (9.0, 0.0, 5.0))), "a mission is running")
        await refused(fc.execute("clearMission", []), "a mission is running")

    b.run(mission)


@BOTH
@on_bench("bench", limits={"radius": 50.0}, given="flavour")
async def test_foreign_mission_is_checked_against_the_limits(b, fc, /, flavour):
    await up(fc)
    # Like another ground station: without the checks of uploadMission.
    await fc.plans.upload(PlanKind.MISSION, waypoints(route(b, (90.0, 0.0, 5.0)), yaw=0.0))
    with pytest.raises(DeviceError, match=r"startMission: waypoint 0 refused: .* beyond the limit of 50 m"):
        await fc.execute("startMission", [])
    before, mode = len(b.sent), "auto.mission" if flavour == "px4" else "auto"
    with pytest.raises(DeviceError, match=rf"setMode refused: {mode.upper()} .* call startMission\(\)"):
        await fc.execute("setMode", [mode])
    assert len(b.sent) == before


@pytest.mark.few(0)
@BOTH
@on_bench("bench", faults=("loss=0.2", "delay=0.05"), given="flavour")
async def test_mission_and_fence_upload_over_a_bad_radio(b, fc, /, flavour):
    places = [(float(number), 0.0, 5.0) for number in range(1, 20)]

    await fc.execute("uploadMission", [route(b, *places)])
    await fc.execute("setFencePolygon", [[*at(b, 60, 60), *at(b, 60, -60), *at(b, -60, 0)]])
    assert len(await fc.execute("missionWaypoints", [])) == 57
    await until(lambda: "linkQuality" in b.values, 5.0)
    await asyncio.sleep(3.0)
    assert 0.6 < b.values["linkQuality"] < 0.95


@BOTH
@on_bench("bench", given="flavour")
async def test_fence_is_set_extended_read_and_cleared(b, fc, /, flavour):
    centre = at(b, 0.0, 0.0)
    await fc.execute("setFenceCircle", [*centre, 60.0])
    await fc.execute("excludePolygon", [[*at(b, 30, 0), *at(b, 30, 9), *at(b, 40, 0)]])
    await fc.execute("excludeCircle", [*at(b, -30, 0), 5.0])
    lines = (await fc.execute("fence", [])).splitlines()
    assert [line.split()[:2] for line in lines] == [
        ["inside", "circle"],
        ["outside", "polygon"],
        ["outside", "circle"],
    ]
    assert [float(n) for n in lines[0].split()[2:]] == pytest.approx([*centre, 60.0], abs=1e-6)
    await fc.execute("fenceAction", ["return"])
    name, value = ("GF_ACTION", 3.0) if flavour == "px4" else ("FENCE_ACTION", 1.0)
    assert await fc.execute("parameter", [name]) == value
    with pytest.raises(DeviceError, match="there is no 'explode' for a copter"):
        await fc.execute("fenceAction", ["explode"])
    await fc.execute("setFencePolygon", [[*at(b, 60, 60), *at(b, 60, -60), *at(b, -60, 0)]])
    assert len((await fc.execute("fence", [])).splitlines()) == 1
    await fc.execute("clearFence", [])
    assert await fc.execute("fence", []) == ""
    if flavour == "ardupilot":
        assert b.autopilot.parameters["FENCE_ENABLE"] == 0.0


@on_bench("bench", options={"tolerance": 1.0})
async def test_fence_breach_is_published(b, fc, /):
    await fc.execute("setFenceCircle", [*at(b, 0.0, 0.0), 30.0])
    await fc.execute("fenceAction", ["report"])
    assert b.autopilot.parameters["FENCE_ENABLE"] == 1.0
    assert int(b.autopilot.parameters["FENCE_TYPE"]) & 4
    await up(fc)
    await until(lambda: b.values.get("fenceBreached") is False, 5.0)
    # A goal beyond it is ignored, so the test moves the vehicle.
    with pytest.raises(DeviceError, match=r"no progress .* its own fence has zones, which may be the reason"):
        await fc.execute("goTo", [45.0, 0.0, -5.0])
    b.autopilot.vehicle.place = (33.0, 0.0, -5.0)
    await until(lambda: b.values["fenceBreached"], 5.0)


@BOTH
@on_bench("bench", given="flavour")
async def test_rally_points_are_set_read_and_cleared(b, fc, /, flavour):
    points = route(b, (20.0, 0.0, 10.0), (0.0, 20.0, 12.0))
    await fc.execute("setRallyPoints", [points])
    assert await fc.execute("rallyPoints", []) == pytest.approx(points, abs=1e-6)
    await fc.execute("clearRallyPoints", [])
    assert await fc.execute("rallyPoints", []) == []


@BOTH
@on_bench("bench", given="flavour")
async def test_parameters_are_set_read_protected_and_listed(b, fc, /, flavour):
    real, integers = (
        ("MPC_XY_VEL_MAX", "COM_RC_IN_MODE") if flavour == "px4" else ("PILOT_TKOFF_ALT", "RTL_LOIT_TIME")
    )

    for name, value in ((real, 4.5), (integers, 3.0)):
        if name in b.autopilot.parameters:
            await fc.execute("setParameter", [name, value])
            assert await fc.execute("parameter", [name]) == value
            assert b.autopilot.parameters[name] == value
    start = asyncio.get_running_loop().time()
    with pytest.raises(DeviceError, match="no answer about a parameter NOPE"):
        await fc.execute("parameter", ["NOPE"])
    assert asyncio.get_running_loop().time() - start <= 3.01
    protected = "NAV_DLL_ACT" if flavour == "px4" else "FS_GCS_ENABLE"
    with pytest.raises(DeviceError, match=f"its binding requires {protected}"):
        await fc.execute("setParameter", [protected, 0.0])
    lines = (await fc.execute("parameters", [])).splitlines()
    assert len(lines) == len(b.autopilot.parameters)
    assert lines == sorted(lines)


@BOTH
@on_bench("bench", given="flavour")
async def test_files_are_written_listed_read_and_removed(b, fc, /, flavour):
    await fc.execute("makeFolder", ["/notes"])
    text = "grüezi\n" * 500
    await fc.execute("writeFile", ["/notes/a.txt", text])
    assert await fc.execute("listFiles", ["/notes"]) == "a.txt"
    assert "notes/" in (await fc.execute("listFiles", ["/"])).splitlines()
    assert await fc.execute("readFile", ["/notes/a.txt"]) == text
    await fc.files.write("/notes/b", b"\xff\xfe")
    with pytest.raises(DeviceError, match="2 bytes that are not text"):
        await fc.execute("readFile", ["/notes/b"])
    with pytest.raises(DeviceError, match="exceed the limit of 262144"):
        await fc.execute("writeFile", ["/notes/c", "x" * 300_000])
    await fc.execute("removeFile", ["/notes/a.txt"])
    with pytest.raises(DeviceError, match="no such file"):
        await fc.execute("readFile", ["/notes/a.txt"])


@on_bench("bench")
async def test_upload_ends_with_a_link_loss_and_works_later(b, fc, /):
    values = route(b, *[(float(number), 0.0, 5.0) for number in range(1, 50)])
    task = asyncio.create_task(fc.execute("uploadMission", [values]))
    await asyncio.sleep(0)
    b.cut, start = True, asyncio.get_running_loop().time()
    with pytest.raises(DeviceError, match="the link is lost") as raised:
        await task
    assert raised.value.kind == "DeviceTimeoutException"
    assert asyncio.get_running_loop().time() - start <= 3.1
    b.cut = False
    await asyncio.sleep(2.0)
    await fc.execute("uploadMission", [values])


@on_bench("bench")
async def test_link_quality_and_clock_offset_are_published(b, fc, /):
    await until(lambda: "clockOffset" in b.values, 5.0)
    await asyncio.sleep(2.0)
    assert b.values["linkQuality"] == 1.0
    assert b.values["packetsLost"] == 0
    assert b.values["roundTrip"] < 0.5
    published = b.values["clockOffset"]
    true = b.autopilot.uptime - asyncio.get_running_loop().time()
    assert published == pytest.approx(true, abs=0.5)
    b.links[0].on_data(b"\xfd\x01\0\0\0\x01\x01\0\0\0\x07garbage!")
    await asyncio.sleep(2.0)
    assert b.values["packetsBroken"] >= 1


def plan_item(bench, number, north=0.0, east=0.0, height=8.0, frame=6, parameters=(0.0, 0.0, 0.0, 0.0)):
    """An item at metres from home, and at a height above it."""
    return Item(number, frame, *bench.fakes[1].place.at(north, east), height, parameters)


#: As flown by both real autopilots: a camera mode and speeds before the takeoff (22).
PRELUDE = [
    Item(530, 2, 0, 0, 0.0, (0.0, 1.0, 0.0, 0.0)),
    Item(178, 2, 0, 0, 0.0, (1.0, 3.0, -1.0, 0.0)),
    Item(178, 2, 0, 0, 0.0, (2.0, 20.0, -1.0, 0.0)),
    Item(178, 2, 0, 0, 0.0, (3.0, 20.0, -1.0, 0.0)),
]


@BOTH
@on_bench("bench", limits={"altitude": 20.0, "radius": 50.0, "speed": 5.0}, given="flavour")
async def test_plan_with_settings_before_its_takeoff_starts_on_the_ground(b, fc, /, flavour):
    plan = [*PRELUDE, plan_item(b, 22), plan_item(b, 16, 15.0)]
    await fc.plans.upload(PlanKind.MISSION, plan)
    await fc.execute("arm", [])
    await fc.execute("startMission", [])
    await until(lambda: b.values["missionReached"] == len(plan) - 1)
    assert b.values["position"] == pytest.approx([15.0, 0.0, -8.0], abs=1.5)


@BOTH
@on_bench("bench", given="flavour")
async def test_plan_that_begins_with_a_waypoint_is_refused_on_the_ground(b, fc, /, flavour):
    await fc.plans.upload(PlanKind.MISSION, [*PRELUDE, plan_item(b, 16, 15.0), plan_item(b, 22)])
    await fc.execute("arm", [])
    with pytest.raises(DeviceError, match="is on the ground"):
        await fc.execute("startMission", [])


#: Items that a real copter accepts, by autopilot.
ACCEPTED = [("ardupilot", n) for n in (30, 31, 36, 82, 84, 85, 94)] + [("px4", n) for n in (31, 84, 85)]


@pytest.mark.few(4)
@pytest.mark.parametrize(("flavour", "number"), ACCEPTED)
@on_bench("bench", limits={"altitude": 20.0, "radius": 50.0}, given="flavour")
async def test_uploaded_items_beyond_the_limits_are_not_started(b, fc, /, flavour, number):
    await up(fc)
    for bad in (plan_item(b, number, 1000.0), plan_item(b, number, 5.0, height=200.0)):
        await fc.plans.upload(PlanKind.MISSION, [plan_item(b, 16, 5.0), bad])
        with pytest.raises(DeviceError, match=r"startMission: .*(1|the arc of item 1)[, ].*refused"):
            await fc.execute("startMission", [])


@pytest.mark.few(3)
@pytest.mark.parametrize(("flavour", "number"), [each for each in ACCEPTED if each[1] != 30])
@on_bench("bench", limits={"altitude": 20.0, "radius": 50.0}, given="flavour")
async def test_items_inside_the_limits_are_flown_to_the_end(b, fc, /, flavour, number):
    values = (5.0 if number == 94 else 0.0, 0.0, 0.0, 0.0)
    plan = [plan_item(b, number, 10.0, parameters=values)]
    if number in (84, 85):
        plan = [plan_item(b, 84), plan_item(b, 16, 10.0), plan_item(b, 85, 10.0)]
        await fc.plans.upload(PlanKind.MISSION, plan)
        await fc.execute("arm", [])
    else:
        await fc.plans.upload(PlanKind.MISSION, plan)
        await up(fc)
    await fc.execute("startMission", [])
    await until(lambda: b.values["missionReached"] == len(plan) - 1, 90.0)
    assert b.values["position"][0] == pytest.approx(10.0, abs=1.5)
    if number in (84, 85):
        await until(lambda: not b.values["armed"])
    elif number != 94:
        assert b.values["position"][2] == pytest.approx(-8.0, abs=1.5)


@BOTH
@on_bench("bench", limits={"radius": 50.0}, given="flavour")
async def test_mission_changed_during_its_start_is_held(b, fc, /, flavour):
    await up(fc)
    await fc.plans.upload(PlanKind.MISSION, [plan_item(b, 16, 20.0)])
    download = fc.plans.download

    async def changed(kind):
        items = await download(kind)
        await fc.plans.upload(PlanKind.MISSION, [plan_item(b, 16, 900.0)])
        return items

    fc.plans.download = changed
    with pytest.raises(DeviceError, match=r"startMission: holding, .* beyond the limit of 50 m"):
        await fc.execute("startMission", [])
    await asyncio.sleep(5.0)
    assert abs(b.values["position"][0]) < 10.0
    assert b.values["mode"] != fc.profile.mission


@pytest.mark.few(0)
@on_bench("bench")
async def test_partly_flown_mission_is_not_resumed_on_the_ground(b, fc, /):
    await fc.plans.upload(PlanKind.MISSION, [plan_item(b, 22), plan_item(b, 16, 9.0), plan_item(b, 21)])
    await fc.execute("arm", [])
    await fc.execute("startMission", [])
    await until(lambda: not b.values["armed"])
    # It is complete, and starts again.
    await fc.execute("arm", [])
    await fc.execute("startMission", [])
    await until(lambda: b.values["missionItem"] == 1)
    await fc.execute("land", [])
    await fc.execute("arm", [])
    with pytest.raises(DeviceError, match=r"is on the ground, and waypoint 1 is not a takeoff"):
        await fc.execute("startMission", [])
    await fc.execute("setMissionItem", [0])
    await fc.execute("startMission", [])


@BOTH
def test_return_is_checked_against_the_limits(bench, flavour):
    """The checks cover the height, the rally points, and the mission along which PX4 may return."""
    b = bench(flavour=flavour, limits={"radius": 50.0, "altitude": 30.0})
    parameters, px4 = b.autopilot.parameters, flavour == "px4"

    async def refused(fc, words):
        for name, values in (("returnHome", []), ("setMode", [fc.profile.home])):
            with pytest.raises(DeviceError, match=rf"{name}.*{words}"):
                await fc.execute(name, values)

    async def mission(fc):
        await up(fc)
        parameters["RTL_RETURN_ALT" if px4 else "RTL_ALT"] = 20.0 if px4 else 2000.0
        await fc.plans.upload(PlanKind.RALLY, [plan_item(b, 5100, 20.0), plan_item(b, 5100, 90.0)])
        await refused(fc, "rally point 1 refused: 90.0 m from home")
        await fc.plans.upload(PlanKind.RALLY, [plan_item(b, 5100, 20.0, height=31.0)])
        await refused(fc, "rally point 0 refused: .* above the limit of 30 m")
        await fc.plans.upload(PlanKind.RALLY, [plan_item(b, 5100, 20.0)])
        if px4:
            parameters["RTL_TYPE"] = 1
            await fc.plans.upload(PlanKind.MISSION, [Item(189, 2, 0, 0), plan_item(b, 21, 90.0)])
            await refused(fc, r"by its mission \(RTL_TYPE 1\): waypoint 1 refused: 90.0 m")
            parameters["RTL_TYPE"] = 0
        else:
            parameters["RTL_CLIMB_MIN"] = 2600.0
            await refused(fc, r"climb to 3[01].* m \(RTL_CLIMB_MIN\)")
            parameters["RTL_CLIMB_MIN"] = 0.0
            with pytest.raises(DeviceError, match="AUTO_RTL would fly the vehicle's mission"):
                await fc.execute("setMode", ["auto_rtl"])
        await fc.execute("returnHome", [])

    b.run(mission)


@BOTH
@on_bench("bench", limits={"radius": 50.0}, given="flavour")
async def test_rally_point_beyond_the_limits_is_refused(b, fc, /, flavour):
    await up(fc)
    with pytest.raises(DeviceError, match=r"setRallyPoints: rally point 1 refused: .* limit of 50 m"):
        await fc.execute("setRallyPoints", [route(b, (10.0, 0.0, 5.0), (90.0, 0.0, 5.0))])
    await fc.plans.upload(PlanKind.RALLY, [plan_item(b, 5100, 90.0)])
    await fc.plans.upload(PlanKind.MISSION, [plan_item(b, 16, 5.0), Item(20, 2, 0, 0)])
    with pytest.raises(DeviceError, match=r"startMission: rally point 0 refused"):
        await fc.execute("startMission", [])
    await fc.execute("setRallyPoints", [route(b, (10.0, 0.0, 5.0))])
    await fc.execute("startMission", [])
