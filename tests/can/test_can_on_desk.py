"""Drives and the fake's bus on virtual time: modes of a device, and the effects of faults."""

from __future__ import annotations

import asyncio
from contextlib import closing
from functools import partial

import pytest
from can_scenarios import DRIVE, ODRIVE, vanish_and_return

from lfield.driver import DeviceError
from lfield.testing.desk import Desk


def play(scenario, *bindings, devices=(DRIVE,)):
    """A fake with devices, and the bound ones behind a guard: `scenario(fake, *members)`."""
    with closing(Desk()) as desk:
        fake = desk.fake("can", *(argument for device in devices for argument in ("--device", device)))
        desk.run(partial(scenario, fake), *(make(endpoint=fake.endpoint) for make in bindings))


def test_every_mode_of_a_drive(drive):
    async def scenario(fake, axis):
        await axis.call("enable")
        await axis.call("home")
        await axis.reads("referenced", lambda value: value is True)
        await axis.call("setPosition", 1.0)
        await axis.reads("position", lambda at: abs(at - 1.0) < 0.1)
        await axis.call("setTorque", 0.01)
        await axis.call("stop")
        await axis.call("enable")
        await axis.call("moveTo", 0.0, 5.0)
        await axis.call("disable")

    both = drive(waivers=[], options={"homing_method": 37, "homing_speed": 1.0})
    play(scenario, both)


def test_cyclic_modes_follow_the_setpoints(drive):
    async def scenario(fake, axis):
        await axis.call("enable")
        for _ in range(10):
            await axis.call("setVelocity", 4.0)
            await asyncio.sleep(0.05)
        await axis.reads("velocity", lambda speed: abs(speed - 4.0) < 0.5)
        await axis.call("stop")
        await axis.call("enable")
        at = await axis.call("position")
        for _ in range(20):
            await axis.call("setPosition", at + 1.0)
            await asyncio.sleep(0.05)
        await axis.reads("position", lambda now: abs(now - at - 1.0) < 0.1)

    play(scenario, drive(options={"cyclic": True}))


def test_silent_devices_fail_their_motion_and_return(drive, odrive):
    play(vanish_and_return, drive(), odrive(), devices=(DRIVE, ODRIVE))


def test_device_faults_are_described_and_reset(drive, odrive):
    async def scenario(fake, axis, wheel):
        for device, node, sentence in ((axis, "5", "current"), (wheel, "3", "over-current")):
            await device.call("enable")
            fake.fault(f"overcurrent@{node}=true")
            fault = await device.reads("fault", lambda text: text != "")
            assert sentence in fault
            with pytest.raises(DeviceError, match=r"resetFault\(\) clears it"):
                await device.call("setVelocity", 1.0)
            fake.fault(f"overcurrent@{node}=false")
            await device.call("resetFault")
            await device.call("enable")

    play(scenario, drive(), odrive(), devices=(DRIVE, ODRIVE))


@pytest.mark.few(2)
@pytest.mark.parametrize("fault", ["loss=0.05", "corrupt=0.02", "delay@5=0.05", "nonsense@5=0.1"])
def test_disturbed_bus_gives_delays_or_exceptions_but_no_failure(fault, drive):
    async def scenario(fake, axis):
        fake.fault(fault)
        for _ in range(3):
            try:
                await axis.call("enable")
                await axis.call("moveTo", 1.0, 5.0)
                await axis.call("stop")
            except DeviceError as error:
                axis.notes.append(str(error))
        fake.fault(fault.partition("=")[0] + "=0")
        await axis.reads("online", lambda value: value is True)
        assert not any("the driver failed" in note for note in axis.notes)

    play(scenario, drive())


def test_drive_returns_stopped_after_bus_off(drive):
    async def scenario(fake, axis):
        await axis.call("enable")
        await axis.call("setVelocity", 2.0)
        fake.fault("bus_off=true")
        await axis.until_note("link lost: no message received")
        fake.fault("bus_off=false")
        await axis.until_note("link restored")
        await axis.reads("velocity", lambda speed: abs(speed) < 0.1)

    play(scenario, drive())


def test_bus_off_fails_the_motion_and_the_drive_stops(drive):
    """The motion fails with the cause, the drive stops by itself, and must be enabled before it moves."""

    async def scenario(fake, axis):
        await axis.call("enable")
        travel = asyncio.create_task(axis.call("moveTo", 500.0, 5.0))
        await axis.reads("velocity", lambda speed: speed > 4.0)
        start = axis.now
        fake.fault("bus_off=true")
        with pytest.raises(DeviceError, match=r"no message for 0\.\d s \(bus off\)") as error:
            await travel
        assert error.value.kind == "DeviceTimeoutException"
        assert axis.now - start < 1.0
        assert any("link lost: " in note and note.endswith("bus off") for note in axis.notes)
        with pytest.raises(DeviceError):
            await axis.call("moveTo", 0.0, 5.0)
        await asyncio.sleep(5.0)
        fake.fault("bus_off=false")
        await axis.reads("online", lambda value: value is True)
        await axis.reads("velocity", lambda speed: abs(speed) < 0.1)
        await axis.call("enable")
        at = await axis.call("position")
        await axis.call("moveTo", at + 0.5, 5.0)

    play(scenario, drive())
