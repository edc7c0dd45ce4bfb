"""The driver and a vehicle of MAVSDK's server plugins, over UDP, in real time."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import scenario
from mavsdk_stand_in import ALTITUDE, EAST, LATITUDE, LONGITUDE, NORTH, StandIn

from lfield.clock import SystemClock
from lfield.errors import DeviceError
from lfield.testing.driver_bench import DriverBench, bind
from lfield_mavlink import PLUGIN

pytestmark = pytest.mark.process

#: Longest time of one test, in seconds.
LONGEST = 120.0


def fly(steps, *, opened=True, **stand_in):
    """Run `steps(device, vehicle, bench)` with the driver connected to MAVSDK's vehicle."""

    async def main():
        async with StandIn(**stand_in) as vehicle:
            bench = DriverBench(
                PLUGIN,
                bind(
                    PLUGIN,
                    agent="a",
                    field="fc",
                    endpoint=vehicle.endpoint,
                    ttl=10.0,
                    waivers=["autonomous_motion"],
                ),
            )
            await bench.play(
                lambda device: steps(device, vehicle, bench), SystemClock(), opened=opened, within=LONGEST
            )

    asyncio.run(main())


@scenario(fly, opened=False)
async def test_open_identifies_the_vehicle_and_reads_telemetry_and_failsafes(device, vehicle, bench, /):
    assert await device.open() == "PX4 copter, system 1"
    expected = {
        "position": [NORTH, EAST, 0.0], "velocity": [0.48, 0.36, 0.0], "altitude": 0.0,
        "globalPosition": [LATITUDE, LONGITUDE, ALTITUDE], "attitude": [0.0, 0.0, math.pi / 2],
        "yawRate": 0.1, "groundSpeed": 0.6, "gpsFix": 3, "satellites": 14, "battery": 0.75,
        "batteryVoltage": 12.5, "landed": True, "armed": False, "mode": "AUTO.LOITER",
    }  # fmt: skip
    for name, value in expected.items():
        assert bench.values[name] == pytest.approx(value, abs=1e-5), name
    assert bench.values["gcsFailsafe"] is True
    await device.write_setting("COM_DL_LOSS_T", 5.0)
    assert await vehicle.parameters.retrieve_param_int("COM_DL_LOSS_T") == 5


@scenario(fly)
async def test_modes_safe_state_and_refused_mode_of_an_mavsdk_vehicle(device, vehicle, bench, /):
    await device.execute("arm", [])
    assert device.state.armed
    # MAVSDK's servers follow no setpoints: the test sets the height.
    vehicle.height = 2.5
    # Height and landed state are in different messages.
    while bench.values["altitude"] < 2.0 or bench.values["landed"]:
        await asyncio.sleep(0.05)
    # A flying vehicle in a mode that this program did not select is under another controller.
    with pytest.raises(DeviceError, match="which this program did not select"):
        await device.execute("setMode", ["AUTO.RTL"])
    await device.execute("release", [])
    await device.execute("setMode", ["AUTO.RTL"])
    assert device.state.mode == "AUTO.RTL"
    with pytest.raises(DeviceError, match=r"mode AUTO\.LOITER refused: TEMPORARILY_REJECTED \(1\)"):
        await device.execute("setMode", ["AUTO.LOITER"])
    await device.make_safe()
    assert device.state.mode == "AUTO.LAND"
    assert vehicle.height == 0.0
    await device.execute("disarm", [])
    assert not device.state.armed


@pytest.mark.few(0)
def test_mission_is_uploaded_and_read_back():
    waypoints = [LATITUDE, LONGITUDE, 10.0, LATITUDE + 5e-5, LONGITUDE, 12.0]

    async def steps(device, vehicle, _):
        await device.execute("uploadMission", [waypoints])
        got = (await vehicle.missions.get()).mission_items[-2:]
        assert [(i.command, i.x, i.z) for i in got] == [(16, 473977420, 10.0), (16, 473977920, 12.0)]
        assert await device.execute("missionWaypoints", []) == pytest.approx(waypoints)

    fly(steps)


@pytest.mark.few(0)
@scenario(fly)
async def test_parameters_are_listed_read_and_set(device, vehicle, bench, /):
    await vehicle.parameters.provide_param_int("BIG_INT", 123456789)
    everything = (await device.execute("parameters", [])).splitlines()
    assert {"BIG_INT 123456789", "MIS_TAKEOFF_ALT 2.5"} <= set(everything)
    await device.execute("setParameter", ["MIS_TAKEOFF_ALT", 4.25])
    assert await vehicle.parameters.retrieve_param_float("MIS_TAKEOFF_ALT") == 4.25
    await device.execute("setParameter", ["BIG_INT", -7.0])
    assert await vehicle.parameters.retrieve_param_int("BIG_INT") == -7
    assert await device.execute("parameter", ["BIG_INT"]) == -7.0


@pytest.mark.few(0)
def test_files_are_listed_read_and_written(tmp_path):
    content = "a line of a log\n" * 400
    (tmp_path / "log.txt").write_text(content)

    async def steps(device, vehicle, _):
        assert await device.execute("listFiles", ["/"]) == "log.txt"
        assert await device.execute("readFile", ["/log.txt"]) == content
        await device.execute("writeFile", ["/new.txt", "hello" * 100])
        assert (tmp_path / "new.txt").read_text() == "hello" * 100
        await device.execute("removeFile", ["/log.txt"])
        assert not (tmp_path / "log.txt").exists()

    fly(steps, files=str(tmp_path))


@scenario(fly, opened=False, label=False)
async def test_generic_autopilot_is_refused(device, vehicle, bench, /):
    with pytest.raises(DeviceError, match=r"neither ArduPilot nor PX4 \(MAV_AUTOPILOT 0\)"):
        await device.open()
