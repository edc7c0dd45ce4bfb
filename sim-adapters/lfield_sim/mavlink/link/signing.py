"""Message signing of a vehicle: verification, and signing of its own packets.

Rules: https://mavlink.io/en/guide/message_signing.html; measured on ArduPilot: untrusted messages are
silently ignored.
"""

from __future__ import annotations

import hashlib
import hmac
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import all as dialect

#: Bytes of a signature block: link id, timestamp (48 bits), signature (48 bits).
BLOCK, SIGNATURE = 13, 6
#: A new stream may be a minute behind; timestamps count units of 10 us.
BEHIND = 60 * 100_000
#: Stored streams (link, system, component) at most.
MAX_STREAMS = 64
#: Link id of the vehicle's own packets.
LINK_ID = 0
#: Timestamps per second, and the last one in 48 bits.
PER_SECOND, LATEST = 100_000, (1 << 48) - 1


class MessageSigning:
    """The key of a vehicle, its timestamp, and those of all received streams.

    It checks every message before it is handled, and signs before sending.

    `uptime` in seconds advances the timestamp. SETUP_SIGNING for another system is ignored, and needs a valid
    signature once there is a key; a zero key disables signing.
    """

    def __init__(self, system: int, uptime: Callable[[], float]) -> None:
        self.key: bytes | None = None
        self._system, self._uptime = system, uptime
        self._latest, self._since = 0, 0.0
        self._streams: OrderedDict[bytes, int] = OrderedDict()

    @property
    def timestamp(self) -> int:
        """The vehicle's timestamp, in 10 us since 1 January 2015."""
        return self._latest + int((self._uptime() - self._since) * PER_SECOND)

    def admits(self, message: Any, *, local: bool) -> bool:
        """Whether a message is accepted: signed by the key and new, or from the serial port."""
        accepted = self.key is None or local or self._is_signed(bytes(message.get_msgbuf()))
        setup = message.get_msgId() == dialect.MAVLINK_MSG_ID_SETUP_SIGNING
        if accepted and setup and message.target_system == self._system:
            self._set_up(message)
        return accepted

    def seal(self, packer: Any) -> None:
        """Signs the next packet of a pymavlink `MAVLink`, when there is a key."""
        signing = packer.signing
        signing.sign_outgoing, signing.secret_key = self.key is not None, self.key
        if self.key is not None:
            # Timestamps are unique: an equal one would be a replay.
            self._advance_to(self.timestamp + 1)
            signing.link_id, signing.timestamp = LINK_ID, self._latest

    def _advance_to(self, timestamp: int) -> None:
        self._latest, self._since = max(self.timestamp, timestamp), self._uptime()

    def _set_up(self, message: Any) -> None:
        key = bytes(message.secret_key)
        self.key = key if any(key) else None
        self._advance_to(min(message.initial_timestamp, LATEST))
        self._streams.clear()

    def _is_signed(self, packet: bytes) -> bool:
        assert self.key is not None
        if packet[0] != dialect.PROTOCOL_MARKER_V2 or not packet[2] & dialect.MAVLINK_IFLAG_SIGNED:
            return False
        expected = hashlib.sha256(self.key + packet[:-SIGNATURE]).digest()[:SIGNATURE]
        if not hmac.compare_digest(expected, packet[-SIGNATURE:]):
            return False
        stream = bytes((packet[-BLOCK], packet[5], packet[6]))
        timestamp = int.from_bytes(packet[1 - BLOCK : -SIGNATURE], "little")
        if timestamp <= self._streams.get(stream, self.timestamp - BEHIND - 1):
            return False
        self._remember(stream, timestamp)
        return True

    def _remember(self, stream: bytes, timestamp: int) -> None:
        self._streams[stream] = timestamp
        self._streams.move_to_end(stream)
        if len(self._streams) > MAX_STREAMS:
            self._streams.popitem(last=False)
        self._advance_to(timestamp)
