"""Message signing: what goes out is signed, what comes in is believed only with a signature.

https://mavlink.io/en/guide/message_signing.html. The check is our own: pymavlink notes the timestamp of a
packet before it has looked at the signature, so one forged packet would shut out the vehicle for ever, and
where unsigned packets are let in it lets in those with a wrong signature too.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from lfield.driver import Clock, DeviceBinding, DeviceError
from lfield_mavlink.link.stamps import PER_SECOND, Stamps, load_key

#: The end of a signed packet: link id, 48 bits of timestamp, 48 bits of signature.
BLOCK, SIGNATURE = 13, 6
#: How far a stream that is new may be behind us.
BEHIND = 60 * PER_SECOND
#: Seconds between two looks at whether timestamps run low; they last for twice as long and more.
LOOK = 2.0


class Signing:
    """The key of the links of one guard, and the streams of packets heard on them.

    Counts signatures: `good` ones, and `bad` ones, which are wrong, old or repeated.
    """

    def __init__(self, key: bytes, stamps: Stamps) -> None:
        self.key, self.stamps = key, stamps
        # One table for all links: what was heard on one must not be repeated on another. Only those who
        # have the key get into it, so it needs no bound.
        self._streams: dict[tuple[int, int, int], int] = {}
        self.good = self.bad = 0

    def check(self, packet: bytes, system: int, component: int) -> bool:
        """Whether a signed packet is by somebody who has the key, and new."""
        sound = self._is_sound(packet, system, component)
        if sound:
            self.good += 1
        else:
            self.bad += 1
        return sound

    def _is_sound(self, packet: bytes, system: int, component: int) -> bool:
        expected = hashlib.sha256(self.key + packet[:-SIGNATURE]).digest()[:SIGNATURE]
        if not hmac.compare_digest(expected, packet[-SIGNATURE:]):
            return False
        stream = (packet[-BLOCK], system, component)
        timestamp = int.from_bytes(packet[1 - BLOCK : -SIGNATURE], "little")
        if timestamp <= self._streams.get(stream, self.stamps.latest - BEHIND):
            return False
        self._streams[stream] = timestamp
        self.stamps.saw(timestamp)
        return True

    async def keep_ahead(self, note: Callable[[str], None]) -> None:
        """Keep the file of timestamps ahead of their use until cancelled; a disk that fails is told."""
        failed = False
        while True:
            await asyncio.sleep(LOOK)
            if not self.stamps.is_low:
                continue
            try:
                await asyncio.to_thread(self.stamps.extend, self.stamps.due)
                failed = False
            except DeviceError as error:
                if not failed:
                    note(f"{error.reason}; after a restart the vehicle may not listen for a while")
                failed = True


class LinkSigning:
    """The signatures of one link, which has an id of its own.

    `allow_unsigned` lets in packets without a signature, never those with a bad one; otherwise `unsigned`
    counts those that were refused.
    """

    def __init__(self, signing: Signing, link_id: int, *, allow_unsigned: bool) -> None:
        self._signing, self._link_id, self._allow_unsigned = signing, link_id, allow_unsigned
        self._just_refused = False
        self.unsigned = 0

    def attach_reader(self, parser: Any) -> None:
        """Have a pymavlink `MAVLink` ask us about every packet it parses."""
        parser.signing.secret_key = self._signing.key
        parser.signing.allow_unsigned_callback = self._lets_in
        parser.check_signature = self._check

    def seal(self, packer: Any) -> None:
        """Have a pymavlink `MAVLink` sign the next packet that it packs."""
        signing = packer.signing
        signing.secret_key, signing.sign_outgoing, signing.link_id = self._signing.key, True, self._link_id
        signing.timestamp = self._signing.stamps.next()

    def _check(self, packet: bytearray, system: int, component: int) -> bool:
        sound = self._signing.check(bytes(packet), system, component)
        self._just_refused = not sound
        return sound

    def _lets_in(self, *_: object) -> bool:
        """pymavlink asks this of every packet that `_check` has not approved, also of those it refused."""
        if self._just_refused:
            self._just_refused = False
            return False
        if not self._allow_unsigned:
            self.unsigned += 1
        return self._allow_unsigned


def open_signing(bindings: Sequence[DeviceBinding], clock: Clock) -> Signing | None:
    """What the bindings of one bus say about signing; None when they name no key.

    Reads and writes small files. Raises DeviceError.
    """
    paths = {binding.option("signing_key") for binding in bindings}
    if len(paths) > 1:
        raise DeviceError("signing_key", f"the devices at {bindings[0].endpoint} must have the same key")
    path: str = paths.pop()
    if not path:
        return None
    stamps = Stamps(Path(path), clock)
    key = load_key(Path(path))
    stamps.open()
    return Signing(key, stamps)


def sign_link(
    signing: Signing | None, bindings: Sequence[DeviceBinding], number: int, endpoint: str
) -> LinkSigning | None:
    """The signing of the `number`-th link of a bus.

    A cable needs no signatures, since autopilots keep it open; neither does a link whose every binding waives
    them by `unsigned`.
    """
    if signing is None:
        return None
    allow = endpoint.startswith("serial:") or all(binding.waives("unsigned") for binding in bindings)
    first: int = bindings[0].option("link_id")
    return LinkSigning(signing, (first + number) % 256, allow_unsigned=allow)
