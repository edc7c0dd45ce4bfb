"""Driver kits on fakes in virtual time; the code of `lfield kit` runs them."""

from __future__ import annotations

from contextlib import closing

import pytest

from lfield.devices.conformance_run import conformance_checks
from lfield.driver.kit import Check
from lfield.driver.plugins import discover
from lfield.mission.device_selection import devices_in_file
from lfield.testing.desk import Desk


@pytest.fixture
def desk():
    """A desk in virtual time."""
    with closing(Desk()) as desk:
        yield desk


@pytest.fixture
def run_kit_on(desk, tmp_path):
    """Runs the kit of a driver on devices of the desk, one after the other.

    `devices` has the entry of a devices file for each name. `only` limits the run to these checks. `frame` is
    the frame of the agent, `origin` the origin of the team. `first` is called before the checks of each
    device, `last` after them. Returns the findings by device and check.
    """

    def run(driver, devices, *, only=(), frame="", origin="", first=lambda: None, last=lambda: None):
        plugins = discover()
        installed = plugins.by_driver[driver]
        checks = [check for check in conformance_checks(installed) if not only or check.name in only]

        def step(name, action):
            async def call_action(bench):
                action()
                return "done"

            return Check(name, call_action, moves=False)

        checks = [step("first", first), *checks, step("last", last)]
        path = tmp_path / "kit.yaml"
        lines = [f"      {name}: {{driver: {driver}, {entry}}}" for name, entry in devices.items()]
        team = [f"frame: {{origin: {origin}}}"] if origin else []
        agent = [f"    frame: {frame}"] if frame else []
        path.write_text("\n".join([*team, "agents:", "  kit:", *agent, "    devices:", *lines]))
        bound = devices_in_file(path, installed, plugins, "")
        found = desk.try_kit(*bound, checks=checks)
        return {(f.device.removeprefix("kit."), f.check): f for f in found}

    return run
