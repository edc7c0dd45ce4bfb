"""The driver and its kit against independently written drives: canopen's LocalNode, another object
dictionary, other readings of CiA 301. In real time and over a socketcand endpoint, as with hardware."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import ExitStack

import pytest
from foreign_drive import foreign
from foreign_objects import UNFIT, UNUSED, VARIANTS

from lfield.clock import SystemClock
from lfield.devices.conformance_run import conformance_checks, run_conformance
from lfield.driver.plugins import discover
from lfield.errors import DevicesError
from lfield.testing.driver_bench import guarded, running_fake

pytestmark = [pytest.mark.process, pytest.mark.long]

#: Seconds without a heartbeat after which guards and drives stop: longer than pauses of a loaded computer.
SILENCE, TTL = 5.0, 5.0
#: Seconds for a drive to execute a command.
BOUND = 60.0
OPTIONS = {"protocol": "cia402", "node": 9, "counts": 10_000, "homing_method": 37}


@pytest.fixture
def bus():
    """Make a bus with one foreign drive on it: its endpoint and the drive."""
    with ExitStack() as running:

        def make(variant):
            fake = running.enter_context(running_fake("can", "--device", "odrive:60"))
            return fake.endpoint, running.enter_context(foreign(fake.endpoint, OPTIONS["node"], variant))

        yield make


@pytest.fixture
def bound(binding):
    def make(endpoint, field="axis", **changes):
        settings = {"limits": {"speed": 5.0}, "ttl": TTL, **changes}
        options = {**OPTIONS, **settings.pop("options", {})}
        return binding("CanAxis", field=field, endpoint=endpoint, options=options, **settings)

    return make


async def until(fact: Callable[[], bool]) -> None:
    async with asyncio.timeout(BOUND):
        while not fact():
            await asyncio.sleep(0.01)


@pytest.mark.few(0)
@pytest.mark.parametrize("variant", VARIANTS, ids=lambda variant: variant.name)
def test_foreign_drive_passes_the_kit(variant, bus, bound):
    """One drive at a time: it answers within 0.3 s also on a loaded computer."""
    plugins = discover()
    findings = asyncio.run(
        run_conformance(
            plugins,
            [bound(bus(variant)[0])],
            conformance_checks(plugins.by_driver["can"]),
            True,
            lambda finding: None,
            clock=SystemClock(),
            silence=SILENCE,
        )
    )
    wrong = [f"{each.check}: {each.outcome}: {each.seen}" for each in findings if each.outcome != "passed"]
    assert not wrong, "\n".join(wrong)


@pytest.mark.few(0)
def test_unsuitable_drive_is_refused_with_its_mapping_and_abort_text(bus, bound):
    async def open_it():
        async with guarded(bound(bus(UNFIT)[0])):
            raise AssertionError("the device must not be opened")

    with pytest.raises(DevicesError) as error:
        asyncio.run(open_it())
    text = str(error.value)
    assert (
        "no TPDO contains velocity (0x606C), and it cannot be mapped: mapping of TPDO 2 0x1A01:0 refused"
        in text
    )
    assert "Attempt to write a read only object" in text
    assert "It has TPDO 1 with 0x6041, TPDO 2 with 0x6041 0x6064" in text


@pytest.mark.few(1)
@pytest.mark.parametrize("variant", VARIANTS[4:], ids=lambda variant: variant.name)
async def test_setpoint_stream_in_pdos_with_control_word(bus, bound, variant):
    """Control word, mode and targets in one frame never restore one another's old values."""
    endpoint, drive = bus(variant)
    binding = bound(endpoint, waivers=["no_homing"], options={"cyclic": True})
    async with guarded(binding, silence=SILENCE) as (axis,):
        await axis.call("enable")
        await axis.call("setVelocity", 1.0)
        await axis.reads("velocity", lambda speed: abs(speed - 1.0) < 0.1)
        await axis.call("setPosition", await axis.call("position") + 0.5)
        # The call ends when the frame is sent; the drive reads it in a thread of its own.
        await until(lambda: (drive.mode, drive.controlword) == (8, 0x0F))
        await axis.call("stop")
        await until(lambda: drive.state != 0x0237 and abs(drive.velocity) < 100)


async def test_pdo_ids_keep_the_settings_of_the_drive(bus, bound):
    endpoint, drive = bus(VARIANTS[1])
    async with guarded(bound(endpoint)):
        assert drive.get(0x1800, 1) == 1 << 30 | 0x189
        assert drive.get(0x1400, 1) == 1 << 30 | 0x209
        assert [drive.get(0x1801, n) for n in (2, 3, 5)] == [255, 100, 20]
        assert drive.get(0x1803, 1) & UNUSED == 0  # not used by the driver, and left unchanged
