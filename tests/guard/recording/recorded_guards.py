"""Recorded guards of devices in memory, with inputs in a random order of a given seed."""

from __future__ import annotations

import random
from io import BytesIO

from memory_ring import MemoryRing

from lfield.clock import ManualClock
from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import Manifest
from lfield.driver.driver_index import DriverInfo, ManifestFile
from lfield.guard.core import GuardCore
from lfield.guard.effects import CheckRest, Execute, Interrupt, MakeSafe
from lfield.guard.messages import GuardCall, GuardRecording, OpenDevices
from lfield.guard.recording import guard_inputs as inputs
from lfield.guard.recording.guard_recorder import GuardRecorder
from lfield.guard.recording.guard_records import decode_record
from lfield.guard.recording.recorded_core import RecordedCore
from lfield.manifest import NEVER, DeviceManifest, Instruction, Parameter, Quantity
from lfield.recording.segments import SegmentReader
from lfield.recording.turn_clocks import TurnClock

ARM = DeviceManifest(
    "Arm",
    "thing",
    (
        Instruction("go", (Parameter("x", "real"),), blocking=True, cancel="halt"),
        Instruction("steer", (Parameter("x", "real"),)),
        Instruction("grip", (), blocking=True, channel="gripper"),
        Instruction("ask", (), "int", effect="query", blocking=True),
        Instruction("release", effect="idempotent", blocking=True),
        Instruction("halt", effect="idempotent", blocking=True, cancel=NEVER),
    ),
    (Quantity("height", "real", "m"), Quantity("mode", "string")),
    safe_states=("stop", "park"),
)
EYE = DeviceManifest("Eye", "thing", ARM.instructions[3:4])
SECRETS = "tcp:pilot:hunter2@10.0.0.7:5760?token=hunter2"
DEVICES = [
    DeviceBinding(
        agent="a", field="arm", type="Arm", driver="thing", endpoint=SECRETS, safe_state="stop",
        options={"system": 7, "key": "hunter2"},
    ),
    DeviceBinding(agent="a", field="eye", type="Eye", driver="thing", endpoint=SECRETS),
]  # fmt: skip
DRIVER = DriverInfo(
    "thing",
    "thing:PLUGIN",
    {kind.type: Manifest(kind) for kind in (ARM, EYE)},
    {kind.type: ManifestFile("m.yaml", bytes(32)) for kind in (ARM, EYE)},
    "",
)
SILENCE = 0.2
FOLDER = "/rec/north-20261129T173015-1f3a9c02"


class RecordedGuard:
    """A core with its recorder, on a manual clock."""

    def __init__(self, limit=None, start=1000.0, *, is_open=True):
        self.clock, self.ring = ManualClock(start), MemoryRing(limit)
        message = OpenDevices(
            DEVICES, "", SILENCE, DRIVER, [], GuardRecording(f"{FOLDER}/guard-a.arm", 1 << 20, "run 7")
        )
        self.recorder = GuardRecorder(message, self.clock, self.ring)
        if is_open:
            self.open()

    def open(self):
        clock = TurnClock(self.clock)
        devices = [("a.arm", ARM, 0.5, 30.0), ("a.eye", EYE, 0.5, 30.0)]
        self.core = RecordedCore(GuardCore(devices, clock, silence=SILENCE), clock, self.recorder)
        self.handle(inputs.BusOpened(""))

    @property
    def records(self):
        return [decode_record(record) for file in self.ring.files for record in SegmentReader(BytesIO(file))]

    def handle(self, event):
        return self.core.handle(event)

    def call(self, token, instruction, *arguments, device="a.arm", age=0.0):
        now = self.clock.monotonic()
        call = GuardCall(token, device, instruction, list(arguments), now - age, now - age + 0.5)
        return self.handle(inputs.CallReceived(call))


class RandomInputs:
    """Gives a guard the inputs of a shell and a driver, in a random order."""

    def __init__(self, seed, guard):
        self.rng, self.guard = random.Random(seed), guard
        self.token, self.started, self.unstarted = 0, [], []
        self.safe_commands, self.rest_checks = [], []

    def run(self, steps):
        for _ in range(steps):
            self.guard.clock.advance(self.rng.choice((0.0, 0.001, 0.05, 0.05, 0.3, 1.1)) * self.rng.random())
            self.on_effects(self.rng.choice(self.choices())())
        return self.guard

    def on_effects(self, effects):
        for effect in effects:
            match effect:
                case Execute(call):
                    self.unstarted.append(call)
                case Interrupt(token):
                    self.unstarted = [call for call in self.unstarted if call.token != token]
                case MakeSafe(device):
                    self.safe_commands.append(device)
                case CheckRest(device):
                    self.rest_checks.append(device)

    def choices(self):
        handle = self.guard.handle
        return [
            *[self.beat] * 6,
            *[self.call] * 4,
            *[self.start] * 3 * bool(self.unstarted),
            *[self.finish] * 3 * bool(self.started),
            *[lambda: handle(inputs.SafeStateReached(self.safe_commands.pop()))]
            * 2
            * bool(self.safe_commands),
            *[lambda: handle(inputs.SafeStateFailed(self.safe_commands.pop(), "no answer"))]
            * bool(self.safe_commands),
            *[self.report] * 3 * bool(self.rest_checks),
            lambda: handle(inputs.TimerExpired()),
            lambda: handle(inputs.CancelReceived(self.rng.randint(1, self.token + 1), self.sent())),
            lambda: handle(inputs.SafeStateRequested(*self.rng.choice(REQUESTS))),
            lambda: handle(inputs.StopCleared()),
            *[lambda: handle(inputs.StopRequested("the host is stopping"))] * (self.rng.random() < 0.05),
            *[lambda: handle(inputs.HostGone("the host is gone"))] * (self.rng.random() < 0.03),
        ]

    def sent(self):
        return self.guard.clock.monotonic() - self.rng.choice((0.0, 0.0001, 0.3))

    def beat(self):
        return self.guard.handle(inputs.HostBeat(self.sent()))

    def call(self):
        self.token += 1
        name, *arguments = self.rng.choice(CALLS)
        device = self.rng.choice(("a.arm", "a.arm", "a.eye", "b.no"))
        return self.guard.call(self.token, name, *arguments, device=device, age=self.rng.choice((0.0, 0.4)))

    def start(self):
        call = self.unstarted.pop(self.rng.randrange(len(self.unstarted)))
        if self.guard.core.start_call(call):
            return self.guard.handle(inputs.CallRefused(call.token, "DeviceException", "too late"))
        self.started.append(call.token)
        return []

    def finish(self):
        token = self.started.pop()
        return self.guard.handle(
            self.rng.choice(
                (
                    inputs.CallFinished(token, self.rng.choice((None, 1, 1.0, float("nan"), "text", [1, 2]))),
                    inputs.CallRefused(token, "DeviceException", "no"),
                    inputs.CallCrashed(token, "a fault of the driver"),
                )
            )
        )

    def report(self):
        return self.guard.handle(
            inputs.MotionReported(self.rest_checks.pop(), self.rng.choice(("", "it sinks")))
        )


CALLS = (("go", 1.0), ("steer", 0.5), ("grip",), ("ask",), ("release",), ("halt",), ("go",), ("fly",))
REQUESTS = (
    ("", "the host was silent"),
    ("a.arm", "an operator", True),
    ("a.arm", "a policy", False, "park"),
    ("a.eye", "lost"),
)
