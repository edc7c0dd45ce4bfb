"""TLS 1.3 for one link, both ends with certificates, as a pure core: bytes in, bytes and plain text out.

It has no loop and no socket. OpenSSL checks that a certificate is signed by the team's authority, and not
when it begins and ends: in flight that is more than yes or no (`lfield.authority.judge`). What it knows of
the other end is in `who`, a stranger until both certificates are verified; until then nothing that this side
wants to say goes out.

No session is ever resumed: each link has new keys, so what was recorded of one is nothing on another.
"""

from __future__ import annotations

import os
import ssl
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from lfield.authority.identity import STRANGER, Identity, identity_of
from lfield.authority.judge import NO_CHECK_TIME
from lfield.errors import GreetingError, KeysError, LfieldError, WireError

if TYPE_CHECKING:
    from lfield.authority.keys import Keys
    from lfield.wire.framing import Buffer

#: What may come until the other end is proven, in bytes: certificates of ours have some hundred.
MAX_HANDSHAKE = 1 << 14
#: The most plain text in one record.
_RECORD = 1 << 14
#: The first byte of a handshake.
_HANDSHAKE = 0x16

#: What OpenSSL says of a certificate that another authority has signed, or nobody.
_FOREIGN = (7, 18, 19, 20, 21)
#: What the other end says of ours.
_NOT_TAKEN = (
    "ALERT_UNKNOWN_CA",
    "ALERT_BAD_CERTIFICATE",
    "ALERT_CERTIFICATE_UNKNOWN",
    "ALERT_UNSUPPORTED_CERTIFICATE",
    "ALERT_DECRYPT_ERROR",
)
_NONE_SHOWN = ("PEER_DID_NOT_RETURN_A_CERTIFICATE",)
_NONE_WANTED = ("ALERT_CERTIFICATE_REQUIRED",)


#: Hears of a certificate that was verified: DER, and whom it names.
Seen = Callable[[bytes, Identity], None]


class Tls:
    """What this process proves itself with, and which authority it believes.

    `seen` hears of each certificate that was verified: DER, and whom it names. Raises KeysError for keys that
    OpenSSL cannot use.
    """

    def __init__(self, keys: Keys, seen: Seen = lambda certificate, who: None) -> None:
        self._seen = seen
        self._calling, self._called = (
            ssl.SSLContext(side) for side in (ssl.PROTOCOL_TLS_CLIENT, ssl.PROTOCOL_TLS_SERVER)
        )
        try:
            for context in (self._calling, self._called):
                _prepare(context, keys)
        except (OSError, UnicodeDecodeError):
            raise KeysError(
                "the keys are damaged, or do not belong together: copy them again from where 'lfield keys' "
                "has put them"
            ) from None
        self._called.num_tickets = 0

    def own(self) -> Identity:
        """Who a host with these keys is to others, and to itself: it tries. Raises KeysError."""
        near, far = self.channel(calls=True), self.channel(calls=False)
        try:
            while not far.proven and (said := near.take()):
                list(far.feed(said))
                list(near.feed(far.take()))
        except LfieldError as error:
            raise KeysError(f"these keys are no good for a host: {error}") from None
        return far.who

    def channel(self, *, calls: bool) -> Channel:
        """One end of a new link: of whoever calls, or of whoever is called."""
        return Channel(self._calling if calls else self._called, self._seen, calls=calls)


class Channel:
    """One end of a link, from its handshake on."""

    def __init__(self, context: ssl.SSLContext, seen: Seen, *, calls: bool) -> None:
        self._seen = seen
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._incoming, self._outgoing, server_side=not calls)
        self._came = 0
        #: Who is at the other end; a stranger until that is proven.
        self.who: Identity = STRANGER
        self.proven = False
        if calls:
            self._shake_hands()

    def feed(self, data: Buffer) -> Iterator[bytes]:
        """Take the next bytes; the plain text of each record that they complete.

        Then there may be something in `take`, also when this raises: GreetingError where a certificate is
        not good, here or there, WireError for what is no TLS, or was bent on the way.
        """
        try:
            if not self.proven:
                data = self._first(memoryview(data))
            self._incoming.write(data)
            while self.proven and (self._incoming.pending or self._tls.pending()):
                plain = self._tls.read(_RECORD)
                if not plain:
                    return
                yield plain
        except ssl.SSLWantReadError:
            return
        except ssl.SSLZeroReturnError:
            return
        except ssl.SSLError as error:
            raise _told(error) from None

    def seal(self, data: Buffer) -> bytes:
        """The bytes to send for some plain text, in one piece; the other end must be proven."""
        done, size = self._tls.write(data), len(data)
        while done < size:
            done += self._tls.write(memoryview(data)[done:])
        return self._outgoing.read()

    def take(self) -> bytes:
        """What must be sent beside that: the handshake, and why it ends."""
        return self._outgoing.read()

    def _first(self, data: memoryview) -> memoryview:
        """Go on with the handshake; what is left of the bytes when it is over.

        A stranger makes this process hold no more than that, and of another program nothing at all.
        """
        if self._came == 0 and len(data) and data[0] != _HANDSHAKE:
            raise WireError("its first bytes are no TLS: it is no lfield host, or one of an earlier version")
        part, rest = data[: MAX_HANDSHAKE - self._came], data[MAX_HANDSHAKE - self._came :]
        self._came += len(part)
        self._incoming.write(part)
        if not self._shake_hands() and len(rest):
            raise WireError(f"over {MAX_HANDSHAKE} bytes came before it had proven who it is")
        return rest

    def _shake_hands(self) -> bool:
        try:
            self._tls.do_handshake()
        except ssl.SSLWantReadError:
            return False
        self.who, self.proven = identity_of(self._tls.getpeercert() or {}), True
        if self.who.kind != "stranger":
            self._seen(self._tls.getpeercert(binary_form=True) or b"", self.who)
        return True


def _prepare(context: ssl.SSLContext, keys: Keys) -> None:
    context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_3
    context.check_hostname = False
    context.verify_mode = ssl.CERT_REQUIRED
    context.verify_flags |= ssl.VerifyFlags(NO_CHECK_TIME)
    context.load_verify_locations(cadata=keys.authority.decode("ascii"))
    with as_file(keys.certificate) as certificate, as_file(keys.key) as key:
        context.load_cert_chain(certificate, key, password=_no_password)


def _no_password() -> bytes:
    """OpenSSL would ask at the terminal."""
    return b""


@contextmanager
def as_file(data: bytes) -> Iterator[str]:
    """A path for whoever reads files alone, once; what is there is on no disk, and needs none."""
    reading = piped(data)
    try:
        yield f"/proc/self/fd/{reading}"
    finally:
        os.close(reading)


def piped(data: bytes) -> int:
    """A descriptor from which these bytes can be read, and then no more; so many must fit into a pipe."""
    reading, writing = os.pipe()
    try:
        os.set_blocking(writing, False)
        os.write(writing, data)
    finally:
        os.close(writing)
    return reading


def _told(error: ssl.SSLError) -> LfieldError:
    """What OpenSSL found, in a sentence."""
    if isinstance(error, ssl.SSLCertVerificationError):
        if error.verify_code in _FOREIGN:
            return GreetingError("its certificate is not signed by the authority of this team")
        return GreetingError(f"its certificate is not good: {error.verify_message}")
    reason = error.reason or str(error)
    if reason.endswith(_NONE_SHOWN):
        return GreetingError("it shows no certificate; 'lfield keys' makes one")
    if reason.endswith(_NONE_WANTED):
        return GreetingError("it wants a certificate, and got none")
    if reason.endswith(_NOT_TAKEN):
        return GreetingError("it does not take the certificate shown to it: it believes another authority")
    return WireError(f"this is no TLS 1.3, or it was bent on the way: {reason.lower().replace('_', ' ')}")
