"""Driver failures outside a call: the devices go safe, and the failure is reported."""

from __future__ import annotations

import asyncio
import os
import sys
from contextlib import suppress

import msgspec
import pytest
from thing_guard import Output, guard_of, known_thing

from lfield.clock import SystemClock
from lfield.devices.conformance_run import END_CHECK, run_conformance
from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import RELEASE
from lfield.driver.device import Device
from lfield.driver.plugins import Plugins
from lfield.errors import DeviceError, DevicesError
from lfield.guard.core import REPEAT, RETRY
from lfield.guard.messages import (
    GuardCall,
    Latched,
    Note,
    OpenDevices,
    OpenFailed,
    Released,
    RequestSafeState,
    encode,
)
from lfield.simulate.jumping_loop import JumpingLoop, LoopClock
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


def run(plugins, scenario):
    async def main():
        async with guarded(binding("here"), plugins=plugins, silence=5.0) as (bench,):
            await scenario(bench)

    asyncio.run(main())


def test_exception_in_a_callback_makes_the_device_safe(plugins):
    async def scenario(bench):
        await bench.call("stumble")
        await bench.until(lambda: bench.confirmed, 60.0, "the safe state")
        assert bench.latched == "the driver failed: RuntimeError('stumbled')"

    run(plugins, scenario)


async def test_limit_breach_latches_only_the_device_that_caused_it(plugins):
    two = (binding("here"), binding("here", "u"))
    async with guarded(*two, plugins=plugins, silence=5.0) as (fast, calm):
        with suppress(DeviceError):
            await fast.call("overrun")
        await fast.until(lambda: fast.confirmed, 60.0, "the safe state")
        assert (fast.latched, calm.latched) == ("it went too fast", "")


def test_failed_background_future_is_reported_without_a_latch(plugins):
    async def scenario(bench):
        await bench.call("forget")
        note = "the driver task failed: RuntimeError('forgotten')"
        await bench.until(lambda: note in bench.notes, 60.0, "a note")
        assert bench.latched == ""

    run(plugins, scenario)


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


class _Plain(Device):
    async def _open(self):
        return "a thing"


class _Faulty(_Plain):
    """A device whose driver fails when it describes the safe states."""

    def _safe_action(self, state):
        raise RuntimeError("stumbled")


def _messages(kind, close=None):
    """The messages of a guard that opens one device of this class, and is closed."""

    async def scenario():
        output = Output()
        shell = guard_of(kind, output)
        shell.data_received(encode(OpenDevices([binding("here")], "", 99.0, known_thing())))
        await asyncio.sleep(0.1)
        if close is not None:
            shell._driver._close = close
        await shell.close()
        return output.received

    with asyncio.Runner(loop_factory=JumpingLoop) as runner:
        return runner.run(scenario())


def test_exception_about_the_safe_states_fails_the_open():
    (failed,) = (m for m in _messages(_Faulty) if isinstance(m, OpenFailed))
    assert [kind for _, kind, _ in failed.problems] == ["DeviceException"]


def test_driver_that_cannot_be_closed_is_reported():
    async def close():
        raise RuntimeError("stumbled")

    assert [m.code for m in _messages(_Plain, close) if isinstance(m, Note)][-1:] == ["driver-not-closed"]


class _Stubborn(_Plain):
    """Handles the cancellation of a safe-state command, as `asyncio.wait_for` may do in Python 3.11.

    With the option `ends`, the first command ends at once, and a cancelled one fails.
    """

    def __init__(self, *args):
        super().__init__(*args)
        self.commands = []

    async def _make_safe(self, state):
        self.commands.append(state)
        if self.commands == ["off"] and self.binding.options["ends"]:
            return
        try:
            await asyncio.sleep(99.0)
        except asyncio.CancelledError:
            if self.binding.options["ends"]:
                raise self.error("the command has failed") from None

    def _moving(self):
        return "turning"

    async def do_release(self):
        pass


def _guarded(scenario, *, ends):
    """The messages of a guard in this scenario, and the commands that its device has received."""

    async def main():
        output = Output()
        shell = guard_of(_Stubborn, output)
        device = msgspec.structs.replace(binding("here"), options={"ends": ends})
        shell.data_received(encode(OpenDevices([device], "", 99.0, known_thing(RELEASE))))
        await asyncio.sleep(0.1)
        shell.data_received(encode(RequestSafeState("a.t", "an operator requested it")))
        await scenario(shell)
        commands = shell._driver.devices["a.t"].commands
        await shell.close()
        return output.received, commands

    with asyncio.Runner(loop_factory=JumpingLoop) as runner:
        return runner.run(main())


def test_the_end_of_an_abandoned_command_does_not_confirm_another_safe_state():
    async def scenario(shell):
        await asyncio.sleep(0.1)
        shell.data_received(encode(RequestSafeState("a.t", "hold instead", state="hold")))
        await asyncio.sleep(1.0)

    sent_messages, commands = _guarded(scenario, ends=False)
    assert commands == ["off", "hold"]
    assert not [message for message in sent_messages if isinstance(message, Latched) and message.confirmed]


def test_the_failure_of_an_abandoned_command_does_not_make_a_released_device_safe_again():
    async def scenario(shell):
        await asyncio.sleep(REPEAT + 1.0)  # The device still moves, so its safe state is commanded again.
        sent = LoopClock().monotonic()
        shell.data_received(encode(GuardCall(1, "a.t", "release", [], sent, sent + 9.0)))
        await asyncio.sleep(RETRY + 1.0)

    sent_messages, commands = _guarded(scenario, ends=True)
    assert Released("a.t") in sent_messages
    notes = [message.code for message in sent_messages if isinstance(message, Note)]
    assert "safe-state-unconfirmed" not in notes
    assert commands == ["off", "off"]
