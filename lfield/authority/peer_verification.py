"""Decides by certificate and revocation whether a peer may have a link, or may sign a bundle. Sans-IO.

OpenSSL verifies that a certificate is signed by the CA. It does not check times (`NO_CHECK_TIME`), since it
knows only the system clock and can only refuse. A vehicle in the air whose certificate expires must still
stop, be stopped and return: so the answer is yes, no, or yes to finish only. `at` is the time of
`trusted_clock`.

    | certificate of a peer   | new, or not in flight | known, and in flight          |
    |-------------------------|-----------------------|-------------------------------|
    | expired                 | no                    | to finish                     |
    | revoked, of a host      | no                    | to finish, on an open link    |
    | revoked, of a person    | no                    | no                            |

A revoked key may be stolen, so it opens no new link; an open link was made before the revocation. Only a
link between hosts stays open to finish, not one of an observer. An unreachable host does not receive a
revocation.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Literal

from msgspec import Struct, field
from msgspec.structs import replace

from lfield.authority.identity import NO_RIGHTS, Identity, Right, sorted_rights

#: For `SSLContext.verify_flags`: OpenSSL's X509_V_FLAG_NO_CHECK_TIME, which the ssl module does not define.
NO_CHECK_TIME = 0x200000

#: The knowledge of a peer: none, by a handshake in this mission, or by an open link between hosts.
PeerStage = Literal["new", "greeted", "linked"]

#: The rights of operators while only the current mission may be finished.
_FINISHING_RIGHTS = frozenset({Right.OBSERVE, Right.STOP})


class RevocationList(Struct, frozen=True):
    """A parsed revocation list: the higher `number` is newer; `at` is its issue time, seconds since 1970
    UTC."""

    number: int = 0
    serials: frozenset[str] = frozenset()
    at: float = 0.0

    def merged(self, other: RevocationList) -> RevocationList:
        """The list of the higher number with the certificates of both."""
        newest = other if other.number > self.number else self
        return replace(newest, serials=self.serials | other.serials)

    def __str__(self) -> str:
        count = len(self.serials)
        return f"list {self.number} of {format_time(self.at)}, with {count} certificate{'s' * (count != 1)}"


#: Replaces a missing list.
NONE_REVOKED = RevocationList()


class AdmissionDecision(Struct, frozen=True):
    """The decision about an authenticated peer; `reason` is the reason for a restriction.

    `finish`: a host may stop and be stopped, and operations under way end, hops included; no new ones start.
    `denied_rights` are rights that the mission denies the peer, each with a sentence that names the rule.
    """

    extent: Literal["all", "finish", "nothing"]
    reason: str = ""
    denied_rights: Mapping[Right, str] = field(default_factory=dict)

    def remaining_rights(self, may: frozenset[Right]) -> frozenset[Right]:
        """The remaining rights of a peer."""
        remaining = (
            may if self.extent == "all" else may & _FINISHING_RIGHTS if self.extent == "finish" else NO_RIGHTS
        )
        return remaining - self.denied_rights.keys()


ALLOWED = AdmissionDecision("all")


def verify_peer(
    identity: Identity,
    *,
    at: float,
    authority: str,
    revoked: RevocationList = NONE_REVOKED,
    known: PeerStage = "new",
    is_mission_active: bool = False,
    expected: str = "",
) -> AdmissionDecision:
    """The decision about a link with a peer; repeat it when the revocation list changes, and periodically.

    `authority` is the fingerprint of the own CA, `expected` the dialled host, '' on the accepting side.
    """
    if identity.kind == "local":
        return ALLOWED
    if foreign := _foreign(identity, authority, expected):
        return AdmissionDecision("nothing", foreign)
    if identity.serial in revoked.serials:
        rights = f" --may {sorted_rights(identity.may) or '...'}" if identity.kind == "person" else ""
        make = f"make new ones with 'lfield keys {_certificate_noun(identity)}{rights}'"
        reason = f"the keys of {identity} are revoked (list {revoked.number}): {make}"
        stays = identity.kind == "host" and known == "linked" and is_mission_active
        return AdmissionDecision("finish" if stays else "nothing", reason)
    if at < identity.valid_from:
        return AdmissionDecision(
            "nothing",
            f"the certificate of {identity} is valid from {format_time(identity.valid_from)}, and here it is "
            f"{format_time(at)}: set the clock",
        )
    if at >= identity.valid_until:
        reason = (
            f"the certificate of {identity} expired {format_time(identity.valid_until)}, and the clock here "
            f"shows {_day(at)}: set the clock if it is wrong, else renew it with 'lfield keys renew "
            f"{_certificate_noun(identity)}'"
        )
        return AdmissionDecision("finish" if known != "new" and is_mission_active else "nothing", reason)
    return ALLOWED


def verify_signer(
    identity: Identity,
    signed: float,
    *,
    at: float,
    authority: str,
    revoked: RevocationList = NONE_REVOKED,
    runs: bool = False,
) -> AdmissionDecision:
    """Whether a bundle that `identity` signed at the time `signed` is accepted.

    `runs`: this host has started this very bundle before, and its mission is not over. Then neither expiry
    nor revocation of the signer's certificate may leave a vehicle without its program.
    """
    if foreign := _foreign(identity, authority, ""):
        return AdmissionDecision("nothing", foreign)
    if identity.kind != "person" or Right.COMMAND not in identity.may:
        reason = f"{identity} may not sign bundles: that takes keys that may 'command'"
        return AdmissionDecision("nothing", reason)
    if not identity.valid_from <= signed < identity.valid_until:
        return AdmissionDecision(
            "nothing",
            f"it was signed {format_time(signed)}, when the certificate of {identity} was not valid",
        )
    sign = "sign it again with 'lfield sign', with keys that may 'command'"
    reason = ""
    if identity.serial in revoked.serials:
        reason = f"the keys of its signer {identity} are revoked (list {revoked.number}): {sign}"
    elif at >= identity.valid_until:
        clock = f"the clock here shows {format_time(at)}, and the bundle was signed {format_time(signed)}"
        ended = f"the certificate of its signer {identity} expired {format_time(identity.valid_until)}"
        reason = f"{ended}; {clock}: set the clock if it is wrong, else {sign}"
    return AdmissionDecision("all" if runs or not reason else "nothing", reason)


def format_time(at: float) -> str:
    """A time for people: `2026-11-23 20:00 UTC`."""
    try:
        return datetime.datetime.fromtimestamp(at, datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    except (ValueError, OverflowError, OSError):
        return "at no time"


def _day(at: float) -> str:
    """The day of a time: a repeated refusal keeps the same text, so it is logged once."""
    return format_time(at)[: len("2026-11-23")]


def _foreign(identity: Identity, authority: str, expected: str) -> str:
    """The reason why a peer is not a member of the team, or not the expected host; '' for the expected
    host.
    """
    if identity.kind == "anonymous":
        return "its certificate names no host and no person: make keys with 'lfield keys'"
    if identity.authority != authority:
        return (
            f"the certificate of {identity} is of the authority {identity.authority[:12] or '(none)'}, and "
            f"ours is {authority[:12]}: give both keys of one authority"
        )
    if expected and (identity.kind, identity.name) != ("host", expected):
        return f"{identity} answers at the address of host {expected}: correct the address, or the keys there"
    return ""


def _certificate_noun(identity: Identity) -> str:
    return f"{identity.kind} {identity.name}"
