"""Scenarios for devices on a bus, run in real time and on virtual time."""

from __future__ import annotations

import asyncio

import pytest

from lfield.driver import DeviceError

#: Devices of the fake, with 4096 counts as in their bindings.
DRIVE, ODRIVE = "cia402:5,counts=4096", "odrive:3"
#: Upper bound in seconds for a value to return.
BOUND = 60.0


async def vanish_and_return(fake, axis, wheel):
    """A device that falls silent fails its motion, and can be used again after its return."""
    # An ODrive without commands releases its torque and takes time to come to rest.
    for device, node, speed in ((axis, "5", 5.0), (wheel, "3", 0.3)):
        await device.call("enable")
        travel = asyncio.create_task(device.call("moveTo", 500.0, speed))
        await asyncio.sleep(0.3)
        start = device.now
        fake.fault(f"silence@{node}=true")
        with pytest.raises(DeviceError, match="no message for") as error:
            await travel
        assert error.value.kind == "DeviceTimeoutException"
        assert device.now - start < 10.0
        await device.until_note(f"{device.binding.name} link lost")
        fake.fault(f"silence@{node}=false")
        await device.until_note(f"{device.binding.name} link restored")
        await device.reads("online", lambda value: value is True)
        await device.reads("velocity", lambda speed: abs(speed) < 0.1)
        await _enabled_again(device)
        await device.call("moveTo", await device.call("position") + 0.5, 5.0)


async def _enabled_again(device):
    async with asyncio.timeout(BOUND):
        while True:
            try:
                await device.call("enable")
                return
            except DeviceError:
                await asyncio.sleep(0.1)
