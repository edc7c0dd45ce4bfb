"""A CAN frame as the protocols see it, error frames in words, and what carries them.

Nothing here knows python-can.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

#: Set in the key of a frame with an extended id, so that 0x123 and 0x00000123 stay two ids.
EXTENDED = 1 << 31


#: Set in the key of a parameter group of SAE J1939, which no id of a frame has.
_GROUP = 1 << 30
#: Below this PDU format the next byte of an id is an address, and no part of the group (SAE J1939-21, 5.1.2).
_BROADCAST_FORMATS = 0xF0


class Frame(NamedTuple):
    """One data frame: an id of 11 bits, or of 29 when `extended`, and up to 8 bytes, or 64 when `fd`."""

    id: int
    data: bytes = b""
    extended: bool = False
    fd: bool = False

    @property
    def key(self) -> int:
        """What frames are dispatched by."""
        return self.id | EXTENDED if self.extended else self.id


def group_of(identifier: int) -> int:
    """The key of the J1939 parameter group of an id of 29 bits: without priority and addresses."""
    group = identifier >> 8 & 0x3FFFF
    if group >> 8 & 0xFF < _BROADCAST_FORMATS:
        group &= 0x3FF00
    return EXTENDED | _GROUP | group


#: Error classes in the id of an error frame (linux/can/error.h); what they say about the bus.
ERROR_CLASSES: Mapping[int, str] = {
    0x001: "no answer before the timeout",
    0x002: "lost arbitration",
    0x004: "controller trouble",
    0x008: "protocol violation",
    0x010: "transceiver trouble",
    0x020: "nobody acknowledged a frame",
    0x040: "bus off",
    0x080: "bus error",
    0x100: "controller restarted",
}
BUS_OFF = 0x040

#: The second byte of an error frame of class 0x004.
CONTROLLER: Mapping[int, str] = {
    0x01: "receive buffer full",
    0x02: "send buffer full",
    0x04: "many receive errors",
    0x08: "many send errors",
    0x10: "receives passively",
    0x20: "sends passively",
}


def error_words(identifier: int, data: bytes) -> str:
    """An error frame in words, as in `bus off` or `controller trouble (send buffer full)`."""
    words = []
    for bit, meaning in ERROR_CLASSES.items():
        if not identifier & bit:
            continue
        detail = data[1] if bit == 0x004 and len(data) > 1 else 0
        details = ", ".join(text for mask, text in CONTROLLER.items() if detail & mask)
        words.append(f"{meaning} ({details})" if details else meaning)
    return ", ".join(words) or "an error of no class"


# -- interfaces ------------------------------------------------------------------------------------------

#: Why a frame was not sent by an interface that has failed.
GONE = "the bus is lost"


@dataclass(frozen=True, slots=True)
class Listener:
    """What an interface calls, on the loop: with every data frame, with the id and data of every error frame,
    and once with the reason why the interface has failed."""

    frame: Callable[[Frame], None]
    error: Callable[[int, bytes], None]
    lost: Callable[[str], None]


class Interface(Protocol):
    """It works until its first failure; then it is closed and another one is opened.

    `malformed` counts what came in and was no frame.
    """

    malformed: int

    @property
    def off(self) -> bool:
        """Whether the interface itself says that its controller is off the bus."""

    async def send(self, frame: Frame) -> str:
        """Send a frame; '' once the interface has taken it, else the reason why it has not."""

    def post(self, frame: Frame) -> None:
        """Send a frame, or not; never waits."""

    async def close(self) -> None:
        """Give it back."""
