"""Driver failures outside a call: the devices go safe, and the failure is reported."""

from __future__ import annotations

import asyncio
import os
import sys
from contextlib import suppress

import pytest

from lfield.clock import SystemClock
from lfield.devices.conformance_run import END_CHECK, run_conformance
from lfield.driver.binding import DeviceBinding
from lfield.driver.plugins import Plugins
from lfield.errors import DeviceError, DevicesError
from lfield.testing.driver_bench import guarded

pytestmark = pytest.mark.process

DRIVER = """
import asyncio
from lfield.driver import Device, Driver, Plugin

PLUGIN = Plugin("clumsy", "clumsy", "clumsy:Clumsy", "x")

def stumble():
    raise RuntimeError("stumbled")

class Thing(Device):
    async def _open(self):
        if self.binding.endpoint == "at once":
            asyncio.get_running_loop().call_soon(stumble)
            await asyncio.sleep(60)
        return "a thing"

    async def _make_safe(self, state):
        if self.binding.endpoint == "stubborn":
            raise self.error("it does not listen")

    def _moving(self):
        if self.binding.endpoint == "confused":
            stumble()
        return "turning for ever" if self.binding.endpoint == "restless" else ""

    async def do_stumble(self):
        asyncio.get_running_loop().call_soon(stumble)

    async def do_forget(self):
        asyncio.get_running_loop().create_future().set_exception(RuntimeError("forgotten"))

    async def do_overrun(self):
        self.breach("it went too fast")

class Clumsy(Driver):
    def _device(self, binding):
        return Thing(binding, self.manifests[binding.type], self.clock, self.reports)

    async def _open(self):
        pass

    async def _close(self):
        pass
"""
MANIFEST = """
driver: clumsy
type: Thing
safe_states: [off]
instructions:
  stumble: {blocking: true, effect: idempotent, cancel: never}
  forget: {blocking: true, effect: idempotent, cancel: never}
  overrun: {blocking: true, effect: idempotent, cancel: never}
"""


@pytest.fixture
def plugins(tmp_path, monkeypatch):
    package = tmp_path / "clumsy"
    package.mkdir()
    (package / "__init__.py").write_text(DRIVER)
    (package / "manifest.yaml").write_text(MANIFEST)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *filter(None, sys.path)]))
    found = Plugins()
    found.add("clumsy:PLUGIN")
    yield found
    sys.modules.pop("clumsy", None)


def binding(endpoint: str, field: str = "t") -> DeviceBinding:
    return DeviceBinding(
        agent="a", field=field, type="Thing", driver="clumsy", endpoint=endpoint, safe_state="off",
        waivers=["device_watchdog"], rest_within=1.0,
    )  # fmt: skip


def run(plugins, story):
    async def main():
        async with guarded(binding("here"), plugins=plugins, silence=5.0) as (bench,):
            await story(bench)

    asyncio.run(main())


def test_exception_in_a_callback_makes_the_device_safe(plugins):
    async def story(bench):
        await bench.call("stumble")
        await bench.until(lambda: bench.confirmed, 60.0, "the safe state")
        assert bench.latched == "the driver failed: RuntimeError('stumbled')"

    run(plugins, story)


async def test_limit_breach_latches_only_the_device_that_caused_it(plugins):
    two = (binding("here"), binding("here", "u"))
    async with guarded(*two, plugins=plugins, silence=5.0) as (fast, calm):
        with suppress(DeviceError):
            await fast.call("overrun")
        await fast.until(lambda: fast.confirmed, 60.0, "the safe state")
        assert (fast.latched, calm.latched) == ("it went too fast", "")


def test_failed_background_future_is_reported_without_a_latch(plugins):
    async def story(bench):
        await bench.call("forget")
        note = "the driver driver task failed: RuntimeError('forgotten')"
        await bench.until(lambda: note in bench.notes, 60.0, "a note")
        assert bench.latched == ""

    run(plugins, story)


def test_exception_in_a_callback_during_open_fails_the_open(plugins):
    async def opening():
        async with guarded(binding("at once"), plugins=plugins):
            raise AssertionError("the device was opened")

    with pytest.raises(DevicesError, match=r"the driver failed: RuntimeError\('stumbled'\)"):
        asyncio.run(opening())


def tried(plugins, endpoint):
    """The findings of a kit without checks."""
    return run_conformance(
        plugins, [binding(endpoint)], [], False, lambda finding: None, clock=SystemClock(), silence=5.0
    )


@pytest.mark.parametrize(
    ("endpoint", "why"),
    [
        ("stubborn", "its safe state was not confirmed; it has sent no message"),
        ("restless", "it is in its safe state and not at rest: turning for ever; it has sent no message"),
        (
            "confused",
            "it is in its safe state and not at rest: unknown, the driver failed: "
            "RuntimeError('stumbled'); it has sent no message",
        ),
    ],
)
def test_device_not_left_safe_is_the_last_finding_of_a_kit(plugins, endpoint, why):
    (left,) = asyncio.run(tried(plugins, endpoint))
    assert (left.device, left.check, left.outcome, left.seen) == ("a.t", END_CHECK, "failed", why)


def test_device_left_safe_and_at_rest_is_no_finding(plugins):
    assert asyncio.run(tried(plugins, "calm")) == []
