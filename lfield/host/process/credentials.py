"""Credentials of a host: its keys and admission policy, verified before any device moves.

Without keys a host listens at no network address: local commands use its control socket, and a team of
several hosts does not start.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import partial
from pathlib import Path

from msgspec import Struct

from lfield.authority.admission_policy import CertificateAdmission
from lfield.authority.identity import Identity
from lfield.authority.key_material import Keys
from lfield.authority.peer_verification import RevocationList, format_time
from lfield.authority.trusted_clock import TrustedClock
from lfield.clock import Clock
from lfield.errors import KeysError, UsageError
from lfield.host.process.crl_store import CrlStore, newest_crl
from lfield.journal.records import BundleRecord, Record
from lfield.mission.access.signed_bundle import FROM_FILES, Acceptance, BundleId, accept_bundle, signing_time
from lfield.mission.mission import Mission
from lfield.net.tls import OnVerified, TlsIdentity


class HostCredentials(Struct, frozen=True):
    """The keys of a host. A newer revocation list is stored in the first writable one of `folders`.

    Keys that expire within `min_lifetime` seconds are refused. The bundle `accepted_bundle` needs no
    signature: the process that made the keys for this run has verified it.
    """

    keys: Keys
    folders: Sequence[Path] = ()
    min_lifetime: float = 0.0
    accepted_bundle: BundleId = FROM_FILES


def require_credentials(host: str, hosts: Sequence[str]) -> None:
    """Check that a host without keys has no peers. Raises UsageError."""
    if len(hosts) > 1:
        raise UsageError(
            f"{host} has no keys, which it needs to listen on a network: create them with 'lfield keys host "
            f"{host}' (after 'lfield keys init') and copy them to /etc/lfield/keys/{host}, or name their "
            "directory with --keys or $LFIELD_KEYS. With --all, the hosts of this computer need no keys"
        )


def admission_for(
    credentials: HostCredentials,
    host: str,
    clock: Clock,
    times: Collection[float],
    on_verified: OnVerified = lambda certificate, identity: None,
    signed: Callable[[], float] = lambda: 0.0,
) -> tuple[TlsIdentity, CertificateAdmission]:
    """The transport of a host's links, and its admission policy.

    `times` are the times in its journal: lower bounds of the current time. A time after the expiry of the
    keys is due to a wrong clock, or the keys are expired. `on_verified` receives certificates as in
    `TlsIdentity`. `signed` returns the time of the bundle's signature, 0.0 without one; called for expired
    keys only.

    Raises KeysError for keys of another host, revoked keys, and keys that expire too soon.
    """
    tls = TlsIdentity(credentials.keys, on_verified)
    own = tls.own_identity()
    if (own.kind, own.name) != ("host", host):
        raise KeysError(
            f"these are the keys of {own}, not of host {host}: 'lfield keys host {host}' makes those"
        )
    revoked, data = newest_crl(credentials.keys, credentials.folders)
    time = TrustedClock(clock, max((at for at in times if at < own.valid_until), default=0.0))
    store = CrlStore(credentials.folders).store
    admission = CertificateAdmission(credentials.keys, own, time, revoked, data, store)
    _require_valid(own, revoked, time.now(), credentials.min_lifetime, signed)
    return tls, admission


def require_signature(
    mission: Mission, proof: HostCredentials, admission: CertificateAdmission, records: Collection[Record]
) -> Acceptance:
    """The bundle of a mission with its signer, if this host accepts it; `records` are the records in its
    journal.

    Raises SignatureError.
    """
    release = mission.release
    if release.digest and release.digest == proof.accepted_bundle.digest:
        return Acceptance(proof.accepted_bundle, "")
    return accept_bundle(
        release,
        proof.keys.authority,
        admission.own.authority,
        at=admission.time.now(),
        revoked=admission.revoked,
        runs=BundleRecord(release.digest) in records,
    )


def validate_startup(mission: Mission, host: str, credentials: HostCredentials | None, clock: Clock) -> None:
    """Check that a host without stored state may start, before any file is created.

    Raises UsageError, KeysError and SignatureError.
    """
    if credentials is None:
        require_credentials(host, mission.team.hosts)
        return
    signed = partial(signing_time, mission.release, credentials.keys.authority)
    require_signature(mission, credentials, admission_for(credentials, host, clock, (), signed=signed)[1], ())


def _require_valid(
    own: Identity, revoked: RevocationList, now: float, lasts: float, signed: Callable[[], float]
) -> None:
    """Raises KeysError if the keys are revoked or expire within `lasts` seconds.

    `signed` returns the time when the bundle was signed, 0 for none: a clock that is wrong differs from it.
    """
    if own.serial in revoked.serials:
        raise KeysError(
            f"the keys of {own} are revoked (list {revoked.number}): make new ones with 'lfield keys {own}'"
        )
    if own.valid_until <= now:
        at = signed()
        bundle = f", and the bundle was signed {format_time(at)}" if at else ""
        raise KeysError(
            f"the certificate of {own} expired {format_time(own.valid_until)}: the clock here shows "
            f"{format_time(now)}{bundle}; set the clock if it is wrong, else renew the keys with "
            f"'lfield keys renew {own}', and copy them here ('lfield provision' does both)"
        )
    if own.valid_until < now + lasts:
        raise KeysError(
            f"the certificate of {own} expires {format_time(own.valid_until)}, but the mission may last "
            f"{lasts:.10g} s from now ({format_time(now)}, by the clock of this computer): renew it with "
            f"'lfield keys renew {own}', or set a shorter --lasts"
        )
