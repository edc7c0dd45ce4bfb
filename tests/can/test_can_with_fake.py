"""Driver, guard and fake as three processes, through both endpoints of the fake's bus.

Tests that need neither a process nor an endpoint are in test_can_on_desk.py, on virtual time.
"""

from __future__ import annotations

import asyncio
import os
import signal
import time
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path

import pytest
from can_endpoints import opened, serial, tcp
from can_scenarios import BOUND, DRIVE, ODRIVE, vanish_and_return

import lfield_sim.can
from lfield.driver import DeviceError
from lfield.testing.driver_bench import guarded, running_fake
from lfield_sim.can.device_specs import spec_of

pytestmark = pytest.mark.process

DOORS = ("socketcand", "slcan")
#: Seconds without a message of a guard after which a drive stops: longer than pauses of a loaded computer.
TTL = 10.0
LISTEN = ("--listen", "socketcand:127.0.0.1:0", *(2 * ("--listen", "slcan-pty")))
GRIPPER = Path(lfield_sim.can.__file__).with_name("gripper.dbc")


@asynccontextmanager
async def team(address: str, *bindings, devices):
    """A fake with devices, and the bound ones behind a guard, at one of its endpoints."""
    arguments = [argument for device in devices for argument in ("--device", device)]
    with running_fake("can", *LISTEN, *arguments) as fake:
        endpoint = fake.ready_line[DOORS.index(address)]
        async with guarded(*(make(endpoint=endpoint) for make in bindings)) as members:
            yield fake, *members


@pytest.fixture
def gripper(binding):
    def make():
        options = {
            "dbc": str(GRIPPER),
            "commands": ["GripperCommand"],
            "safe": [
                "GripperCommand.TargetWidth=0.1",
                "GripperCommand.TargetForce=0",
                "GripperCommand.Enable=1",
            ],
            "confirm": ["GripperStatus.Width=0.1 within 0.01"],
        }
        waivers = ["device_watchdog"]
        return lambda endpoint: binding(
            "CanSignals", field="gripper", endpoint=endpoint, options=options, waivers=waivers, ttl=TTL
        )

    return make


@pytest.mark.few(0)
@pytest.mark.parametrize("address", DOORS)
async def test_three_devices_on_one_bus(address, drive, odrive, gripper):
    devices = (DRIVE, ODRIVE, f"dbc:{GRIPPER}")
    async with team(address, drive(ttl=TTL), odrive(ttl=TTL), gripper(), devices=devices) as (
        _,
        axis,
        wheel,
        hand,
    ):
        for device in (axis, wheel):
            await device.call("enable")
        await asyncio.gather(axis.call("moveTo", 2.0, 5.0), wheel.call("moveTo", -3.0, 5.0))
        await axis.reads("position", lambda at: abs(at - 2.0) < 0.05)
        await wheel.reads("position", lambda at: abs(at + 3.0) < 0.05)
        await hand.call("set", "GripperCommand.TargetWidth", 0.02)
        async with asyncio.timeout(BOUND):
            while abs(await hand.call("read", "GripperStatus.Width") - 0.02) > 0.005:
                await asyncio.sleep(0.05)
        with pytest.raises(DeviceError, match=r"TargetWidth cannot be 0\.2 m: its range is 0 to 0\.1 m"):
            await hand.call("set", "GripperCommand.TargetWidth", 0.2)
        for quantity in ("torque", "current", "voltage"):
            await axis.reads(quantity, lambda value: isinstance(value, float))


LIDAR = """VERSION ""
BU_: Host Lidar
BO_ 256 Sweep: 64 Host
 SG_ Check : 0|16@1+ (1,0) [0|0] "" Lidar
 SG_ Counter : 16|8@1+ (1,0) [0|255] "" Lidar
 SG_ TargetRate : 496|16@1+ (0.01,0) [0|100] "Hz" Lidar
BO_ 257 Scan: 48 Lidar
 SG_ Check : 0|16@1+ (1,0) [0|0] "" Host
 SG_ Counter : 16|8@1+ (1,0) [0|255] "" Host
 SG_ Rate : 368|16@1+ (0.01,0) [0|100] "Hz" Host
BA_DEF_ BO_ "VFrameFormat" ENUM "a","b","c","d","e","f","g","h","i","j","k","l","m","n","StandardCAN_FD";
BA_DEF_ BO_ "CANFD_BRS" ENUM "0","1";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_ "VFrameFormat" BO_ 256 14;
BA_ "VFrameFormat" BO_ 257 14;
BA_ "CANFD_BRS" BO_ 256 1;
BA_ "CANFD_BRS" BO_ 257 1;
BA_ "GenMsgCycleTime" BO_ 256 50;
BA_ "GenMsgCycleTime" BO_ 257 50;
"""


@pytest.mark.few(0)
async def test_can_fd_frames_with_profile_5_pass_a_serial_adapter(binding, tmp_path):
    """64 bytes at the second bit rate through a serial adapter, both ways, each with counter and CRC."""
    path = tmp_path / "lidar.dbc"
    path.write_text(LIDAR)
    protected = ["Sweep", "Scan"]
    options = {
        "dbc": str(path),
        "commands": ["Sweep"],
        "safe": ["Sweep.TargetRate=0"],
        "confirm": ["Scan.Rate=0 within 0.1"],
        "cyclic": ["Sweep"],
        "counters": [f"{name}.Counter" for name in protected],
        "checksums": [f"{name}.Check=e2e_5 0xBEEF" for name in protected],
    }
    waivers = ["device_watchdog"]
    lidar = partial(binding, "CanSignals", field="lidar", options=options, waivers=waivers, ttl=TTL)
    async with team("slcan", lidar, devices=[spec_of(lidar(endpoint="sim:0"))]) as (fake, scanner):
        with opened(serial(fake.ready_line[2])) as other:
            await scanner.call("set", "Sweep.TargetRate", 12.5)
            async with asyncio.timeout(BOUND):
                while abs(await scanner.call("read", "Scan.Rate") - 12.5) > 0.05:
                    await asyncio.sleep(0.05)
            frame = await asyncio.to_thread(other.recv, BOUND)
        assert frame is not None
        assert (frame.is_fd, frame.bitrate_switch, len(frame.data)) in ((True, True, 64), (True, True, 48))
        assert scanner.query("malformed") == 0


@pytest.mark.few(0)
@pytest.mark.parametrize("address", DOORS)
async def test_expired_setpoint_ends_in_the_safe_state(address, drive):
    async with team(address, drive(ttl=3.0), devices=[DRIVE]) as (_, axis):
        await axis.call("enable")
        await axis.call("setVelocity", 5.0)
        await axis.reads("velocity", lambda speed: speed > 3.0)
        await axis.until_note("in safe state 'brake': the setpoint has expired (time-to-live 3 s)")
        await axis.reads("velocity", lambda speed: abs(speed) < 0.1)
        await axis.call("release")
        await axis.call("enable")


async def test_drive_stops_by_itself_when_its_guard_hangs(drive):
    """The heartbeats end; another client of the bus observes the drive."""

    def stands(endpoint: str) -> bool:
        end = time.monotonic() + BOUND
        with opened(tcp(endpoint)) as bus:
            while time.monotonic() < end:
                message = bus.recv(1.0)
                if message is None or message.arbitration_id != 0x285:
                    continue
                if abs(int.from_bytes(message.data[4:], "little", signed=True)) < 40:
                    return True
        return False

    async with team("socketcand", drive(ttl=3.0), devices=[DRIVE]) as (fake, axis):
        await axis.call("enable")
        await axis.call("setVelocity", 5.0)
        await axis.reads("velocity", lambda speed: speed > 4.0)
        os.kill(axis.guard_pid, signal.SIGSTOP)
        assert await asyncio.to_thread(stands, fake.endpoint)


async def test_killed_guard_returns_with_all_devices_safe(drive, odrive):
    async with team("socketcand", drive(ttl=TTL), odrive(ttl=TTL), devices=[DRIVE, ODRIVE]) as (
        _,
        axis,
        wheel,
    ):
        for device in (axis, wheel):
            await device.call("enable")
            await device.call("setVelocity", 3.0)
        os.kill(axis.guard_pid, signal.SIGKILL)
        for device in (axis, wheel):
            await device.until_note(f"{device.binding.name} in safe state 'brake'")
            await device.reads("velocity", lambda speed: abs(speed) < 0.1)


@pytest.mark.few(0)
@pytest.mark.parametrize("address", ["slcan"])
async def test_silent_devices_return_through_a_serial_adapter(address, drive, odrive):
    """The scenario that test_can_on_desk.py runs on virtual time."""
    async with team(address, drive(), odrive(), devices=[DRIVE, ODRIVE]) as members:
        await vanish_and_return(*members)
