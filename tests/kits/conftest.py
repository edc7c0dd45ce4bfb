"""Fakes as processes, and the kits run on them by the code of `lfield kit`."""

from __future__ import annotations

import asyncio
import subprocess
import sys

import pytest

from lfield.devices.try_out import checks_of, try_devices
from lfield.driver.kit import Check
from lfield.driver.plugins import discover
from lfield.driver.sims import control_folder
from lfield.mission.one_device import devices_in_file
from lfield.net.control import ask_fake

#: Seconds that the host of a test may be silent: the machine may be busy.
SILENCE = 0.5


class RunningFake:
    """One `lfield sim`, ended with the test."""

    def __init__(self, kind, *options):
        self._kind = kind
        self._process = subprocess.Popen(
            [sys.executable, "-m", "lfield", "sim", kind, *options, "--until-stdin-closes"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        line = self._process.stdout.readline().split()
        assert line[:1] == ["ready"], line
        self.endpoint = line[1]

    def fault(self, *settings):
        answer = ask_fake(control_folder() / f"{self._kind}-{self._process.pid}.sock", settings)
        assert "faults" in answer, answer

    def end(self):
        self._process.stdin.close()
        self._process.stdout.close()
        assert self._process.wait(20) == 0


@pytest.fixture
def fake():
    """Start a fake: `fake("can", "--device", "cia402:5")`."""
    running = []

    def start(kind, *options):
        running.append(RunningFake(kind, *options))
        return running[-1]

    yield start
    for each in running:
        each.end()


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
