"""The inputs of a GuardCore as data, so that a guard and a replay apply the same inputs."""

from __future__ import annotations

from msgspec import Struct

from lfield.guard.core import GuardCore
from lfield.guard.effects import Effect
from lfield.guard.messages import (
    Beat,
    CancelInstruction,
    ClearStop,
    GuardCall,
    GuardMessage,
    RequestSafeState,
    Stop,
)
from lfield.manifest import DeviceValue


class BusOpened(Struct, frozen=True, array_like=True, tag=0):
    """The devices are open; with a reason in `latched` they start latched."""

    latched: str


class HostBeat(Struct, frozen=True, array_like=True, tag=1):
    """A heartbeat of the host, sent at `sent`."""

    sent: float


class CallReceived(Struct, frozen=True, array_like=True, tag=2):
    """A call of the program."""

    call: GuardCall


class CancelReceived(Struct, frozen=True, array_like=True, tag=3):
    """The host cancels a call."""

    token: int
    sent: float


class CallFinished(Struct, frozen=True, array_like=True, tag=4):
    """The driver has executed a call."""

    token: int
    value: DeviceValue


class CallRefused(Struct, frozen=True, array_like=True, tag=5):
    """The device refused a call; `kind` is the L exception."""

    token: int
    kind: str
    reason: str


class CallCrashed(Struct, frozen=True, array_like=True, tag=6):
    """The driver raised an unexpected exception in a call."""

    token: int
    reason: str


class SafeStateRequested(Struct, frozen=True, array_like=True, tag=7):
    """The host or the driver requests a safe state of a device, or of all ('')."""

    device: str
    reason: str
    lock: bool = False
    state: str = ""


class StopCleared(Struct, frozen=True, array_like=True, tag=8):
    """The emergency is over."""


class SafeStateReached(Struct, frozen=True, array_like=True, tag=9):
    """The driver has confirmed the safe state of a device."""

    device: str


class SafeStateFailed(Struct, frozen=True, array_like=True, tag=10):
    """The driver could not bring a device into its safe state."""

    device: str
    reason: str


class MotionReported(Struct, frozen=True, array_like=True, tag=11):
    """The driver reports how a device still moves in its safe state; '' when it is at rest."""

    device: str
    moving: str


class StopRequested(Struct, frozen=True, array_like=True, tag=12):
    """The host stops."""

    reason: str
    at_once: bool = False


class HostGone(Struct, frozen=True, array_like=True, tag=13):
    """The host has ended."""

    reason: str


class TimerExpired(Struct, frozen=True, array_like=True, tag=14):
    """A deadline of the core is due."""


class CallStarting(Struct, frozen=True, array_like=True, tag=15):
    """The driver starts an accepted call, unless it is too late; this decision is a text."""

    token: int


#: The inputs to which the core responds with effects.
GuardInput = (
    BusOpened
    | HostBeat
    | CallReceived
    | CancelReceived
    | CallFinished
    | CallRefused
    | CallCrashed
    | SafeStateRequested
    | StopCleared
    | SafeStateReached
    | SafeStateFailed
    | MotionReported
    | StopRequested
    | HostGone
    | TimerExpired
)


def input_of(message: GuardMessage) -> GuardInput | None:
    """The input for a message of the host; None for messages that no core receives."""
    match message:
        case Beat(sent):
            return HostBeat(sent)
        case GuardCall():
            return CallReceived(message)
        case CancelInstruction(token, sent):
            return CancelReceived(token, sent)
        case RequestSafeState(device, reason, lock, state):
            return SafeStateRequested(device, reason, lock, state)
        case ClearStop():
            return StopCleared()
        case Stop(reason, at_once):
            return StopRequested(reason, at_once)
    return None


def apply_input(core: GuardCore, event: GuardInput) -> list[Effect]:
    """Passes an input to the core; returns its decisions."""
    match event:
        case HostBeat(sent):
            return core.on_beat(sent)
        case TimerExpired():
            return core.tick()
        case CallReceived(call):
            return core.on_call(call)
        case CallFinished(token, value):
            return core.on_finished(token, value)
        case CancelReceived(token, sent):
            return core.on_cancel(token, sent)
        case CallRefused(token, kind, reason):
            return core.on_refused(token, kind, reason)
        case CallCrashed(token, reason):
            return core.on_crashed(token, reason)
        case SafeStateRequested(device, reason, lock, state):
            return core.latch(device, reason, lock=lock, state=state)
        case StopCleared():
            return core.clear_stop()
        case SafeStateReached(device):
            return core.on_safe(device)
        case SafeStateFailed(device, reason):
            return core.on_safe_failed(device, reason)
        case MotionReported(device, moving):
            return core.on_motion_report(device, moving)
        case StopRequested(reason, at_once):
            return core.on_stop(reason, at_once=at_once)
        case HostGone(reason):
            return core.on_host_gone(reason)
        case BusOpened(latched):
            return core.on_opened(latched)
