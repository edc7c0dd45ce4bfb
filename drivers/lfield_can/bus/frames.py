"""CAN frames, error frames in words, and the interface for transports.

Independent of python-can.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

#: Flag in the key of a frame with an extended id: 0x123 and 0x00000123 are different ids.
EXTENDED = 1 << 31


#: Flag in the key of a parameter group of SAE J1939; not part of any frame id.
_GROUP = 1 << 30
#: Below this PDU format the next byte of an id is an address, not part of the group (SAE J1939-21, 5.1.2).
_BROADCAST_FORMATS = 0xF0


class Frame(NamedTuple):
    """A data frame: an 11-bit id, or 29-bit when `extended`, and up to 8 bytes, or 64 when `fd`; with
    `switch`, its data are at the second bit rate.
    """

    id: int
    data: bytes = b""
    extended: bool = False
    fd: bool = False
    switch: bool = False

    @property
    def key(self) -> int:
        """The key for dispatching."""
        return self.id | EXTENDED if self.extended else self.id


def group_of(identifier: int) -> int:
    """The key of the J1939 parameter group of a 29-bit id: without priority and addresses."""
    group = identifier >> 8 & 0x3FFFF
    if group >> 8 & 0xFF < _BROADCAST_FORMATS:
        group &= 0x3FF00
    return EXTENDED | _GROUP | group


#: Error classes in the id of an error frame (linux/can/error.h), and their meaning.
ERROR_CLASSES: Mapping[int, str] = {
    0x001: "no answer before the timeout",
    0x002: "lost arbitration",
    0x004: "controller trouble",
    0x008: "protocol violation",
    0x010: "transceiver trouble",
    0x020: "no acknowledgement of a frame",
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


def error_text(identifier: int, data: bytes) -> str:
    """Describes an error frame, such as `bus off` or `controller trouble (send buffer full)`."""
    parts = []
    for bit, meaning in ERROR_CLASSES.items():
        if not identifier & bit:
            continue
        detail = data[1] if bit == 0x004 and len(data) > 1 else 0
        details = ", ".join(text for mask, text in CONTROLLER.items() if detail & mask)
        parts.append(f"{meaning} ({details})" if details else meaning)
    return ", ".join(parts) or "an error of unknown class"


# -- interfaces ------------------------------------------------------------------------------------------

#: Why a failed interface did not send a frame.
BUS_LOST = "the bus is lost"


@dataclass(frozen=True, slots=True)
class Listener:
    """Callbacks of an interface, on the loop: for every data frame, for the id and data of every error frame,
    and once for the reason of a failure.
    """

    frame: Callable[[Frame], None]
    error: Callable[[int, bytes], None]
    lost: Callable[[str], None]


class Interface(Protocol):
    """A transport that works until its first failure; then it is closed and another one is opened.

    `malformed` counts invalid frames.
    """

    malformed: int

    @property
    def is_off(self) -> bool:
        """Whether the interface reports bus off."""

    async def send(self, frame: Frame) -> str:
        """Sends a frame; '' when the interface has accepted it, else the reason for a failure."""

    def post(self, frame: Frame) -> None:
        """Queues a frame; never waits."""

    async def close(self) -> None:
        """Closes it."""
