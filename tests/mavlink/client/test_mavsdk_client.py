"""The MAVSDK client flies the simulated vehicle, a process, over UDP and TCP, in real time.

Every wait ends with a report of MAVSDK, or fails after LONGEST.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from contextlib import asynccontextmanager

import pytest
from coroutine_tests import scenario
from mavsdk.asyncio import Autopilot, ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.ftp import FtpAsync
from mavsdk.asyncio.plugins.geofence import GeofenceAsync
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync
from mavsdk.asyncio.plugins.mission import MissionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.action import ActionError, ActionResult
from mavsdk.plugins.ftp import FtpError, FtpResult
from mavsdk.plugins.geofence import Circle, FenceType, GeofenceData, Point, Polygon
from mavsdk.plugins.mavlink_direct import MavlinkMessage
from mavsdk.plugins.mission import MissionItem, MissionPlan
from mavsdk.plugins.mission_raw import MissionItem as RawItem
from mavsdk.plugins.offboard import VelocityNedYaw
from mavsdk.plugins.param import ParamError, ParamResult
from mavsdk.plugins.telemetry import FlightMode, LandedState

pytestmark = [pytest.mark.process, pytest.mark.long]

#: Longest time to wait for a state, in seconds.
LONGEST = 120.0
#: A nimble vehicle, so that a flight takes seconds.
QUICK = ["--climb", "10", "--descend", "10", "--land", "8", "--acceleration", "10", "--cruise", "15"]
SOON_DISARMED = {"ardupilot": ["--param", "RTL_LOIT_TIME=0"], "px4": ["--param", "COM_DISARM_LAND=0.2"]}
TRANSPORTS = {"ardupilot": "udp", "px4": "tcp"}
BOTH = pytest.mark.parametrize("flavour", list(TRANSPORTS))
LATITUDE, LONGITUDE, ALTITUDE = 47.3977420, 8.5455940, 488.0


class Client:
    """MAVSDK's plugins for one vehicle."""

    def __init__(self, system):
        self.system = system
        self.action, self.telemetry = ActionAsync(system), TelemetryAsync(system)
        self.parameters, self.files, self.info = ParamAsync(system), FtpAsync(system), InfoAsync(system)
        self.mission, self.raw_mission = MissionAsync(system), MissionRawAsync(system)
        self.offboard, self.fence = OffboardAsync(system), GeofenceAsync(system)
        self.direct = MavlinkDirectAsync(system)

    async def ask_for_streams(self):
        """Request telemetry, as ground stations do: an ArduPilot sends none without a request."""
        expected = {"target_system": 1, "target_component": 1, "req_stream_id": 0, "req_message_rate": 10}
        fields = json.dumps({**expected, "start_stop": 1})
        await self.direct.send_message(MavlinkMessage("REQUEST_DATA_STREAM", 0, 0, 1, 1, fields))
        await self.telemetry.set_rate_home(2.0)

    async def ready(self):
        await until(
            self.telemetry.subscribe_home(), lambda home: abs(home.absolute_altitude_m - ALTITUDE) < 0.1
        )

    async def in_the_air(self, height=6.0):
        await until(self.telemetry.subscribe_health_all_ok(), bool)
        await self.action.set_takeoff_altitude(height)
        await self.action.arm()
        await self.action.takeoff()
        await until(self.telemetry.subscribe_position(), lambda p: p.relative_altitude_m > height - 1.5)

    async def landed(self):
        await until(self.telemetry.subscribe_armed(), lambda armed: not armed)


async def until(values, expected):
    """The first value for which `wanted` is true."""
    async with asyncio.timeout(LONGEST):
        async for value in values:
            if expected(value):
                return value
    raise AssertionError("the values ended")


@asynccontextmanager
async def client(flavour, *options):
    """A fake as a process, and MAVSDK connected to it."""
    transport = TRANSPORTS[flavour]
    command = [sys.executable, "-m", "lfield_sim", "mavlink", "--listen", f"{transport}:127.0.0.1:0"]
    command += ["--flavour", flavour, "--until-stdin-closes", *QUICK, *SOON_DISARMED[flavour], *options]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        loop = asyncio.get_running_loop()
        line = await asyncio.wait_for(loop.run_in_executor(None, process.stdout.readline), LONGEST)
        port = int(line.split()[1].rpartition(":")[2])
        configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
        async with Mavsdk(configuration) as mavsdk:
            await mavsdk.add_any_connection(f"{transport}out://127.0.0.1:{port}")
            found = Client(await mavsdk.first_autopilot(LONGEST))
            if flavour == "ardupilot":
                await found.ask_for_streams()
            await found.ready()
            yield found
    finally:
        process.communicate(timeout=60)
    assert process.returncode == 0


def fly(steps, flavour, *options):
    async def main():
        async with asyncio.timeout(200), client(flavour, *options) as c:
            await steps(c)

    asyncio.run(main())


@pytest.mark.few(0)
@BOTH
def test_takeoff_goto_return_to_launch_and_landing(flavour):
    async def steps(c):
        kinds = {"ardupilot": Autopilot.ARDUPILOT, "px4": Autopilot.PX4}
        assert c.system._system.autopilot_type() == kinds[flavour]
        version = await c.info.get_version()
        assert (version.flight_sw_major, version.flight_sw_minor) == {"ardupilot": (4, 7), "px4": (1, 17)}[
            flavour
        ]
        await c.in_the_air()
        await until(c.telemetry.subscribe_landed_state(), lambda state: state == LandedState.IN_AIR)
        await c.action.goto_location(LATITUDE + 1e-4, LONGITUDE, ALTITUDE + 8.0, 0.0)
        await until(
            c.telemetry.subscribe_position(),
            lambda p: abs(p.latitude_deg - LATITUDE - 1e-4) < 1e-5 and abs(p.relative_altitude_m - 8.0) < 2.0,
        )
        if flavour == "px4":
            # An ArduCopter without a transmitter descends in LOITER, which MAVSDK names HOLD.
            await c.action.hold()
            await until(c.telemetry.subscribe_flight_mode(), lambda mode: mode == FlightMode.HOLD)
        await c.action.return_to_launch()
        await until(c.telemetry.subscribe_flight_mode(), lambda mode: mode == FlightMode.RETURN_TO_LAUNCH)
        await c.landed()
        place = await until(c.telemetry.subscribe_position(), lambda _: True)
        assert abs(place.latitude_deg - LATITUDE) < 2e-5

    fly(steps, flavour, "--param", "RTL_ALT=600" if flavour == "ardupilot" else "RTL_RETURN_ALT=6")


@pytest.mark.few(0)
@BOTH
@scenario(fly, given="flavour")
async def test_offboard_velocities_and_landing(c, /, flavour):
    await c.in_the_air()
    await c.offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
    # PX4 enters OFFBOARD only after 0.1 s of setpoints.
    await asyncio.sleep(0.5)
    await c.offboard.start()
    await until(c.telemetry.subscribe_flight_mode(), lambda mode: mode == FlightMode.OFFBOARD)
    await c.offboard.set_velocity_ned(VelocityNedYaw(0.0, 4.0, 0.0, 90.0))
    flown = {"ardupilot": 3.9, "px4": 3.3}[flavour]
    await until(c.telemetry.subscribe_velocity_ned(), lambda v: v.east_m_s > flown and abs(v.north_m_s) < 0.1)
    await until(c.telemetry.subscribe_attitude_euler(), lambda a: abs(a.yaw_deg - 90.0) < 2.0)
    await c.offboard.stop()
    await until(c.telemetry.subscribe_velocity_ned(), lambda v: abs(v.east_m_s) < 0.1)
    await c.action.land()
    await c.landed()


@BOTH
def test_refused_arming_sends_its_reason_as_status_text(flavour):
    async def steps(c):
        texts = asyncio.create_task(until(c.telemetry.subscribe_status_text(), lambda t: "Compass" in t.text))
        await asyncio.sleep(0)
        with pytest.raises(ActionError) as refused:
            await c.action.arm()
        expected = {"ardupilot": ActionResult.FAILED, "px4": ActionResult.COMMAND_DENIED}[flavour]
        assert refused.value.result == expected
        assert "Compass not calibrated" in (await texts).text

    fly(steps, flavour, "--fault", "refuse_arming=Compass not calibrated")


@pytest.mark.few(0)
@scenario(fly, "px4")
async def test_px4_mission_upload_flight_and_clear(c, /):
    items = [
        MissionItem(LATITUDE + 1e-4, LONGITUDE, 8.0, 10.0, True),
        MissionItem(LATITUDE + 1e-4, LONGITUDE + 1e-4, 9.0, 10.0, True),
    ]
    await c.mission.set_return_to_launch_after_mission(False)
    await c.mission.upload_mission(MissionPlan(items))
    held = (await c.mission.download_mission()).mission_items
    assert [i.relative_altitude_m for i in held] == [8.0, 9.0]
    assert [i.longitude_deg for i in held] == pytest.approx([LONGITUDE, LONGITUDE + 1e-4])
    await c.action.arm()
    await c.mission.start_mission()
    await until(c.telemetry.subscribe_flight_mode(), lambda mode: mode == FlightMode.MISSION)
    await until(c.mission.subscribe_mission_progress(), lambda p: (p.current, p.total) == (2, 2))
    assert await c.mission.is_mission_finished()
    place = await until(c.telemetry.subscribe_position(), lambda _: True)
    assert place.longitude_deg == pytest.approx(LONGITUDE + 1e-4, abs=3e-5)
    await c.mission.clear_mission()
    assert (await c.mission.download_mission()).mission_items == []


@pytest.mark.few(0)
def test_ardupilot_mission_upload_pause_resume_and_clear():
    """Uses raw items: MAVSDK's other mission plugin does not handle item 0, where ArduPilot stores home."""

    def item(number, command, north, height):
        x, y = round((LATITUDE + north * 1e-4) * 1e7), round(LONGITUDE * 1e7)
        return RawItem(number, 6, command, int(number == 0), 1, 0.0, 0.0, 0.0, 0.0, x, y, height, 0)

    async def steps(c):
        plan = [item(0, 16, 0, 0.0), item(1, 22, 0, 5.0), item(2, 16, 1, 8.0), item(3, 16, 2, 8.0)]
        await c.raw_mission.upload_mission(plan)
        held = await c.raw_mission.download_mission()
        assert [(i.command, i.x, i.z) for i in held[1:]] == [(i.command, i.x, i.z) for i in plan[1:]]
        assert (held[0].frame, held[0].z) == (0, ALTITUDE)
        # An ArduPilot cannot be armed in BRAKE, the mode of hold(); takeoff() uses GUIDED.
        await c.in_the_air()
        done = asyncio.create_task(
            until(c.raw_mission.subscribe_mission_progress(), lambda p: (p.current, p.total) == (4, 4))
        )
        await c.raw_mission.start_mission()
        await until(c.telemetry.subscribe_velocity_ned(), lambda v: v.north_m_s > 3.0)
        await c.raw_mission.pause_mission()
        await until(c.telemetry.subscribe_velocity_ned(), lambda v: abs(v.north_m_s) < 0.1)
        await c.raw_mission.start_mission()
        await done
        await c.raw_mission.clear_mission()
        assert len(await c.raw_mission.download_mission()) <= 1

    fly(steps, "ardupilot")


@pytest.mark.few(1)
@BOTH
def test_uploaded_geofence_is_downloaded_and_cleared(flavour):
    corners = [
        Point(LATITUDE + n * 1e-3, LONGITUDE + e * 1e-3) for n, e in ((-1, -1), (-1, 1), (1, 1), (1, -1))
    ]

    async def steps(c):
        circle = Circle(Point(LATITUDE + 5e-4, LONGITUDE), 10.0, FenceType.EXCLUSION)
        await c.fence.upload_geofence(GeofenceData([Polygon(corners, FenceType.INCLUSION)], [circle]))
        held = await c.fence.download_geofence()
        assert [len(p.points) for p in held.polygons] == [4]
        assert [(round(f.radius), f.fence_type) for f in held.circles] == [(10, FenceType.EXCLUSION)]
        await c.fence.clear_geofence()
        held = await c.fence.download_geofence()
        assert (held.polygons, held.circles) == ([], [])

    fly(steps, flavour)


@pytest.mark.few(1)
@BOTH
def test_parameters_are_set_read_and_listed(flavour):
    real, integers = {"ardupilot": ("WPNAV_RADIUS", "FS_GCS_ENABLE"), "px4": ("NAV_ACC_RAD", "NAV_DLL_ACT")}[
        flavour
    ]

    async def steps(c):
        await c.parameters.set_param_float(real, 3.5)
        assert await c.parameters.get_param_float(real) == 3.5
        await c.parameters.set_param_int(integers, 1)
        assert await c.parameters.get_param_int(integers) == 1
        everything = await c.parameters.get_all_params()
        assert {p.name: p.value for p in everything.int_params}[integers] == 1
        assert {p.name: p.value for p in everything.float_params}[real] == 3.5
        assert len(everything.int_params) + len(everything.float_params) > 400

    fly(steps, flavour)


@pytest.mark.few(0)
@scenario(fly, "px4")
async def test_unknown_parameter_times_out(c, /):
    with pytest.raises(ParamError) as failed:
        await c.parameters.get_param_int("NO_SUCH")
    assert failed.value.result == ParamResult.TIMEOUT


@pytest.mark.few(1)
@pytest.mark.parametrize("burst", [True, False])
@BOTH
def test_files_are_downloaded_uploaded_removed_and_listed(flavour, burst, tmp_path):
    folder, name = {
        "ardupilot": ("/APM/LOGS", "00000001.BIN"),
        "px4": ("/fs/microsd/log/2026-11-20", "10_00_00.ulg"),
    }[flavour]

    async def last(progress):
        return [result async for result, _ in progress][-1]

    async def steps(c):
        assert await last(c.files.download(f"{folder}/{name}", str(tmp_path), burst)) == FtpResult.SUCCESS
        content = (tmp_path / name).read_bytes()
        assert len(content) > 10_000
        (tmp_path / "new.txt").write_bytes(content[:3000])
        assert await last(c.files.upload(str(tmp_path / "new.txt"), folder)) == FtpResult.SUCCESS
        assert await c.files.are_files_identical(str(tmp_path / "new.txt"), f"{folder}/new.txt")
        await c.files.remove_file(f"{folder}/new.txt")
        with pytest.raises(FtpError):
            await c.files.remove_file(f"{folder}/new.txt")
        # ArduPilot answers a listing with times by a failure, not by "unknown command": MAVSDK gives up.
        if flavour == "ardupilot":
            with pytest.raises(FtpError) as failed:
                await c.files.list_directory(folder)
            assert failed.value.result == FtpResult.PROTOCOL_ERROR
        else:
            assert [e.name for e in (await c.files.list_directory(folder)).entries] == [name]

    fly(steps, flavour)
