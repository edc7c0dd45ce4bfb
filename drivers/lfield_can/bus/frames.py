"""CAN frames, and the interface for transports.

Independent of python-can.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

from msgspec import Struct

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


# -- interfaces ------------------------------------------------------------------------------------------

#: The reason why a failed interface did not send a frame.
BUS_LOST = "the bus is lost"


class Listener(Struct, frozen=True):
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
        """Closes the interface."""
