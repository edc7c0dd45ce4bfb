"""TLS 1.3 with mutual authentication for one link. Sans-IO: bytes in, bytes and plain text out.

OpenSSL checks the signature of the team's CA, but not the validity period, which
`lfield.authority.peer_verification` checks. `identity` is the peer, ANONYMOUS until both certificates are
verified. Before that no application data is sent.

Between two processes that had a link, the next link resumes its session (RFC 8446, 2.2): without
certificates, a third of the bytes, with new keys. Sessions are in memory only, for two hours. OpenSSL keeps
the certificate of the peer with them, and checks it again for every link: a revoked or expired certificate is
refused as before.
"""

from __future__ import annotations

import os
import ssl
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from lfield.authority.identity import ANONYMOUS, Identity, identity_of
from lfield.authority.peer_verification import NO_CHECK_TIME
from lfield.errors import HandshakeError, KeysError, LfieldError, WireError

if TYPE_CHECKING:
    from lfield.authority.key_material import Keys
    from lfield.wire.framing import Buffer

#: Maximum bytes received before authentication; certificates of lfield have a few hundred.
MAX_HANDSHAKE = 1 << 14
#: Maximum plain text in one record.
_RECORD = 1 << 14
#: First byte of a handshake record.
_HANDSHAKE = 0x16

#: OpenSSL's verification errors for a certificate that the team's CA has not signed.
_FOREIGN_ALERTS = (7, 18, 19, 20, 21)
#: Alerts of the peer about the certificate of this host.
_REJECTED = (
    "ALERT_UNKNOWN_CA",
    "ALERT_BAD_CERTIFICATE",
    "ALERT_CERTIFICATE_UNKNOWN",
    "ALERT_UNSUPPORTED_CERTIFICATE",
    "ALERT_DECRYPT_ERROR",
)
_NO_CERTIFICATE = ("PEER_DID_NOT_RETURN_A_CERTIFICATE",)
_CERTIFICATE_REQUIRED = ("ALERT_CERTIFICATE_REQUIRED",)


#: Sessions that may be resumed, of peers that dialled, and of peers that were dialled.
MAX_SESSIONS = 256

#: Called with a verified certificate: DER and name.
OnVerified = Callable[[bytes, Identity], None]


class TlsIdentity:
    """The credentials of this process, and its trusted CA.

    `on_verified` is called for each verified certificate: DER and name. Raises KeysError for keys that
    OpenSSL cannot use.
    """

    def __init__(self, keys: Keys, on_verified: OnVerified = lambda certificate, identity: None) -> None:
        self._on_verified = on_verified
        self._calling, self._called = (
            ssl.SSLContext(side) for side in (ssl.PROTOCOL_TLS_CLIENT, ssl.PROTOCOL_TLS_SERVER)
        )
        try:
            for context in (self._calling, self._called):
                _prepare(context, keys)
        except (OSError, UnicodeDecodeError):
            raise KeysError(
                "the keys are damaged or mismatched: copy them again from the output of 'lfield keys'"
            ) from None
        #: The sessions of dialled addresses.
        self._sessions: dict[str, ssl.SSLSession] = {}

    def own_identity(self) -> Identity:
        """The identity of a host with these keys, checked by a handshake with itself. Raises KeysError."""
        calling, called = self.channel(calls=True), self.channel(calls=False)
        try:
            while not called.proven and (outgoing := calling.data_to_send()):
                list(called.receive(outgoing))
                list(calling.receive(called.data_to_send()))
        except LfieldError as error:
            raise KeysError(f"keys rejected for a host: {error}") from None
        return called.identity

    def channel(self, *, calls: bool, address: str = "") -> TlsChannel:
        """One end of a new link, accepting or dialling; `address` is the dialled address."""
        if calls:
            session = self._sessions.pop(address, None)
            return TlsChannel(self._calling, self._on_verified, calls=True, session=session)
        is_full = self._called.session_stats()["number"] >= MAX_SESSIONS
        self._called.num_tickets = 0 if is_full else 1
        return TlsChannel(self._called, self._on_verified, calls=False)

    def keep_session(self, address: str, channel: TlsChannel) -> None:
        """A link that was dialled has ended: the next link to that address may resume its session."""
        if (session := channel.session) is not None:
            self._sessions.pop(address, None)
            self._sessions[address] = session
            if len(self._sessions) > MAX_SESSIONS:
                self._sessions.pop(next(iter(self._sessions)))


class TlsChannel:
    """One end of a TLS link, from its handshake on."""

    def __init__(
        self,
        context: ssl.SSLContext,
        on_verified: OnVerified,
        *,
        calls: bool,
        session: ssl.SSLSession | None = None,
    ) -> None:
        self._on_verified = on_verified
        #: `outgoing` has the protocol data to send in addition to encrypted text.
        self._incoming, self.outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._incoming, self.outgoing, server_side=not calls, session=session)
        self._has_received = 0
        #: The peer; ANONYMOUS until authenticated.
        self.identity: Identity = ANONYMOUS
        self.proven = False
        if calls:
            self._do_handshake()

    @property
    def session(self) -> ssl.SSLSession | None:
        """The session that a later link with this peer may resume; None without one."""
        return self._tls.session if self.proven else None

    @property
    def is_resumed(self) -> bool:
        """Whether the channel has resumed a session."""
        return bool(self._tls.session_reused)

    def end(self) -> None:
        """Mark the link as ended in order, also after a lost connection. Otherwise OpenSSL would discard the
        session.
        """
        with suppress(ssl.SSLError):
            self._tls.unwrap()

    def receive(self, data: Buffer) -> Iterator[bytes]:
        """Process received bytes; returns the plain text of each completed record.

        `data_to_send` may have data afterwards, also on an error. Raises HandshakeError for a rejected
        certificate on either side, and WireError for invalid or corrupted TLS.
        """
        try:
            if not self.proven:
                data = self._continue_handshake(memoryview(data))
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
            raise _tls_error(error) from None

    def encrypt(self, data: Buffer) -> bytes:
        """Encrypt plain text in one piece; the peer must be authenticated."""
        done, size = self._tls.write(data), len(data)
        while done < size:
            done += self._tls.write(memoryview(data)[done:])
        return self.outgoing.read()

    def data_to_send(self) -> bytes:
        """Pending protocol data: handshake and alerts."""
        return self.outgoing.read()

    def _continue_handshake(self, data: memoryview) -> memoryview:
        """Continue the handshake. Returns the bytes after its end.

        Data of an unauthenticated peer is bounded; data that is no TLS is not stored.
        """
        if self._has_received == 0 and len(data) and data[0] != _HANDSHAKE:
            raise WireError("received data is not TLS: the peer is not an lfield host, or an outdated one")
        part, remaining = (
            data[: MAX_HANDSHAKE - self._has_received],
            data[MAX_HANDSHAKE - self._has_received :],
        )
        self._has_received += len(part)
        self._incoming.write(part)
        if not self._do_handshake() and len(remaining):
            raise WireError(f"over {MAX_HANDSHAKE} bytes received before authentication")
        return remaining

    def _do_handshake(self) -> bool:
        try:
            self._tls.do_handshake()
        except ssl.SSLWantReadError:
            return False
        self.identity, self.proven = identity_of(self._tls.getpeercert() or {}), True
        if self.identity.kind != "anonymous":
            self._on_verified(self._tls.getpeercert(binary_form=True) or b"", self.identity)
        return True


def _prepare(context: ssl.SSLContext, keys: Keys) -> None:
    context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_3
    # Sessions stay in the process that accepts links; the peer gets the number of a session.
    context.options |= ssl.OP_NO_TICKET
    context.check_hostname = False
    context.verify_mode = ssl.CERT_REQUIRED
    context.verify_flags |= ssl.VerifyFlags(NO_CHECK_TIME)
    context.load_verify_locations(cadata=keys.authority.decode("ascii"))
    with as_file(keys.certificate) as certificate, as_file(keys.key) as key:
        context.load_cert_chain(certificate, key, password=_no_password)


def _no_password() -> bytes:
    """A replacement for OpenSSL's prompt at the terminal."""
    return b""


@contextmanager
def as_file(data: bytes) -> Iterator[str]:
    """A one-time path to bytes in memory, for APIs that read files only; no disk is used."""
    reading = pipe_with(data)
    try:
        yield f"/proc/self/fd/{reading}"
    finally:
        os.close(reading)


def pipe_with(data: bytes) -> int:
    """A descriptor from which these bytes can be read once; they must fit into a pipe."""
    reading, writing = os.pipe()
    try:
        os.set_blocking(writing, False)
        os.write(writing, data)
    finally:
        os.close(writing)
    return reading


def _tls_error(error: ssl.SSLError) -> LfieldError:
    """OpenSSL's error as a message."""
    if isinstance(error, ssl.SSLCertVerificationError):
        if error.verify_code in _FOREIGN_ALERTS:
            return HandshakeError("peer certificate rejected: not signed by the CA of this team")
        return HandshakeError(f"peer certificate rejected: {error.verify_message}")
    reason = error.reason or str(error)
    if reason.endswith(_NO_CERTIFICATE):
        return HandshakeError("peer sent no certificate; make one with 'lfield keys'")
    if reason.endswith(_CERTIFICATE_REQUIRED):
        return HandshakeError("peer requires a certificate, and none was sent")
    if reason.endswith(_REJECTED):
        return HandshakeError("peer rejected the certificate of this host: it trusts another CA")
    return WireError(
        f"received data is not TLS 1.3, or was corrupted in transit: {reason.lower().replace('_', ' ')}"
    )
