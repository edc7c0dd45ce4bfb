"""MAVLink message signing: outgoing packets are signed, incoming ones need a valid signature.

https://mavlink.io/en/guide/message_signing.html. Verified here: pymavlink stores the timestamp of a packet
before it verifies the signature, so one forged packet would block the vehicle permanently; and if unsigned
packets are allowed, it also accepts wrong signatures.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from lfield.driver import Clock, DeviceBinding, DeviceError
from lfield_mavlink import log_messages
from lfield_mavlink.link.signing_timestamps import PER_SECOND, SigningTimestamps, load_key

#: The end of a signed packet: link id, 48-bit timestamp, 48-bit signature.
BLOCK, SIGNATURE = 13, 6
#: The time by which a new stream may be behind us.
BEHIND = 60 * PER_SECOND
#: Seconds between two checks of the remaining timestamps, which last more than twice as long.
CHECK_INTERVAL = 2.0


class Signing:
    """The key of the links of one guard, and the streams of packets received on them.

    `valid_count` and `invalid_count` count signatures; wrong, old and repeated ones are invalid.
    """

    def __init__(self, key: bytes, stamps: SigningTimestamps) -> None:
        self.key, self.stamps = key, stamps
        # One table for all links, since a packet must not be replayed on another link. Only senders with the
        # key enter it, so it needs no bound.
        self._streams: dict[tuple[int, int, int], int] = {}
        self.valid_count = self.invalid_count = 0

    def check(self, packet: bytes, system: int, component: int) -> bool:
        """Whether a signed packet has a valid signature and is new."""
        is_valid = self._is_valid(packet, system, component)
        if is_valid:
            self.valid_count += 1
        else:
            self.invalid_count += 1
        return is_valid

    def _is_valid(self, packet: bytes, system: int, component: int) -> bool:
        expected = hashlib.sha256(self.key + packet[:-SIGNATURE]).digest()[:SIGNATURE]
        if not hmac.compare_digest(expected, packet[-SIGNATURE:]):
            return False
        stream = (packet[-BLOCK], system, component)
        timestamp = int.from_bytes(packet[1 - BLOCK : -SIGNATURE], "little")
        if timestamp <= self._streams.get(stream, self.stamps.latest - BEHIND):
            return False
        self._streams[stream] = timestamp
        self.stamps.on_timestamp(timestamp)
        return True

    async def keep_ahead(self, note: Callable[[str], None]) -> None:
        """Extends the timestamp file ahead of use until cancelled; logs disk errors."""
        failed = False
        while True:
            await asyncio.sleep(CHECK_INTERVAL)
            if not self.stamps.is_low:
                continue
            try:
                await asyncio.to_thread(self.stamps.extend, self.stamps.due)
                failed = False
            except DeviceError as error:
                if not failed:
                    note(log_messages.SIGNING_NOT_STORED.line(reason=error.reason))
                failed = True


class LinkSigning:
    """The signatures of one link, which has its own link id.

    `allow_unsigned` accepts packets without a signature, never those with a bad one; otherwise `unsigned`
    counts refused ones.
    """

    def __init__(self, signing: Signing, link_id: int, *, allow_unsigned: bool) -> None:
        self._signing, self._link_id, self._allow_unsigned = signing, link_id, allow_unsigned
        self._just_refused = False
        self.unsigned = 0

    def attach_reader(self, parser: Any) -> None:
        """Installs the verification in a pymavlink `MAVLink`."""
        parser.signing.secret_key = self._signing.key
        parser.signing.allow_unsigned_callback = self._accepts_unsigned
        parser.check_signature = self._check

    def seal(self, packer: Any) -> None:
        """Makes a pymavlink `MAVLink` sign the next packet."""
        signing = packer.signing
        signing.secret_key, signing.sign_outgoing, signing.link_id = self._signing.key, True, self._link_id
        signing.timestamp = self._signing.stamps.next()

    def _check(self, packet: bytearray, system: int, component: int) -> bool:
        is_valid = self._signing.check(bytes(packet), system, component)
        self._just_refused = not is_valid
        return is_valid

    def _accepts_unsigned(self, *_: object) -> bool:
        """Called by pymavlink for every packet that `_check` has not accepted, including refused ones."""
        if self._just_refused:
            self._just_refused = False
            return False
        if not self._allow_unsigned:
            self.unsigned += 1
        return self._allow_unsigned


def open_signing(bindings: Sequence[DeviceBinding], clock: Clock) -> Signing | None:
    """The signing of the bindings of one bus; None without a key.

    Reads and writes small files. Raises DeviceError.
    """
    paths = {binding.option("signing_key") for binding in bindings}
    if len(paths) > 1:
        raise DeviceError("signing_key", f"the devices at {bindings[0].endpoint} must have the same key")
    path: str = paths.pop()
    if not path:
        return None
    stamps = SigningTimestamps(Path(path), clock)
    key = load_key(Path(path))
    stamps.open()
    return Signing(key, stamps)


def sign_link(
    signing: Signing | None, bindings: Sequence[DeviceBinding], number: int, endpoint: str
) -> LinkSigning | None:
    """The signing of the `number`-th link of a bus.

    A cable needs none, since autopilots accept unsigned packets there; nor does a link whose bindings all
    waive it by `unsigned`.
    """
    if signing is None:
        return None
    allow = endpoint.startswith("serial:") or all(binding.waives("unsigned") for binding in bindings)
    first: int = bindings[0].option("link_id")
    return LinkSigning(signing, (first + number) % 256, allow_unsigned=allow)
