"""Fakes as processes, and the kits run on them by the code of `lfield kit`."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack

import pytest

from lfield.devices.try_out import checks_of, try_devices
from lfield.driver.kit import Check
from lfield.driver.plugins import discover
from lfield.mission.one_device import devices_in_file
from lfield.testing.driver_bench import running_fake

#: Seconds that the host of a test may be silent: the machine may be busy.
SILENCE = 0.8


@pytest.fixture
def fake():
    """Start a fake, which ends with the test: `fake("can", "--device", "cia402:5")`."""
    with ExitStack() as running:
        yield lambda kind, *options: running.enter_context(running_fake(kind, *options))


@pytest.fixture
def try_kit(tmp_path):
    """Run the kit of a driver, or some of its checks, on groups of devices at the same time.

    A group is a dictionary of devices by their names, each as a line of a devices file; it has guards of its
    own. `first` is called when the devices are open, `last` before they are closed. Findings by device and
    check.
    """

    def run(driver, *groups, only=(), first=lambda: None, last=lambda: None):
        plugins = discover()
        installed = plugins.by_driver[driver]
        checks = [check for check in checks_of(installed) if not only or check.name in only]

        def step(name, action):
            async def act(bench):
                action()
                return "done"

            return Check(name, act, moves=False)

        checks = [step("first", first), *checks, step("last", last)]

        async def one(number, group):
            path = tmp_path / f"{number}.yaml"
            lines = [f"      {name}: {{driver: {driver}, {words}}}" for name, words in group.items()]
            path.write_text("\n".join(["agents:", "  kit:", "    devices:", *lines]))
            devices = devices_in_file(path, installed, plugins, "")
            return await try_devices(plugins, devices, checks, True, lambda finding: None, silence=SILENCE)

        async def all_at_once():
            return await asyncio.gather(*(one(number, group) for number, group in enumerate(groups)))

        found = [finding for findings in asyncio.run(all_at_once()) for finding in findings]
        return {(f.device.removeprefix("kit."), f.check): f for f in found}

    return run
