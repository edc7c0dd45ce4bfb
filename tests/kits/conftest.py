"""Fakes in virtual time, and the driver kits run on them by the code of `lfield kit`."""

from __future__ import annotations

import pytest

from lfield.devices.conformance_run import conformance_checks
from lfield.driver.kit import Check
from lfield.driver.plugins import discover
from lfield.mission.device_selection import devices_in_file
from lfield.testing.desk import Desk


@pytest.fixture
def desk():
    """A desk in virtual time."""
    return Desk()


@pytest.fixture
def try_kit(desk, tmp_path):
    """Runs the kit of a driver, or some of its checks, on named devices of the desk, one after the other.

    Each device is a line of a devices file; `frame` is that of all devices, `origin` the team's. `first`
    is called before the checks of each, `last` after them. Findings by device and check.
    """

    def run(driver, devices, *, only=(), frame="", origin="", first=lambda: None, last=lambda: None):
        plugins = discover()
        installed = plugins.by_driver[driver]
        checks = [check for check in conformance_checks(installed) if not only or check.name in only]

        def step(name, action):
            async def act(bench):
                action()
                return "done"

            return Check(name, act, moves=False)

        checks = [step("first", first), *checks, step("last", last)]
        path = tmp_path / "kit.yaml"
        lines = [f"      {name}: {{driver: {driver}, {words}}}" for name, words in devices.items()]
        whole = [f"frame: {{origin: {origin}}}"] if origin else []
        agent = [f"    frame: {frame}"] if frame else []
        path.write_text("\n".join([*whole, "agents:", "  kit:", *agent, "    devices:", *lines]))
        bound = devices_in_file(path, installed, plugins, "")
        found = desk.try_kit(*bound, checks=checks)
        return {(f.device.removeprefix("kit."), f.check): f for f in found}

    return run
