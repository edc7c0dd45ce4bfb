"""Whether somebody who has proven who they are may be linked with now, or have signed what flies. Pure.

OpenSSL has seen that a certificate is signed by the authority. It is told not to look at times
(`NO_CHECK_TIME`), for it knows only this computer's clock and can only say no. A vehicle in the air whose
certificate ends must still stop, be stopped and bring home what it carries: so the answer is yes, no, or
yes to finish only. `at` is always the believed time (`believed.py`).

    | certificate of a peer   | new, or nothing flies | known, and the mission flies     |
    |-------------------------|-----------------------|----------------------------------|
    | ended                   | no                    | to finish                        |
    | revoked, of a host      | no                    | to finish, on a link that stands |
    | revoked, of a person    | no                    | no                               |

A revoked key may be in wrong hands, so nobody dials anew with one; a link that stands was made before. That
is the host's own link: one on which its key only looks, or stops, carries nothing home. A host that is cut
off cannot know of a revocation.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from lfield.authority.identity import NONE, Identity, Right, in_order

#: For `SSLContext.verify_flags`: OpenSSL's X509_V_FLAG_NO_CHECK_TIME, which the ssl module has no name for.
NO_CHECK_TIME = 0x200000

#: How a peer is known here: not at all, greeted in this mission before, or by a host's link that stands.
Known = Literal["new", "greeted", "linked"]

#: What is left to people while there is only something to finish.
_TO_FINISH = frozenset({Right.OBSERVE, Right.STOP})


@dataclass(frozen=True, slots=True)
class Revoked:
    """A revocation list as read: the higher `number` counts; `at` is when it was made, since 1970 UTC."""

    number: int = 0
    serials: frozenset[str] = frozenset()
    at: float = 0.0

    def united(self, other: Revoked) -> Revoked:
        """The list of the higher number, with what either of them revokes."""
        newest = other if other.number > self.number else self
        return replace(newest, serials=self.serials | other.serials)

    def __str__(self) -> str:
        count = len(self.serials)
        return f"list {self.number} of {when(self.at)}, with {count} certificate{'s' * (count != 1)}"


#: Where there is no list.
NOBODY = Revoked()


@dataclass(frozen=True, slots=True)
class Verdict:
    """What somebody may who has proven who they are; `why` is the sentence unless all is well.

    `finish`: a host may stop and be stopped, and what is under way ends, hops included; nothing begins.
    `barred` are rights that the mission takes from somebody, each with a sentence that says by which rule.
    """

    extent: Literal["all", "finish", "nothing"]
    why: str = ""
    barred: Mapping[Right, str] = field(default_factory=dict)

    def left(self, may: frozenset[Right]) -> frozenset[Right]:
        """What is left of somebody's rights."""
        left = may if self.extent == "all" else may & _TO_FINISH if self.extent == "finish" else NONE
        return left - self.barred.keys()


ALL_IS_WELL = Verdict("all")


def judged(
    who: Identity,
    *,
    at: float,
    authority: str,
    revoked: Revoked = NOBODY,
    known: Known = "new",
    flies: bool = False,
    expected: str = "",
) -> Verdict:
    """Whether to link with somebody now, and for what; ask again when the list changes, and now and then.

    `authority` is the fingerprint of ours, `expected` the host that was dialled, '' on the side that was.
    """
    if who.kind == "local":
        return ALL_IS_WELL
    if foreign := _foreign(who, authority, expected):
        return Verdict("nothing", foreign)
    if who.serial in revoked.serials:
        rights = f" --may {in_order(who.may) or '...'}" if who.kind == "person" else ""
        make = f"make new ones with 'lfield keys {_noun(who)}{rights}'"
        why = f"the keys of {who} are revoked (list {revoked.number}): {make}"
        stays = who.kind == "host" and known == "linked" and flies
        return Verdict("finish" if stays else "nothing", why)
    if at < who.begins:
        return Verdict(
            "nothing",
            f"the certificate of {who} begins {when(who.begins)}, and here it is {when(at)}: set the clock",
        )
    if at >= who.ends:
        why = (
            f"the certificate of {who} ended {when(who.ends)}: renew it with 'lfield keys renew {_noun(who)}'"
        )
        return Verdict("finish" if known != "new" and flies else "nothing", why)
    return ALL_IS_WELL


def judged_signer(
    who: Identity,
    signed: float,
    *,
    at: float,
    authority: str,
    revoked: Revoked = NOBODY,
    runs: bool = False,
) -> Verdict:
    """Whether a bundle counts that `who` has signed at the time `signed`: yes or no.

    `runs`: this host has begun this very bundle before, and its mission is not over. Then the end of the
    signer's certificate, or its revocation, is no reason to leave a vehicle without its program.
    """
    if foreign := _foreign(who, authority, ""):
        return Verdict("nothing", foreign)
    if who.kind != "person" or Right.COMMAND not in who.may:
        why = f"{who} may not sign bundles: that takes keys that may 'command'"
        return Verdict("nothing", why)
    if not who.begins <= signed < who.ends:
        return Verdict(
            "nothing", f"it was signed {when(signed)}, when the certificate of {who} was not valid"
        )
    sign = "let somebody who may 'command' sign it again with 'lfield sign'"
    why = ""
    if who.serial in revoked.serials:
        why = f"the keys of {who}, who signed it, are revoked (list {revoked.number}): {sign}"
    elif at >= who.ends:
        why = f"the certificate of {who}, who signed it, ended {when(who.ends)}: {sign}"
    return Verdict("all" if runs or not why else "nothing", why)


def when(at: float) -> str:
    """A time for people: `2026-11-23 20:00 UTC`."""
    try:
        return datetime.datetime.fromtimestamp(at, datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    except (ValueError, OverflowError, OSError):
        return "at no time"


def _foreign(who: Identity, authority: str, expected: str) -> str:
    """Why somebody is not one of ours, or not the one that was meant; '' for one of ours."""
    if who.kind == "stranger":
        return "its certificate names no host and no person: make keys with 'lfield keys'"
    if who.authority != authority:
        return (
            f"the certificate of {who} is of the authority {who.authority[:12] or '(none)'}, and ours is "
            f"{authority[:12]}: give both keys of one authority"
        )
    if expected and (who.kind, who.name) != ("host", expected):
        return f"{who} answers where host {expected} should: correct the address, or the keys there"
    return ""


def _noun(who: Identity) -> str:
    return f"{who.kind} {who.name}"
