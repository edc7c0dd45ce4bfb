"""A guard's core with its clock, and the effects of its answers."""

from __future__ import annotations

from lfield.clock import ManualClock
from lfield.guard.core import GuardCore
from lfield.guard.effects import CheckRest, Exit, MakeSafe, Mute, Notify
from lfield.guard.messages import GuardCall
from lfield.manifest import NEVER, DeviceManifest, Instruction, Parameter

TTL, SILENCE, WITHIN = 0.5, 0.2, 120.0

MANIFEST = DeviceManifest(
    "Thing",
    "thing",
    (
        Instruction("go", (Parameter("x", "real"),), blocking=True, cancel="halt"),
        Instruction("steer", (Parameter("x", "real"),)),
        Instruction("grip", (), blocking=True, channel="gripper"),
        Instruction("ask", (), "int", effect="query", blocking=True),
        Instruction("release", effect="idempotent", blocking=True),
        Instruction("halt", effect="idempotent", blocking=True, cancel=NEVER),
    ),
    safe_states=("stop",),
)


class Rig:
    """A core with its clock; `wait` sends a heartbeat in each step unless `beating` is false."""

    def __init__(self, *devices: str) -> None:
        self.clock = ManualClock()
        bindings = [(d, MANIFEST, TTL, WITHIN) for d in devices or ("a",)]
        self.core = GuardCore(bindings, self.clock, silence=SILENCE)
        self.core.on_opened("")
        self.token = 0

    def beat(self):
        return self.core.on_beat(self.clock.monotonic())

    def wait(self, seconds: float, *, beating: bool = True):
        effects = []
        for _ in range(round(seconds / 0.05)):
            self.clock.advance(0.05)
            effects += self.beat() if beating else self.core.tick()
        return effects

    def call(self, instruction: str, *arguments: float, device: str = "a", age: float = 0.0):
        self.token += 1
        sent = self.clock.monotonic() - age
        return self.core.on_call(
            GuardCall(self.token, device, instruction, list(arguments), sent, sent + TTL)
        )


def effects_of(effects, kind):
    return [e for e in effects if isinstance(e, kind)]


def messages(effects, kind):
    return [e.message for e in effects_of(effects, Notify) if isinstance(e.message, kind)]


def made_safe(effects):
    return [e.device for e in effects_of(effects, MakeSafe)]


def mutes(effects):
    return [e.on for e in effects_of(effects, Mute)]


def rest_checks(effects):
    return [e.device for e in effects_of(effects, CheckRest)]


def exits(effects):
    return [e.status for e in effects_of(effects, Exit)]
