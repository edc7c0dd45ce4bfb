"""What host and guard say to each other over the guard's stdin and stdout.

A frame per message (lfield.wire.framing); the kind is the message, the payload its fields as MessagePack.
Both ends are on one machine and share its monotonic clock, so `sent` and `until` can be compared with the
time of arrival: an old message that was stuck in the pipe is known as old, and so is telemetry. A value has
its L type only after `lfield.driver.values.conform`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import msgspec

from lfield.driver.binding import DeviceBinding
from lfield.driver.known import KnownDriver
from lfield.errors import WireError
from lfield.manifest import DeviceValue, Observation
from lfield.wire.framing import FrameDecoder, frame

#: The L exception of a call that was cancelled.
CANCELLED = "CancelledException"


class Message(msgspec.Struct, frozen=True, array_like=True):
    """Base of all messages."""


class Open(Message, frozen=True):
    """Host: open these devices, all on one bus. `latched` tells why they must come back safe, or ''.

    `silence` is how long the host may be silent, in seconds, before every device goes safe. `driver` has the
    manifests of the devices: the guard reads none, and refuses when the driver that it runs has others. With
    `latched`, `taken` has the devices that somebody else had when the guard before this one died.
    """

    devices: list[DeviceBinding]
    latched: str
    silence: float
    driver: KnownDriver
    taken: list[str] = []


class Call(Message, frozen=True):
    """Host: carry out one instruction; the answer is Done or Refused with the same token.

    What acts begins before `until`, or not at all.
    """

    token: int
    device: str
    instruction: str
    arguments: list[DeviceValue]
    sent: float
    until: float


class Cancel(Message, frozen=True):
    """Host: give up the call of this token, as the manifest says of a cancel.

    The answer is that of the call: Refused with the kind CANCELLED, or Done when that was on its way already.
    """

    token: int
    sent: float


class Beat(Message, frozen=True):
    """Either side: I am alive, as of `sent`."""

    sent: float


class Safe(Message, frozen=True):
    """Host: bring the device ('' for all) into its safe state, now.

    `state` is another one of its manifest than that of its binding. When it is `barred`, the program cannot
    release it until an Allow has come.
    """

    device: str
    reason: str
    barred: bool = False
    state: str = ""


class Stop(Message, frozen=True):
    """Host: make everything safe and end when it is at rest, or `at_once`."""

    reason: str
    at_once: bool = False


class Ready(Message, frozen=True):
    """Guard: the bus is open; who the devices are, by name."""

    identities: dict[str, str]


class Failed(Message, frozen=True):
    """Guard: it cannot be opened, and the guard ends. `problems` are (device or '', kind, reason)."""

    problems: list[tuple[str, str, str]]


class Done(Message, frozen=True):
    """Guard: a call has been carried out."""

    token: int
    value: DeviceValue


class Refused(Message, frozen=True):
    """Guard: a call failed; `kind` is the L exception it becomes."""

    token: int
    kind: str
    reason: str


class Snapshot(Message, frozen=True):
    """Guard: telemetry of one device, by quantity, and when the device itself was last heard.

    `taken` says that somebody else has it, such as a pilot.
    """

    device: str
    values: Mapping[str, Observation]
    heard: float
    taken: bool = False


class Latched(Message, frozen=True):
    """Guard: the device is held in its safe state because of `reason`; `confirmed` once seen to be there.

    `state` is '' for that of its binding.
    """

    device: str
    reason: str
    confirmed: bool
    state: str = ""


class Released(Message, frozen=True):
    """Guard: the device answers to calls again."""

    device: str


class Note(Message, frozen=True):
    """Guard: one sentence for the log."""

    device: str
    text: str


class Stopped(Message, frozen=True):
    """Guard: the last message; `unsafe` has the devices that were not seen at rest in their safe states.

    Each with what is known of it.
    """

    unsafe: dict[str, str]


class Allow(Message, frozen=True):
    """Host: the program may release its devices again."""


class LockedOut(Message, frozen=True):
    """Guard: the driver requires an inspection: no program may release the device before an Allow."""

    device: str
    reason: str


class Moving(Message, frozen=True):
    """Guard: what a device still does in its safe state, which is confirmed; '' when it is at rest."""

    device: str
    moving: str


#: The kind byte of each message. Order is the protocol: add at the end.
MESSAGES: tuple[type[Message], ...] = (
    Open,
    Call,
    Beat,
    Safe,
    Stop,
    Ready,
    Failed,
    Done,
    Refused,
    Snapshot,
    Latched,
    Released,
    Note,
    Stopped,
    Allow,
    Moving,
    Cancel,
    LockedOut,
)

MAX_PAYLOAD = 1 << 20

_KINDS = {message: kind for kind, message in enumerate(MESSAGES)}
_ENCODER = msgspec.msgpack.Encoder()
_DECODERS = [msgspec.msgpack.Decoder(message) for message in MESSAGES]
_LIMITS = dict.fromkeys(range(len(MESSAGES)), MAX_PAYLOAD)


def encode(message: Message) -> bytes:
    """One message as one frame."""
    return frame(_KINDS[type(message)], _ENCODER.encode(message))


class MessageReader:
    """Bytes of a pipe to messages."""

    def __init__(self) -> None:
        self._frames = FrameDecoder(_LIMITS)

    def feed(self, data: bytes) -> Iterator[Message]:
        """The messages that these bytes complete. Raises WireError where they make no sense."""
        for kind, payload in self._frames.feed(data):
            try:
                yield _DECODERS[kind].decode(payload)
            except (msgspec.DecodeError, UnicodeDecodeError) as error:
                raise WireError(f"not a message of kind {kind}: {error}") from None


def host_silent(silence: float) -> str:
    """Why a device goes safe whose host has been silent for so many seconds."""
    return f"the host was silent for over {silence * 1000:.0f} ms"


def last_words(message: Message) -> str:
    """What a guard whose host is gone has to say to whoever reads its log; '' when it is nothing."""
    match message:
        case Latched(device, reason, True):
            return f"{device}: is in its safe state: {reason}"
        case Stopped(unsafe):
            return "\n".join(f"{device}: NOT SAFE: {why}" for device, why in unsafe.items())
        case Note(device, text):
            return f"{device}: {text}"
    return ""
