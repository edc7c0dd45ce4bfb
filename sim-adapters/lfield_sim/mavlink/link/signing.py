"""Message signing: who may speak to the vehicle, and the seal of its own packets.

Rules: https://mavlink.io/en/guide/message_signing.html; what an autopilot does with what it does not trust
was measured on ArduPilot: nothing, without a word.
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
#: A stream that is new may be a minute behind; timestamps count units of 10 us.
BEHIND = 60 * 100_000
#: So many streams (link, system, component) are remembered at most.
MAX_STREAMS = 64
#: Of what the vehicle itself sends.
LINK_ID = 0
#: Timestamps in a second, and the last one that 48 bits hold.
PER_SECOND, LATEST = 100_000, (1 << 48) - 1


class Signing:
    """The key of a vehicle, its timestamp, and those of everybody it has heard.

    It sees every message before it is handled, and the packer before it sends.

    `uptime` in seconds moves the timestamp on. A SETUP_SIGNING for another system is not taken, nor is any
    that the key does not vouch for once there is one; a key of zeros switches signing off.
    """

    def __init__(self, system: int, uptime: Callable[[], float]) -> None:
        self.key: bytes | None = None
        self._system, self._uptime = system, uptime
        self._latest, self._since = 0, 0.0
        self._streams: OrderedDict[bytes, int] = OrderedDict()

    @property
    def timestamp(self) -> int:
        """The vehicle's own, in 10 us since the first of January 2015."""
        return self._latest + int((self._uptime() - self._since) * PER_SECOND)

    def admits(self, message: Any, *, local: bool) -> bool:
        """Whether a message is listened to: signed by the key and new, or from the serial door."""
        accepted = self.key is None or local or self._is_signed(bytes(message.get_msgbuf()))
        setup = message.get_msgId() == dialect.MAVLINK_MSG_ID_SETUP_SIGNING
        if accepted and setup and message.target_system == self._system:
            self._set_up(message)
        return accepted

    def seal(self, packer: Any) -> None:
        """Have the next packet of a pymavlink `MAVLink` signed, when there is a key."""
        signing = packer.signing
        signing.sign_outgoing, signing.secret_key = self.key is not None, self.key
        if self.key is not None:
            # No two packets have the same: the second would be a replay to whoever listens.
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
