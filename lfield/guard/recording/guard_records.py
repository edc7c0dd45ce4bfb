"""The records of a guard's ring: MessagePack arrays, each in one frame of a segment.

A segment starts with a SegmentStart, which contains the state of the core: each segment can be replayed
without the earlier ones. Then follow the inputs with the decisions of the core, and telemetry. All times are
seconds of the guard's monotonic clock; SegmentStart relates them to the wall clock.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
from msgspec import Struct

from lfield.driver.binding import DeviceBinding
from lfield.driver.driver_index import DriverInfo
from lfield.guard.effects import Abandon, CheckRest, Effect, Execute, Exit, Interrupt, MakeSafe, Mute, Notify
from lfield.guard.guard_device import CoreState
from lfield.guard.messages import MESSAGES, CallDone, GuardCall
from lfield.guard.recording.guard_inputs import CallStarting, GuardInput
from lfield.manifest import DeviceValue
from lfield.recording.segments import frame

#: Kinds of decisions from this number on are messages to the host, by their position in MESSAGES.
NOTIFY = 16
#: The names of the other kinds.
KINDS = ("Execute", "Interrupt", "MakeSafe", "Abandon", "CheckRest", "Mute", "Exit")
#: A user and password in an endpoint, and the parameters after the address.
_CREDENTIALS, _PARAMETERS = re.compile(r"(?<=[/:])[^/@]+@(?=[^/@]+$)"), re.compile(r"\?.*")


class RecordedDevice(Struct, frozen=True, array_like=True):
    """A device of a recording: its binding without text options, which may be secret.

    `manifest` is the SHA-256 of its manifest file.
    """

    name: str
    type: str
    driver: str
    manifest: bytes
    endpoint: str
    safe_state: str
    limits: dict[str, float]
    options: dict[str, bool | int | float]
    waivers: list[str]


class SegmentStart(Struct, frozen=True, array_like=True, tag=0):
    """The first record of each segment: the recorded devices, and the state before the following records.

    `guard` distinguishes the processes that have written into one ring; `number` counts the segments of one
    process, from 0. `unstarted` are accepted calls that the driver has not started. `values` are the last
    recorded values of each device, by its position in `devices` and the position of the quantity in its
    manifest.
    """

    lfield: str
    host: str
    incarnation: str
    run: str
    guard: str
    number: int
    wall_time: float
    monotonic: float
    silence: float
    devices: list[RecordedDevice]
    state: CoreState
    unstarted: list[GuardCall]
    values: list[dict[int, DeviceValue]]


class InputRecord(Struct, frozen=True, array_like=True, tag=1):
    """An input, and the decisions of the core (`decisions_of`, or the text for CallStarting)."""

    time: float
    input: GuardInput | CallStarting
    decisions: msgspec.Raw = msgspec.Raw(b"\x90")


class Pulses(Struct, frozen=True, array_like=True, tag=2):
    """Heartbeats and expired timers without decisions; see `heartbeat_pulses`."""

    start: float
    steps: list[int]


class TelemetryRecord(Struct, frozen=True, array_like=True, tag=3):
    """The changed telemetry quantities of a device, by the positions in `SegmentStart.values`."""

    time: float
    device: int
    values: dict[int, DeviceValue]


class ControlRecord(Struct, frozen=True, array_like=True, tag=4):
    """Whether a device came under foreign control, such as a pilot's."""

    time: float
    device: int
    is_foreign: bool


class NoteRecord(Struct, frozen=True, array_like=True, tag=5):
    """A log line of the driver or the guard."""

    time: float
    device: str
    text: str
    code: str
    level: str


GuardRecord = SegmentStart | InputRecord | Pulses | TelemetryRecord | ControlRecord | NoteRecord

_ENCODER = msgspec.msgpack.Encoder()
_DECODER = msgspec.msgpack.Decoder(GuardRecord)


def framed(record: GuardRecord) -> bytes:
    """A record as one frame of a segment."""
    return frame(_ENCODER.encode(record))


def decode_record(data: bytes) -> GuardRecord:
    """The record of one frame. Raises msgspec.MsgspecError."""
    record: GuardRecord = _DECODER.decode(data)
    return record


def encode_state(state: CoreState) -> bytes:
    """A state as bytes, equal for equal states."""
    return _ENCODER.encode(state)


def copy_state(state: CoreState) -> CoreState:
    """A copy of a state that shares no data with the original."""
    return msgspec.msgpack.decode(_ENCODER.encode(state), type=CoreState)


# -- decisions -----------------------------------------------------------------------------------------------


def decisions_of(effects: Sequence[Effect]) -> msgspec.Raw:
    """The effects of one input as MessagePack: a list of [kind, fields...].

    Arguments and results of calls are omitted: the inputs contain them.
    """
    return msgspec.Raw(_ENCODER.encode([_decision(effect) for effect in effects]))


def decision_text(decisions: bytes | msgspec.Raw) -> str:
    """Encoded decisions, readable: `Execute(7), Latched(alpha.fc, the host is gone, False)`."""
    decoded = msgspec.msgpack.decode(decisions)
    if isinstance(decoded, str):
        return decoded or "start"
    try:
        return ", ".join(_text(*decision) for decision in decoded) or "nothing"
    except (LookupError, TypeError):  # a damaged recording
        return f"no decisions: {decoded!r}"


def _decision(effect: Effect) -> Sequence[object]:
    match effect:
        case Execute(call) if call.token >= 0:
            return 0, call.token
        case Execute(call):  # The end of a cancelled call is no input.
            return 0, call.token, call.device, call.instruction
        case Interrupt(token):
            return 1, token
        case MakeSafe(device, state):
            return 2, device, state
        case Abandon(device):
            return 3, device
        case CheckRest(device):
            return 4, device
        case Mute(on):
            return 5, on
        case Exit(status):
            return 6, status
        case Notify(CallDone(token)):
            return NOTIFY + MESSAGES.index(CallDone), token
        case Notify(message):
            return NOTIFY + MESSAGES.index(type(message)), *msgspec.structs.astuple(message)


def _text(kind: int, *fields: Any) -> str:
    name = KINDS[kind] if kind < NOTIFY else MESSAGES[kind - NOTIFY].__name__
    return f"{name}({', '.join(map(str, fields))})"


# -- devices -------------------------------------------------------------------------------------------------


def recorded_device(binding: DeviceBinding, driver: DriverInfo) -> RecordedDevice:
    """A binding without data that may be secret."""
    options = {
        name: value for name, value in binding.options.items() if isinstance(value, bool | int | float)
    }
    digest = driver.files[binding.type].digest if binding.type in driver.files else b""
    kinds = binding.type, binding.driver, digest, public_endpoint(binding.endpoint), binding.safe_state
    return RecordedDevice(binding.name, *kinds, binding.limits, options, binding.waivers)


def public_endpoint(endpoint: str) -> str:
    """An endpoint without user names, passwords and parameters."""
    links = (_PARAMETERS.sub("", link) for link in endpoint.split(","))
    return ",".join(
        link if link.partition(":")[2].startswith("/dev/") else _CREDENTIALS.sub("", link) for link in links
    )


def changed_values(
    before: Mapping[int, DeviceValue], values: Mapping[int, DeviceValue]
) -> dict[int, DeviceValue]:
    """The values that differ from earlier ones; a NaN is equal to a NaN."""
    return {at: value for at, value in values.items() if not _is_same(before.get(at, ...), value)}


def _is_same(value: object, other: object) -> bool:
    return type(value) is type(other) and (value == other or (value != value and other != other))
