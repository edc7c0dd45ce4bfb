"""Which bundle a mission is from, and who vouches for it: what a host of a team with keys takes, and no more.

A bundle says what flies, so whoever may write one may fly the vehicles. A host that has keys takes only one
that somebody has signed who may `command`, by a certificate of its own authority. One without keys has no
other hosts, and takes what it is given.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

from lfield.authority.judge import NOBODY, Revoked, judged_signer, when
from lfield.errors import SignatureError
from lfield.wire.fields import short_digest


@dataclass(frozen=True, slots=True)
class Release:
    """A bundle as it was read: the `digest` of all of it, and its `signature` as it came.

    `by` is who has signed it, once that was seen, `at` when that was, in seconds since 1970 UTC; '' and 0.0
    until then. A mission that is from files has no digest, unless a bundle was made of them to run them here
    (`of_files`).
    """

    digest: bytes = b""
    signature: bytes = b""
    by: str = ""
    at: float = 0.0
    of_files: bool = False

    @property
    def shared(self) -> bytes:
        """The digest that all hosts of the team have alike; b"" where each makes its bundle of its files."""
        return b"" if self.of_files else self.digest

    @property
    def short(self) -> str:
        """The beginning of its digest, as people compare it; '' where there is no bundle."""
        return short_digest(self.digest)

    def __str__(self) -> str:
        if not self.digest:
            return "no bundle"
        return (
            f"{self.short}, signed by {self.by} {when(self.at)}" if self.by else f"{self.short}, not signed"
        )


#: A mission that was read from files.
FROM_FILES = Release()


class Taken(NamedTuple):
    """A bundle that a host takes, and what should be told of its signer all the same; '' for nothing."""

    release: Release
    doubt: str


def taken(
    release: Release,
    authority: bytes,
    fingerprint: str,
    *,
    at: float,
    revoked: Revoked = NOBODY,
    runs: bool = False,
) -> Taken:
    """The bundle with who has signed it, if a host takes it. Raises SignatureError.

    `authority` is the certificate of the host's authority in PEM, `at` the believed time. `runs`: this host
    has begun this very bundle, and its mission was not ended in order. Then it goes on with it although the
    signer's certificate has ended since, or is revoked: a vehicle in the air is not left without its program.
    """
    if not release.digest:
        raise SignatureError("a host with keys runs bundles only: 'lfield build' makes one")
    # Only who has keys needs it, and it is large.
    from lfield.authority.signature import signed

    try:
        who, signed_at = signed(release.digest, release.signature, authority)
    except SignatureError as error:
        raise _refused(release, str(error)) from None
    verdict = judged_signer(who, signed_at, at=at, authority=fingerprint, revoked=revoked, runs=runs)
    if verdict.extent != "all":
        raise _refused(release, verdict.why)
    return Taken(replace(release, by=str(who), at=signed_at), verdict.why)


def _refused(release: Release, why: str) -> SignatureError:
    return SignatureError(f"bundle {release.short} does not run here: {why}")
