"""The driver and its kit against drives that somebody else has built: canopen's LocalNode, another object
dictionary, other readings of CiA 301. In real time and over a socketcand door, as hardware would be."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack

import pytest
from foreign_drive import foreign
from foreign_objects import VARIANTS

from lfield.devices.try_out import checks_of, try_devices
from lfield.driver.plugins import discover
from lfield.testing.driver_bench import running_fake

pytestmark = [pytest.mark.process, pytest.mark.long, pytest.mark.timeout(120)]

#: Seconds that the host of a test may be silent: the machine may be busy.
SILENCE = 1.0
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
        given = {"limits": {"speed": 5.0}, "ttl": 1.5, **changes}
        options = {**OPTIONS, **given.pop("options", {})}
        return binding("CanAxis", field=field, endpoint=endpoint, options=options, **given)

    return make


def test_every_foreign_drive_passes_the_kit(bus, bound):
    plugins, names = discover(), [variant.name for variant in VARIANTS]

    async def kit(name, binding):
        found = await try_devices(
            plugins,
            [binding],
            checks_of(plugins.by_driver["can"]),
            True,
            lambda finding: None,
            silence=SILENCE,
        )
        return [f"{name}: {f.check}: {f.outcome}: {f.seen}" for f in found if f.outcome != "passed"]

    async def all_at_once():
        drives = [bound(bus(variant)[0], f"axis{n}") for n, variant in enumerate(VARIANTS)]
        return await asyncio.gather(*map(kit, names, drives))

    assert [line for lines in asyncio.run(all_at_once()) for line in lines] == []
