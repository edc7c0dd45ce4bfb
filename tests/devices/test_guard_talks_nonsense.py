"""A guard loads foreign code: what it says and cannot be ends that guard with a sentence, not its host."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from lfield.devices.keeper import Guard
from lfield.devices.lateness import Lateness, Limit
from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import Manifest
from lfield.driver.known import KnownDriver, ManifestFile
from lfield.guard.messages import Done, Latched, Ready, Refused, Released, Snapshot, encode
from lfield.manifest import DeviceManifest, Observation, Quantity
from lfield.simulate.time import LoopClock, run_jumping

LAMP = DeviceManifest(
    "Lamp", "lamp", (), (Quantity("glow", "real"), Quantity("on", "boolean")), safe_states=("off",)
)
KNOWN = KnownDriver(
    "lamp", "lfield_lamp:PLUGIN", {"Lamp": Manifest(LAMP)}, {"Lamp": ManifestFile("lamp.yaml", bytes(32))}, ""
)
BINDING = DeviceBinding(
    agent="a", field="x", type="Lamp", driver="lamp", endpoint="virtual:1", safe_state="off", options={}
)
SEEN = Observation(1.0, 1.0)


@pytest.mark.parametrize(
    ("message", "told"),
    [
        (Done(7, None), "an answer to call 7, which waits for none"),
        (Refused(7, "DeviceException", "no"), "an answer to call 7, which waits for none"),
        (Snapshot("b.y", {}, 1.0), "telemetry of 'b.y', which it does not guard"),
        (Snapshot("a.x", {"warmth": SEEN}, 1.0), "a.x has no warmth"),
        (Snapshot("a.x", {"on": SEEN}, 1.0), "on of a.x: 1.0 is not a boolean"),
        (Latched("b.y", "why", confirmed=False), "word of 'b.y', which it does not guard"),
        (Released("b.y"), "word of 'b.y', which it does not guard"),
        (Ready({"a.x": "a lamp", "b.y": "another"}), "devices that it does not guard: a.x, b.y"),
    ],
)
def test_it_is_killed_and_its_host_goes_on(message, told):
    notes, killed, raised = [], [], []

    async def story():
        asyncio.get_running_loop().set_exception_handler(lambda _, context: raised.append(context))
        guard = Guard(KNOWN, [BINDING], LoopClock(), notes.append, Lateness(Limit(1.0)), lambda: True)
        guard.kill = lambda: killed.append(True)
        guard.connection_made(SimpleNamespace(get_pipe_transport=lambda fd: None))
        guard.pipe_data_received(1, encode(message))

    run_jumping(story())
    assert notes == [f"the guard sent bytes that make no sense: {told}"]
    assert (killed, raised) == ([True], [])


def test_a_guard_that_lived_is_started_again_at_once_and_one_that_did_not_after_a_pause(monkeypatch):
    """Its autopilot hears no station meanwhile."""
    started = []

    async def story():
        clock = LoopClock()
        guard = Guard(KNOWN, [BINDING], clock, lambda text: None, Lateness(Limit(1.0)), lambda: True)

        async def start(protocol, *words):
            started.append(clock.monotonic())
            pipe = SimpleNamespace(is_closing=lambda: False, write=lambda data: None)
            process = SimpleNamespace(
                get_pipe_transport=lambda fd: pipe, get_returncode=lambda: -9, close=lambda: None
            )
            protocol.connection_made(process)
            protocol.pipe_data_received(1, encode(Ready({"a.x": "a lamp"})))

        monkeypatch.setattr("lfield.devices.keeper.start_process", start)
        await guard.open()
        for lived in (6.0, 0.5, 6.0):
            await asyncio.sleep(lived)
            guard.connection_lost(None)
        await asyncio.sleep(1.0)

    run_jumping(story())
    first, *again = started
    assert [round(at - first, 3) for at in again] == [6.0, 6.7, 12.5]
