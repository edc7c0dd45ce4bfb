"""One CAN frame, its rank in arbitration and its time on the wire (ISO 11898-1)."""

from __future__ import annotations

from dataclasses import dataclass

#: The lengths that a CAN FD frame can have, by data length code.
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
STANDARD_MASK, EXTENDED_MASK = 0x7FF, 0x1FFFFFFF

#: Error frames carry, as in Linux's can/error.h, what happened in their identifier.
ERROR_PROTOCOL, ERROR_BUS_OFF = 0x20000088, 0x20000040


@dataclass(frozen=True, slots=True)
class Frame:
    """A data, remote or error frame. `dlc` is that of remote frames; `switch` the FD bit rate switch."""

    identifier: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False
    dlc: int = 0
    fd: bool = False
    switch: bool = False
    error: bool = False

    @property
    def rank(self) -> tuple[int, bool, int, bool]:
        """Of frames that start together the lowest wins: standard before extended, data before remote."""
        if self.extended:
            return self.identifier >> 18, True, self.identifier & 0x3FFFF, self.remote
        return self.identifier, False, 0, self.remote

    def seconds(self, bitrate: float, data_bitrate: float) -> float:
        """The time on the wire, interframe space included, stuff bits not."""
        head = 67 if self.extended else 47
        if not self.fd:
            return (head + 8 * len(self.data)) / bitrate
        fast = data_bitrate if self.switch else bitrate
        return (head - 15) / bitrate + (8 * len(self.data) + 26) / fast
