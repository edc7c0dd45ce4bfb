"""The pipe between a host and its guards in both directions: a guard runs external driver code."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Sequence
from types import SimpleNamespace
from typing import Any

import msgspec
from decoder_target import Target
from targets_of_links import pack, unpack

from lfield.devices.guard_process import GuardProcess
from lfield.devices.scheduling_jitter import JitterLimit, JitterMonitor
from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import Manifest
from lfield.driver.device import Device, Driver
from lfield.driver.driver_index import DriverInfo, ManifestFile
from lfield.guard import messages
from lfield.guard.messages import MESSAGES, OpenDevices
from lfield.guard.shell import Shell
from lfield.manifest import DeviceManifest, Instruction, Observation, Parameter, Quantity
from lfield.simulate.jumping_loop import LoopClock, run_jumping
from lfield.wire.framing import frame

THING = DeviceManifest(
    "Thing",
    "thing",
    (
        Instruction("move", (Parameter("to", "real"),), effect="idempotent", blocking=True, cancel="halt"),
        Instruction("halt", effect="idempotent", blocking=True),
        Instruction("steer", (Parameter("by", "real[]"),)),
        Instruction("look", (), "int", effect="query", blocking=True),
        Instruction("where", (), "real", effect="query"),
    ),
    (Quantity("where", "real"), Quantity("all", "real[]"), Quantity("on", "boolean")),
    safe_states=("off", "hold"),
)
BINDING = DeviceBinding(
    agent="a",
    field="x",
    type="Thing",
    driver="thing",
    endpoint="virtual:1",
    safe_state="off",
    options={},
    waivers=["device_watchdog"],
)
KNOWN = DriverInfo(
    "thing",
    "lfield_thing:PLUGIN",
    {"Thing": Manifest(THING)},
    {"Thing": ManifestFile("manifest.yaml", bytes(32))},
    "",
)
TOKENS = (
    "a.x",
    "Thing",
    "move",
    "halt",
    "steer",
    "look",
    "where",
    "all",
    "on",
    "off",
    "hold",
    *range(20),
    1e9,
)


class Thing(Device):
    """A device that executes its instructions."""

    async def _open(self) -> str:
        return "a thing"

    async def _make_safe(self, state: str) -> None:
        pass

    async def do_move(self, to: float) -> None:
        """Sleep for `to` seconds, or for 0.1 s if `to` is not between 0 and 5."""
        await asyncio.sleep(to if 0.0 < to < 5.0 else 0.1)

    async def do_halt(self) -> None:
        """Do nothing: the device halts at once."""

    async def do_steer(self, by: Sequence[float]) -> None:
        """Publish `by` as the quantity `all`."""
        self.publish(all=list(by))

    async def do_look(self) -> int:
        """Return a constant."""
        return 7


class Bus(Driver):
    """A bus of things."""

    def _device(self, binding: DeviceBinding) -> Device:
        return Thing(binding, self.manifests[binding.type], self.clock, self.reports)

    async def _open(self) -> None:
        pass

    async def _close(self) -> None:
        pass


class Output:
    """The pipe to the host."""

    def __init__(self) -> None:
        self.reader = messages.MessageReader()

    def write(self, data: bytes) -> None:
        """Decode the messages of the guard."""
        list(self.reader.feed(data))

    def is_closing(self) -> bool:
        """Whether the pipe is closing: never."""
        return False

    def get_write_buffer_size(self) -> int:
        """The number of unsent bytes: always 0."""
        return 0


class FreeLock:
    """A lock without competitors."""

    async def acquire(self, endpoint: str) -> None:
        """Take the lock at once."""

    def release(self) -> None:
        """Release the lock."""


async def run_and_check_callbacks(work: Coroutine[Any, Any, None]) -> None:
    """Run the coroutine, then raise the exceptions of its callbacks."""
    raised: list[Any] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: raised.append(context))
    await work
    for context in raised:
        raise context.get("exception") or AssertionError(context)


def frames(data: bytes) -> list[bytes]:
    """The frames of a list of [kind, fields] and raw bytes."""
    try:
        tree = unpack(data)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return []
    found = []
    for event in tree[:50] if isinstance(tree, list) else ():
        if isinstance(event, list) and len(event) == 2 and isinstance(event[0], int):
            found.append(frame(event[0] & 0xFF, pack(event[1])))
        elif isinstance(event, bytes):
            found.append(event)
    return found


def decode_in_guard(data: bytes) -> None:
    """Feed messages of a host to a guard."""

    async def session() -> None:
        plugin: Any = SimpleNamespace(load=lambda: Bus, has_manifest=lambda file: True, reference="")
        shell = Shell(plugin, Output(), LoopClock(), lock=FreeLock())  # type: ignore[arg-type]
        raised: list[Any] = []
        crashed = shell._callback_raised

        def on_exception(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
            raised.append(context)
            crashed(loop, context)

        asyncio.get_running_loop().set_exception_handler(on_exception)
        for piece in frames(data):
            shell.data_received(piece)
            await asyncio.sleep(0.03)
        shell.connection_lost(None)
        await asyncio.sleep(30.0)
        await shell.close()
        for context in raised:
            raise context.get("exception") or AssertionError(context)

    run_jumping(session())


class Process:
    """A guard process simulated by the fuzzer."""

    def __init__(self) -> None:
        self.closed = False

    def get_pipe_transport(self, fd: int) -> Any:
        """The standard input of the process."""
        return SimpleNamespace(is_closing=lambda: False, write=lambda data: None)

    def get_pid(self) -> None:
        """The process id: None."""

    def get_returncode(self) -> None:
        """The exit status: None, as of a running process."""

    def close(self) -> None:
        """Do nothing: there is no real process."""


def decode_in_host(data: bytes) -> None:
    """Feed messages of a guard to a host."""

    async def session() -> None:
        notes: list[str] = []
        guard = GuardProcess(
            KNOWN, [BINDING], LoopClock(), notes.append, JitterMonitor(JitterLimit(1.0, False)), lambda: True
        )
        guard.connection_made(Process())  # type: ignore[arg-type]
        called = False
        # Retrieve the exception of the opening.
        guard._opening.add_done_callback(lambda opening: opening.cancelled() or opening.exception())
        for piece in frames(data):
            guard.pipe_data_received(1, piece)
            await asyncio.sleep(0.03)
            if guard.ready and not called:
                called = True
                for instruction, arguments in ((0, [1.0]), (3, []), (2, [[1.0, 2.0]])):
                    guard.call("a.x", THING.instructions[instruction], arguments, lambda value: None)
            guard.unavailability("a.x"), guard.snapshots.telemetry, guard.snapshots.describe("a.x")
            for quantity in THING.telemetry:
                if guard.snapshots.last("a.x", quantity.name) is not None:
                    guard.snapshots.reading("a.x", quantity.name)

    run_jumping(run_and_check_callbacks(session()))


def _kind(message: msgspec.Struct) -> list[Any]:
    return [MESSAGES.index(type(message)), unpack(msgspec.msgpack.encode(message))]  # type: ignore[arg-type]


def _host_seeds() -> list[bytes]:
    opened, m = OpenDevices([BINDING], "", 0.5, KNOWN), messages
    said = [
        m.Beat(1000.01),
        m.GuardCall(1, "a.x", "move", [1.0], 1000.02, 1009.0),
        m.GuardCall(2, "a.x", "look", [], 1000.03, 1009.0),
        m.GuardCall(3, "a.x", "steer", [[1.0, 2.0]], 1000.03, 1009.0),
        m.CancelInstruction(1, 1000.1),
        m.RequestSafeState("a.x", "why"),
        m.RequestSafeState("", "why", True, "hold"),
        m.ClearStop(),
        m.GuardCall(4, "a.x", "release", [], 1000.3, 1009.0),
        m.Stop("end"),
    ]
    records = [_kind(opened), *map(_kind, said)]
    return [pack(records), *(pack([records[0], records[1], each]) for each in records)]


def _guard_seeds() -> list[bytes]:
    m = messages
    observations = {"where": Observation(1.0, 1000.1), "on": Observation(True, 1000.1)}
    said = [
        m.DevicesOpened({"a.x": "a thing"}),
        m.TelemetrySnapshot("a.x", observations, 1000.1),
        m.CallDone(1, None),
        m.CallDone(2, 7),
        m.Refused(3, "DeviceException", "no"),
        m.Latched("a.x", "why", False),
        m.Latched("a.x", "why", True, "hold"),
        m.Moving("a.x", "rolls"),
        m.Released("a.x"),
        m.Note("a.x", "said"),
        m.OpenFailed([("a.x", "DeviceException", "no")]),
        m.Stopped({"a.x": "rolls"}),
        m.Beat(1000.2),
    ]
    ready = _kind(said[0])
    return [
        pack([*map(_kind, said)]),
        *(pack([ready, _kind(each)]) for each in said),
        pack([_kind(said[10])]),
    ]


TARGETS = (
    Target("guard-in", _host_seeds, decode_in_guard, True, TOKENS),
    Target("guard-out", _guard_seeds, decode_in_host, True, TOKENS),
)
