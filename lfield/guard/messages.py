"""Protocol between host and guard over the guard's stdin and stdout.

One frame per message (lfield.wire.framing): the kind is the message, the payload its fields as MessagePack.
Both ends share the machine's monotonic clock, so `sent` and `until` are compared with the time of arrival;
this detects messages delayed in the pipe. Values get their L types in `lfield.driver.value_types.conform`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping, Sequence

import msgspec

from lfield.clock import Clock
from lfield.driver.binding import DeviceBinding
from lfield.driver.driver_index import DriverInfo
from lfield.errors import WireError
from lfield.manifest import DeviceValue, Observation
from lfield.text import log_messages
from lfield.text.log_messages import Level, LogLine, json_line, report_line
from lfield.wire.framing import FrameDecoder, frame

#: Environment variable of a host's process: the name of the host, if its guards must log JSON lines.
JSON_LOG_HOST = "LFIELD_GUARD_JSON_LOG"
#: The L exception of a cancelled call.
CANCELLED = "CancelledException"


class GuardMessage(msgspec.Struct, frozen=True, array_like=True):
    """Base class of all messages."""


class GuardRecording(msgspec.Struct, frozen=True, array_like=True):
    """The recording of a guard, in its folder, '' for none; at most `limit` bytes together.

    `run` is the id of the run, '' if it has none.
    """

    folder: str = ""
    limit: int = 0
    run: str = ""


NO_RECORDING = GuardRecording()


class OpenDevices(GuardMessage, frozen=True):
    """Host: opens these devices, all on one bus. `latched` is the reason why they must start in their safe
    states, or ''.

    `silence` is the host time-out in seconds, after which every device is made safe. `driver` contains the
    manifests; the guard reads no manifest, and refuses if the installed driver has other ones. With
    `latched`, `foreign_controlled` lists the devices that were under foreign control when the previous guard
    died. The folder of `recording` exists.
    """

    devices: list[DeviceBinding]
    latched: str
    silence: float
    driver: DriverInfo
    foreign_controlled: list[str] = []
    recording: GuardRecording = NO_RECORDING


class GuardCall(GuardMessage, frozen=True):
    """Host: executes one instruction; answered by CallDone or Refused with the same token.

    An instruction that acts starts before `until` or not at all.
    """

    token: int
    device: str
    instruction: str
    arguments: list[DeviceValue]
    sent: float
    until: float

    def refusal(self, reason: str) -> Refused:
        """The answer that refuses this call."""
        return Refused(self.token, "DeviceException", reason)


class CancelInstruction(GuardMessage, frozen=True):
    """Host: cancels the call of this token, as its manifest defines.

    The answer is that of the call: Refused of kind CANCELLED, or CallDone if it was already sent.
    """

    token: int
    sent: float


class Beat(GuardMessage, frozen=True):
    """Heartbeat in both directions, sent at `sent`."""

    sent: float


class RequestSafeState(GuardMessage, frozen=True):
    """Host: brings the device ('' for all) into its safe state immediately.

    `state` selects a safe state other than that of its binding. With `lock` the program cannot release it
    before ClearStop.
    """

    device: str
    reason: str
    lock: bool = False
    state: str = ""


class Stop(GuardMessage, frozen=True):
    """Host: makes all devices safe and ends when they are at rest, or `at_once`."""

    reason: str
    at_once: bool = False


class DevicesOpened(GuardMessage, frozen=True):
    """Guard: the bus is open; identities of the devices by name.

    `actions`: the action of a device in a safe state, if it differs from the name of the state.
    """

    identities: dict[str, str]
    actions: dict[str, dict[str, str]] = {}


class OpenFailed(GuardMessage, frozen=True):
    """Guard: opening has failed and the guard ends. `problems` are (device or '', kind, reason)."""

    problems: list[tuple[str, str, str]]


class CallDone(GuardMessage, frozen=True):
    """Guard: a call was executed."""

    token: int
    value: DeviceValue


class Refused(GuardMessage, frozen=True):
    """Guard: a call failed; `kind` is the L exception."""

    token: int
    kind: str
    reason: str


class TelemetrySnapshot(GuardMessage, frozen=True):
    """Guard: telemetry of one device by quantity, and the time when the device itself last sent a message.

    `is_foreign_controlled`: a pilot or another station controls it.
    """

    device: str
    values: Mapping[str, Observation]
    last_contact: float
    is_foreign_controlled: bool = False


class Latched(GuardMessage, frozen=True):
    """Guard: the device is held in its safe state because of `reason`; `confirmed` when the state is
    confirmed.

    `state` is '' for the one of its binding.
    """

    device: str
    reason: str
    confirmed: bool
    state: str = ""


class Released(GuardMessage, frozen=True):
    """Guard: the device accepts calls again."""

    device: str


class Note(GuardMessage, frozen=True):
    """Guard: a log line, with the code and level of its `LogMessage`; `code` is '' for a plain sentence."""

    device: str
    text: str
    code: str = ""
    level: Level = "info"


class Stopped(GuardMessage, frozen=True):
    """Guard: the last message; `unsafe` has the devices that were not confirmed at rest in their safe states,
    with their last known condition.
    """

    unsafe: dict[str, str]


class ClearStop(GuardMessage, frozen=True):
    """Host: the program may release its devices again."""


class LockedOut(GuardMessage, frozen=True):
    """Guard: the driver requires an inspection: no program may release the device before ClearStop."""

    device: str
    reason: str


class Moving(GuardMessage, frozen=True):
    """Guard: the remaining motion of a device in its confirmed safe state; '' when it is at rest."""

    device: str
    moving: str


#: The kind byte of each message. The order is the protocol: append only.
MESSAGES: tuple[type[GuardMessage], ...] = (
    OpenDevices,
    GuardCall,
    Beat,
    RequestSafeState,
    Stop,
    DevicesOpened,
    OpenFailed,
    CallDone,
    Refused,
    TelemetrySnapshot,
    Latched,
    Released,
    Note,
    Stopped,
    ClearStop,
    Moving,
    CancelInstruction,
    LockedOut,
)

MAX_PAYLOAD = 1 << 20

_KINDS = {message: kind for kind, message in enumerate(MESSAGES)}
_ENCODER = msgspec.msgpack.Encoder()
_DECODERS = [msgspec.msgpack.Decoder(message) for message in MESSAGES]
_LIMITS = dict.fromkeys(range(len(MESSAGES)), MAX_PAYLOAD)


def encode(message: GuardMessage) -> bytes:
    """One message as one frame."""
    return frame(_KINDS[type(message)], _ENCODER.encode(message))


class MessageReader:
    """Decodes the bytes of a pipe into messages."""

    def __init__(self) -> None:
        self._frames = FrameDecoder(_LIMITS)

    def feed(self, data: bytes) -> Iterator[GuardMessage]:
        """The messages that these bytes complete. Raises WireError for invalid bytes."""
        for kind, payload in self._frames.feed(data):
            try:
                yield _DECODERS[kind].decode(payload)
            except (msgspec.DecodeError, UnicodeDecodeError) as error:
                raise WireError(f"not a message of kind {kind}: {error}") from None


def host_silent(silence: float) -> str:
    """The reason for making a device safe after this silence (s) of its host."""
    return f"the host was silent for over {silence * 1000:.0f} ms"


class OrphanLog:
    """The log of a guard whose host has ended, on stderr; JSON lines where JSON_LOG_HOST names the host."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._safe_states: dict[str, str] = {}

    def on_opening(self, devices: Sequence[DeviceBinding]) -> None:
        """The devices that are opened, with the safe states of their bindings."""
        self._safe_states = {device.name: device.safe_state for device in devices}

    def write(self, message: GuardMessage) -> None:
        """Log a message that the host cannot receive."""
        host = os.environ.get(JSON_LOG_HOST, "")
        for line in self.lines(message):
            text = json_line(self._clock.time(), host, line) if host else f"{line}\n"
            sys.stderr.write(text)
            sys.stderr.flush()

    def lines(self, message: GuardMessage) -> list[LogLine]:
        """The log lines, as a host would write them; none for messages that need no line."""
        match message:
            case Latched(device, reason, True, state):
                state = state or self._safe_states.get(device, "")
                return [log_messages.DEVICE_SAFE.line(device=device, state=state, reason=reason)]
            case Stopped(unsafe):
                return [
                    log_messages.DEVICE_NOT_SAFE.line(device=device, reason=condition)
                    for device, condition in unsafe.items()
                ]
            case Note(device, text, code, level):
                return [report_line(device, text, code, level)]
        return []
