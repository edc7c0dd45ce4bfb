"""Received packets of a numbered stream: the packets that are not read yet, and the packets after a gap."""

from __future__ import annotations

from collections import deque
from enum import Enum, auto
from typing import TYPE_CHECKING

from lfield.net.zenoh.send_window import MAX_SEGMENT, MAX_WINDOW

if TYPE_CHECKING:
    from lfield.net.zenoh.packets import Packet

#: The number of packets that may be in transit or unread, which are therefore kept ahead of a missing one;
#: and their bytes.
MAX_AHEAD, MAX_BYTES = 1024, MAX_WINDOW + MAX_SEGMENT


class Arrival(Enum):
    """The kind of a received packet: the expected one, the one that closed a gap, any other one, or one
    beyond the limit.
    """

    EXPECTED = auto()
    CLOSED_GAP = auto()
    OUT_OF_ORDER = auto()
    EXCESS = auto()


class ReceiveBuffer:
    """The receiving side of a stream. Sans-IO."""

    def __init__(self) -> None:
        #: Number of the next packet to receive.
        self.expected = 0
        self._ahead: dict[int, Packet] = {}
        self._ahead_size = 0
        self._unread: deque[Packet] = deque()
        self._unread_size = 0

    @property
    def unread(self) -> int:
        """The number of packets that were received in order and not read."""
        return len(self._unread)

    @property
    def size(self) -> int:
        """Bytes of all packets that are kept."""
        return self._ahead_size + self._unread_size

    def add(self, packet: Packet) -> Arrival:
        """Keep a numbered packet, unless it is a repetition or too far ahead."""
        if packet.number != self.expected:
            is_ahead = 0 < packet.number - self.expected < MAX_AHEAD and packet.number not in self._ahead
            if is_ahead and self._ahead_size + len(packet.data) <= MAX_BYTES:
                self._ahead[packet.number] = packet
                self._ahead_size += len(packet.data)
            return Arrival.OUT_OF_ORDER
        was_gap = bool(self._ahead)
        self._receive(packet)
        while (following := self._ahead.pop(self.expected, None)) is not None:
            self._ahead_size -= len(following.data)
            self._receive(following)
        if self._unread_size > MAX_BYTES or len(self._unread) > MAX_AHEAD:
            return Arrival.EXCESS
        return Arrival.CLOSED_GAP if was_gap else Arrival.EXPECTED

    def _receive(self, packet: Packet) -> None:
        self.expected += 1
        self._unread.append(packet)
        self._unread_size += len(packet.data)

    def read(self) -> Packet | None:
        """The next packet in order; None without one."""
        if not self._unread:
            return None
        packet = self._unread.popleft()
        self._unread_size -= len(packet.data)
        return packet

    def clear(self) -> None:
        """Forget all packets."""
        self._ahead.clear()
        self._unread.clear()
        self._ahead_size = self._unread_size = 0
