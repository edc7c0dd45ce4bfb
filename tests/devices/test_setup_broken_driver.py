"""`lfield setup` with a driver that fails: the first problem is reported, and the endpoint is released."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from lfield.clock import ManualClock
from lfield.devices.device_setup import open_devices
from lfield.driver.binding import DeviceBinding
from lfield.driver.plugins import Plugins
from lfield.errors import DevicesError
from lfield.guard.endpoint_lock import EndpointLock

DRIVER = """
from lfield.driver import Device, Driver, Plugin
from lfield.errors import PluginError

PLUGIN = Plugin("clumsy", "clumsy", "clumsy:Clumsy", "x")

class Thing(Device):
    async def find(self):
        if self.binding.field == "absent":
            raise self.error("it does not answer")
        if self.binding.field == "unusable":
            raise PluginError("a library is missing")
        return "a thing"

    async def settings(self):
        return []

class Clumsy(Driver):
    def _device(self, binding):
        return Thing(binding, self.manifests[binding.type], self.clock, self.reports)

    async def _open(self):
        pass

    async def _close(self):
        raise RuntimeError("stumbled")
"""
MANIFEST = """
driver: clumsy
type: Thing
safe_states: [off]
instructions: {}
"""


@pytest.fixture
def plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Plugins]:
    package = tmp_path / "clumsy"
    package.mkdir()
    (package / "__init__.py").write_text(DRIVER)
    (package / "manifest.yaml").write_text(MANIFEST)
    monkeypatch.syspath_prepend(str(tmp_path))
    found = Plugins()
    found.add("clumsy:PLUGIN")
    yield found
    sys.modules.pop("clumsy", None)


def binding(field: str, endpoint: str) -> DeviceBinding:
    return DeviceBinding(
        agent="a", field=field, type="Thing", driver="clumsy", endpoint=endpoint, safe_state="off",
        waivers=["device_watchdog"],
    )  # fmt: skip


async def names_of(plugins: Plugins, lines: list[str], *devices: DeviceBinding) -> list[str]:
    async with open_devices(plugins, devices, ManualClock(), lines.append) as found:
        return [device.name for device in found]


async def test_failure_to_close_does_not_hide_the_problem(plugins: Plugins, tmp_path: Path) -> None:
    lines: list[str] = []
    with pytest.raises(DevicesError) as error:
        await names_of(plugins, lines, binding("absent", "one"), binding("t", "two"))
    assert error.value.problems == ("a.absent: it does not answer",)
    assert [("clumsy" in line, "RuntimeError('stumbled')" in line) for line in lines] == [(True, True)] * 2


async def test_an_error_of_the_plugin_is_a_problem_of_its_device(plugins: Plugins) -> None:
    devices = binding("unusable", "one"), binding("absent", "two")
    with pytest.raises(DevicesError) as error:
        await names_of(plugins, [], *devices)
    assert error.value.problems == ("a.unusable: a library is missing", "a.absent: it does not answer")


async def test_failure_to_close_releases_the_endpoint(plugins: Plugins) -> None:
    assert await names_of(plugins, [], binding("t", "one")) == ["a.t"]
    lock = EndpointLock()
    await lock.acquire("one")
    lock.release()
