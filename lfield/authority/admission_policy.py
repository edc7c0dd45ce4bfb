"""Admission state of one host: its keys, its lower bound of the time, and its revocation list.

Sans-IO. `lfield.authority.peer_verification` decides; this module holds its inputs. Without keys no peer is
verified: links are then between simulated hosts, or to a command of this computer, which the kernel
identifies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from hashlib import sha256
from typing import TYPE_CHECKING

from msgspec.structs import replace

from lfield.authority.peer_verification import ALLOWED, NONE_REVOKED, AdmissionDecision, verify_peer
from lfield.text import log_messages
from lfield.text.log_messages import LogLine

if TYPE_CHECKING:
    from lfield.authority.identity import Identity, Right
    from lfield.authority.key_material import Keys
    from lfield.authority.peer_verification import PeerStage, RevocationList
    from lfield.authority.trusted_clock import TrustedClock
    from lfield.wire.messages import Hello


#: The most certificates of a list that one log line names.
_MAX_NAMED = 8


class AdmissionPolicy:
    """Admits all peers: a host without keys."""

    #: The own revocation list as it is sent, and its number; empty and 0 without a list.
    list, number = b"", 0
    #: The reason why the own list may be lost with this process, and the consequence, in a sentence; '' when
    #: it is stored.
    persist_error = ""

    def __init__(self) -> None:
        #: Whether the mission of this host is running.
        self.is_mission_active: Callable[[], bool] = lambda: False
        #: Receives log lines.
        self.note: Callable[[LogLine], None] = lambda line: None
        #: The rights that the mission denies a peer, with the rule in a sentence.
        self.denied_rights: Callable[[Identity], Mapping[Right, str]] = lambda identity: {}

    def serve(
        self,
        is_mission_active: Callable[[], bool],
        denied_rights: Callable[[Identity], Mapping[Right, str]],
        note: Callable[[LogLine], None],
    ) -> None:
        """Set the callbacks of the host."""
        self.is_mission_active, self.denied_rights, self.note = is_mission_active, denied_rights, note

    def decide(self, identity: Identity, *, linked: bool = False, expected: str = "") -> AdmissionDecision:
        """The decision about a peer now; `linked`: it has a link between hosts. `expected` is the dialled
        host."""
        return ALLOWED

    def sign_hello(self, hello: Hello) -> Hello:
        """Add this host's time and revocation list to a hello message."""
        return hello

    def on_handshake(self, identity: Identity, hello: Hello) -> None:
        """Record a peer that has completed its handshake."""

    def on_revocation_list(self, data: bytes) -> Sequence[LogLine]:
        """Merge a revocation list; returns the log lines, none when the list adds no certificate.

        Raises KeysError for an invalid list.
        """
        return ()

    def clock_warning(self) -> LogLine | None:
        """The warning about the system clock, once; None when the clock is right."""
        return None


class CertificateAdmission(AdmissionPolicy):
    """Verifies peers by their certificates. `own` is this host.

    `revoked` is the own list as parsed, `data` its encoding. `store_list` writes a newer list for the
    next start of this host, then calls its second argument with '' or the reason of a failure.
    """

    def __init__(
        self,
        keys: Keys,
        own: Identity,
        time: TrustedClock,
        revoked: RevocationList = NONE_REVOKED,
        data: bytes = b"",
        store_list: Callable[[bytes, Callable[[str], None]], None] = lambda data, on_stored: None,
    ) -> None:
        super().__init__()
        self._store_list = store_list
        self._authority, self.own, self.time = keys.authority, own, time
        self.revoked, self.list, self.number = revoked, data, revoked.number
        #: Digests of received lists without new certificates; they are not parsed again.
        self._outdated: set[bytes] = set()
        #: Peers that completed a handshake in this mission, by the serial numbers of their certificates.
        self._greeted: dict[str, str] = {}
        time.on_signature(own.valid_from, f"the certificate of {own}")
        time.on_signature(revoked.at, f"revocation list {revoked.number}")

    def decide(self, identity: Identity, *, linked: bool = False, expected: str = "") -> AdmissionDecision:
        stage: PeerStage = "linked" if linked else "greeted" if identity.serial in self._greeted else "new"
        if identity.authority == self.own.authority:
            # The CA issues no certificate with a notBefore in the future.
            self.time.on_signature(identity.valid_from, f"the certificate of {identity}")
        judge = partial(
            verify_peer,
            identity,
            at=self.time.now(),
            authority=self.own.authority,
            revoked=self.revoked,
            known=stage,
            expected=expected,
        )
        # Every link is verified every second; whether a vehicle flies is looked up only when it matters.
        decision = judge(is_mission_active=False)
        if decision.extent != "all" and stage != "new":
            decision = judge(is_mission_active=self.is_mission_active())
        denied_rights = self.denied_rights(identity)
        if not denied_rights:
            return decision
        return AdmissionDecision(decision.extent, decision.reason, denied_rights)

    def sign_hello(self, hello: Hello) -> Hello:
        return replace(hello, time=self.time.for_handshake(), revoked=self.number)

    def on_handshake(self, identity: Identity, hello: Hello) -> None:
        self.time.on_peer_time(hello.time, identity)
        self._greeted[identity.serial] = str(identity)

    def on_revocation_list(self, data: bytes) -> Sequence[LogLine]:
        if data == self.list or (digest := sha256(data).digest()) in self._outdated:
            return ()
        # The list is large, and useless without keys.
        from lfield.authority.certificate_reader import revoked_in

        own, read = self.revoked, revoked_in(data, self._authority)
        newer = read.number > own.number
        if not newer and read.serials <= own.serials:
            self._outdated.add(digest)
            return ()
        # A revocation is never undone.
        self.revoked = own.merged(read)
        if newer:
            self.list, self.number = data, read.number
            self.time.on_signature(read.at, f"revocation list {read.number}")
            self._store_list(data, self.on_list_stored)
        received = log_messages.CRL_RECEIVED.line(number=read.number)
        return received, *(_missing_revocations(own, read) if newer else _missing_revocations(read, own))

    def on_list_stored(self, reason: str) -> None:
        """Handle the result of storing the own list: success ('') or a failure (`reason`)."""
        line = log_messages.CRL_STORED.line(number=self.number)
        if reason:
            known = {self._greeted[serial] for serial in self.revoked.serials & self._greeted.keys()}
            holders = ", ".join(sorted(known))
            line = log_messages.CRL_NOT_STORED.line(number=self.number, reason=reason, holders=holders)
        problem = str(line) if reason else ""
        if problem != self.persist_error:
            self.note(line)
        self.persist_error = problem

    def clock_warning(self) -> LogLine | None:
        return self.time.warning()


def _missing_revocations(older: RevocationList, newest: RevocationList) -> Sequence[LogLine]:
    """The log line about certificates that only the older list revokes; empty if there are none."""
    lost = sorted(older.serials - newest.serials)
    if not lost:
        return ()
    named, more = (
        ", ".join(lost[:_MAX_NAMED]),
        f" and {len(lost) - _MAX_NAMED} more" if len(lost) > _MAX_NAMED else "",
    )
    other = "another one of that number" if older.number == newest.number else f"list {older.number}"
    return (
        log_messages.CRL_INCOMPLETE.line(
            newest=newest.number, serials=f"{named}{more}", other=other, first=lost[0]
        ),
    )
