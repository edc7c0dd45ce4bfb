"""Message signing of one link: what goes out is signed, what comes in is believed only with a signature.

https://mavlink.io/en/guide/message_signing.html. The check is our own: pymavlink notes the timestamp of a
packet before it has looked at the signature, so one forged packet would shut out the vehicle for ever, and
where unsigned packets are let in it lets in those with a wrong signature too.
"""

from __future__ import annotations

import hashlib
import hmac
from typing import Any

from lfield_mavlink.stamps import PER_SECOND, Stamps

#: The end of a signed packet: link id, 48 bits of timestamp, 48 bits of signature.
BLOCK, SIGNATURE = 13, 6
#: How far a stream that is new may be behind us.
BEHIND = 60 * PER_SECOND


class Signing:
    """The signatures of one link. `allow_unsigned` lets in packets without any, never those with a bad one.

    Counts what came: `good` signatures, `bad` ones (wrong, old or repeated), and `unsigned` packets refused.
    """

    def __init__(self, key: bytes, stamps: Stamps, link_id: int, *, allow_unsigned: bool) -> None:
        self._key, self._stamps, self._link_id = key, stamps, link_id
        self._allow_unsigned = allow_unsigned
        # Only those who have the key get into this table.
        self._streams: dict[tuple[int, int, int], int] = {}
        self._just_refused = False
        self.good = self.bad = self.unsigned = 0

    def attach_reader(self, parser: Any) -> None:
        """Have a pymavlink `MAVLink` ask us about every packet it parses."""
        parser.signing.secret_key = self._key
        parser.signing.allow_unsigned_callback = self._lets_in
        parser.check_signature = self.check

    def seal(self, packer: Any) -> None:
        """Have a pymavlink `MAVLink` sign the next packet that it packs."""
        signing = packer.signing
        signing.secret_key, signing.sign_outgoing, signing.link_id = self._key, True, self._link_id
        signing.timestamp = self._stamps.next()

    def check(self, packet: bytearray, system: int, component: int) -> bool:
        """Whether a signed packet is by somebody who has the key, and new."""
        sound = self._is_sound(bytes(packet), system, component)
        self._just_refused = not sound
        if sound:
            self.good += 1
        else:
            self.bad += 1
        return sound

    def _is_sound(self, packet: bytes, system: int, component: int) -> bool:
        expected = hashlib.sha256(self._key + packet[:-SIGNATURE]).digest()[:SIGNATURE]
        if not hmac.compare_digest(expected, packet[-SIGNATURE:]):
            return False
        stream = (packet[-BLOCK], system, component)
        timestamp = int.from_bytes(packet[1 - BLOCK : -SIGNATURE], "little")
        last = self._streams.get(stream)
        if timestamp <= (last if last is not None else self._stamps.latest - BEHIND):
            return False
        self._streams[stream] = timestamp
        self._stamps.saw(timestamp)
        return True

    def _lets_in(self, *_: object) -> bool:
        """pymavlink asks this of every packet that `check` has not approved, also of those it refused."""
        if self._just_refused:
            self._just_refused = False
            return False
        if not self._allow_unsigned:
            self.unsigned += 1
        return self._allow_unsigned
