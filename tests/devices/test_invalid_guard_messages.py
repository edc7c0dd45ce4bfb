"""A guard that sends invalid messages, or ends, is restarted; the host continues.

A guard loads third-party code, so the host checks each message of a guard.
"""

from __future__ import annotations

import asyncio
import gc
from types import SimpleNamespace

import pytest

from lfield.devices.guard_process import GuardProcess
from lfield.devices.scheduling_jitter import JitterLimit, JitterMonitor
from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import Manifest
from lfield.driver.driver_index import DriverInfo, ManifestFile
from lfield.guard.messages import (
    Beat,
    CallDone,
    DevicesOpened,
    Latched,
    MessageReader,
    OpenDevices,
    Refused,
    Released,
    Stop,
    Stopped,
    TelemetrySnapshot,
    encode,
)
from lfield.manifest import DeviceManifest, Observation, Quantity
from lfield.simulate.jumping_loop import LoopClock, run_jumping

LAMP = DeviceManifest(
    "Lamp", "lamp", (), (Quantity("glow", "real"), Quantity("on", "boolean")), safe_states=("off",)
)
KNOWN = DriverInfo(
    "lamp", "lfield_lamp:PLUGIN", {"Lamp": Manifest(LAMP)}, {"Lamp": ManifestFile("lamp.yaml", bytes(32))}, ""
)
BINDING = DeviceBinding(
    agent="a", field="x", type="Lamp", driver="lamp", endpoint="virtual:1", safe_state="off", options={}
)
SEEN = Observation(1.0, 1.0)


@pytest.mark.parametrize(
    ("message", "report"),
    [
        (CallDone(7, None), "an answer to call 7, which is not pending"),
        (Refused(7, "DeviceException", "no"), "an answer to call 7, which is not pending"),
        (TelemetrySnapshot("b.y", {}, 1.0), "telemetry of 'b.y', which it does not guard"),
        (TelemetrySnapshot("a.x", {"warmth": SEEN}, 1.0), "a.x has no warmth"),
        (TelemetrySnapshot("a.x", {"on": SEEN}, 1.0), "on of a.x: 1.0 is not a boolean"),
        (Latched("b.y", "why", confirmed=False), "message about 'b.y', which it does not guard"),
        (Released("b.y"), "message about 'b.y', which it does not guard"),
        (DevicesOpened({"a.x": "a lamp", "b.y": "another"}), "devices that it does not guard: a.x, b.y"),
    ],
)
def test_host_kills_a_guard_that_sends_an_invalid_message(message, report):
    notes, killed, raised = [], [], []

    async def scenario():
        asyncio.get_running_loop().set_exception_handler(lambda _, context: raised.append(context))
        guard = GuardProcess(
            KNOWN, [BINDING], LoopClock(), notes.append, JitterMonitor(JitterLimit(1.0)), lambda: True
        )
        guard.kill = lambda: killed.append(True)
        guard.connection_made(SimpleNamespace(get_pipe_transport=lambda fd: None))
        guard.pipe_data_received(1, encode(message))

    run_jumping(scenario())
    assert [note.partition(" sent ")[2] for note in notes] == [f"invalid bytes: {report}; restarting it"]
    assert (killed, raised) == ([True], [])


def test_guard_restart_is_delayed_only_after_a_short_run(monkeypatch):
    """Without a guard the autopilot receives no heartbeats, so the restart is not delayed without need."""
    started = []

    async def scenario():
        clock = LoopClock()
        guard = GuardProcess(
            KNOWN, [BINDING], clock, lambda text: None, JitterMonitor(JitterLimit(1.0)), lambda: True
        )

        async def start(protocol, *arguments):
            started.append(clock.monotonic())
            pipe = SimpleNamespace(is_closing=lambda: False, write=lambda data: None)
            process = SimpleNamespace(
                get_pipe_transport=lambda fd: pipe, get_returncode=lambda: -9, close=lambda: None
            )
            protocol.connection_made(process)
            protocol.pipe_data_received(1, encode(DevicesOpened({"a.x": "a lamp"})))

        monkeypatch.setattr("lfield.devices.guard_process.start_process", start)
        await guard.open()
        for run_time in (6.0, 0.5, 6.0):
            await asyncio.sleep(run_time)
            guard.connection_lost(None)
        await asyncio.sleep(1.0)

    run_jumping(scenario())
    first, *restarts = started
    assert [round(at - first, 3) for at in restarts] == [6.0, 6.7, 12.5]


def test_process_that_ends_after_a_cancelled_start_causes_no_unhandled_exception(monkeypatch):
    raised = []

    async def scenario():
        asyncio.get_running_loop().set_exception_handler(lambda _, context: raised.append(context))
        guard = GuardProcess(
            KNOWN, [BINDING], LoopClock(), lambda text: None, JitterMonitor(JitterLimit(1.0)), lambda: True
        )

        async def start(protocol, *arguments):
            process = SimpleNamespace(
                get_pipe_transport=lambda fd: None, get_returncode=lambda: -9, close=lambda: None
            )
            protocol.connection_made(process)
            await asyncio.Event().wait()

        monkeypatch.setattr("lfield.devices.guard_process.start_process", start)
        opening = asyncio.create_task(guard.open())
        await asyncio.sleep(0)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening
        guard.connection_lost(None)
        del guard
        gc.collect()

    run_jumping(scenario())
    assert raised == []


def test_stop_during_a_guard_restart_is_sent_after_open_devices(monkeypatch):
    """The process exists before `start_process` returns, so a stop may arrive between the two."""
    received = []

    async def scenario():
        guard = GuardProcess(
            KNOWN, [BINDING], LoopClock(), lambda text: None, JitterMonitor(JitterLimit(1.0)), lambda: True
        )
        starts, started, may_return = 0, asyncio.Event(), asyncio.Event()

        async def start(protocol, *arguments):
            nonlocal starts
            starts += 1
            reader, messages = MessageReader(), []
            received.append(messages)
            pipe = SimpleNamespace(
                is_closing=lambda: False, write=lambda data: messages.extend(reader.feed(data))
            )
            status = -9 if starts == 1 else 1
            process = SimpleNamespace(
                get_pipe_transport=lambda fd: pipe, get_returncode=lambda: status, close=lambda: None
            )
            protocol.connection_made(process)
            if starts == 2:
                started.set()
                await may_return.wait()
            protocol.pipe_data_received(1, encode(DevicesOpened({"a.x": "a lamp"})))

        monkeypatch.setattr("lfield.devices.guard_process.start_process", start)
        await guard.open()
        guard.connection_lost(None)
        await started.wait()
        closing = asyncio.create_task(guard.close())
        await asyncio.sleep(0)
        may_return.set()
        await asyncio.sleep(1.0)
        guard.pipe_data_received(1, encode(Stopped({"a.x": "it is hot"})))
        guard.connection_lost(None)
        return await closing

    assert run_jumping(scenario()) == {"a.x": "it is hot"}
    first, second, *rest = (message for message in received[1] if not isinstance(message, Beat))
    assert isinstance(first, OpenDevices)
    assert first.latched == "its guard died and was restarted"
    assert [second, *rest] == [Stop("the host is stopping")] * 2
