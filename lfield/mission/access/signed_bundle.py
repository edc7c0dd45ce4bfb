"""Acceptance of signed bundles: the bundle of a mission, and its signer.

A bundle controls vehicles, so a host with keys accepts only a bundle that is signed by a person with the
right `command`, with a certificate of its own authority. A host without keys has no other hosts, and accepts
any bundle.
"""

from __future__ import annotations

from typing import NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from lfield.authority.peer_verification import NONE_REVOKED, RevocationList, format_time, verify_signer
from lfield.errors import SignatureError
from lfield.wire.fields import short_digest


class BundleId(Struct, frozen=True):
    """A bundle that was read: its `digest`, and its `signature` as received.

    `by` is the verified signer, `at` the time of the signature in seconds since 1970 UTC; '' and 0.0 before
    the verification. A mission from files has no digest, unless a temporary bundle was built to run them here
    (`is_from_files`).
    """

    digest: bytes = b""
    signature: bytes = b""
    by: str = ""
    at: float = 0.0
    is_from_files: bool = False

    @property
    def shared(self) -> bytes:
        """The digest that all hosts of the team share; b"" if each builds its bundle from its files."""
        return b"" if self.is_from_files else self.digest

    @property
    def short(self) -> str:
        """The start of the digest, as shown to people; '' without a bundle."""
        return short_digest(self.digest)

    def __str__(self) -> str:
        if not self.digest:
            return "no bundle"
        return (
            f"{self.short}, signed by {self.by} {format_time(self.at)}"
            if self.by
            else f"{self.short}, not signed"
        )


#: The id of a mission that was read from files.
FROM_FILES = BundleId()


class Acceptance(NamedTuple):
    """An accepted bundle, and a warning about its signer; '' for none."""

    bundle: BundleId
    warning: str


def accept_bundle(
    bundle: BundleId,
    authority: bytes,
    fingerprint: str,
    *,
    at: float,
    revoked: RevocationList = NONE_REVOKED,
    runs: bool = False,
) -> Acceptance:
    """The bundle with its verified signer, if a host accepts it. Raises SignatureError.

    `authority` is the certificate of the host's authority in PEM, `at` the estimated time. `runs`: this host
    has started this bundle before, and its mission was not completed. Then it resumes although the signer's
    certificate has expired or was revoked: a vehicle in the air must not lose its program.
    """
    if not bundle.digest:
        raise SignatureError("a host with keys runs bundles only: 'lfield build' makes one")
    # Imported late: large, and only hosts with keys need it.
    from lfield.authority.bundle_signature import verify_bundle

    try:
        signer, signed_at = verify_bundle(bundle.digest, bundle.signature, authority)
    except SignatureError as error:
        raise _refused(bundle, str(error)) from None
    verdict = verify_signer(signer, signed_at, at=at, authority=fingerprint, revoked=revoked, runs=runs)
    if verdict.extent != "all":
        raise _refused(bundle, verdict.reason)
    return Acceptance(replace(bundle, by=str(signer), at=signed_at), verdict.reason)


def signing_time(bundle: BundleId, authority: bytes) -> float:
    """The verified time of the signature in seconds since 1970 UTC; 0.0 without a valid one."""
    from lfield.authority.bundle_signature import verify_bundle

    try:
        return verify_bundle(bundle.digest, bundle.signature, authority).at if bundle.signature else 0.0
    except SignatureError:
        return 0.0


def _refused(bundle: BundleId, reason: str) -> SignatureError:
    return SignatureError(f"bundle {bundle.short} does not run here: {reason}")
