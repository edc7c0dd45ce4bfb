"""Who the other end of a link is, as proven, and what that one may do.

A certificate says it in the URIs of its subjectAltName, which the team's authority has signed:

    lfield://host/alpha                      a host, by its name in the deployment
    lfield://person/anna?may=observe,stop    a person, with rights

A certificate is of one of them. With none of ours, with several, or with one that is not written as this
file writes it, it proves nothing: a name has one spelling only. The issuer's common name is the fingerprint
of the authority: SHA-256 of its public key, in hex.

Nothing here asks whether a certificate is good: TLS has seen its signature, `judge.py` judges the rest.
"""

from __future__ import annotations

import calendar
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Literal
from urllib.parse import quote, unquote


class Right(StrEnum):
    """What a person may do. A host needs none of them: it speaks the protocol of hosts."""

    #: See what runs: `ps`, `query`, status.
    OBSERVE = "observe"
    #: Make everything safe: `estop`, and `pause`, which does no more.
    STOP = "stop"
    #: Have things go on: `resume`, lifting a stop, `forget`, `recover`.
    OPERATE = "operate"
    #: Say what flies: sign bundles.
    COMMAND = "command"


ALL = frozenset(Right)
NONE: frozenset[Right] = frozenset()

#: What a right brings along: who may have a team go on may stop it, and who may stop it may look.
_BRINGS = {Right.OPERATE: {Right.STOP, Right.OBSERVE}, Right.STOP: {Right.OBSERVE}}

Kind = Literal["host", "person", "local", "stranger"]

#: The longest name of a host or person, in characters.
MAX_NAME = 128


@dataclass(frozen=True, slots=True)
class Identity:
    """Who somebody is. `str()` is how sentences name them.

    `local` is a user of this computer, as the kernel says (`name` is the user's). `serial` is the number of
    the certificate in hex (lower case, no leading zeros), `begins` and `ends` are seconds since 1970 UTC,
    `authority` is the fingerprint of who signed it.
    """

    kind: Kind
    name: str
    may: frozenset[Right]
    serial: str = ""
    begins: float = 0.0
    ends: float = math.inf
    authority: str = ""

    def __str__(self) -> str:
        if self.kind == "local":
            return f"user {self.name} of this computer"
        return self.name if self.kind == "person" else f"host {self.name}" if self.name else "a stranger"


#: Somebody who has proven nothing.
STRANGER = Identity("stranger", "", NONE)


def with_brought(rights: Iterable[Right]) -> frozenset[Right]:
    """Rights, and those that they bring along; certificates are made with all of them."""
    given = frozenset(rights)
    return given.union(*(_BRINGS.get(right, ()) for right in given))


def in_order(rights: Iterable[Right]) -> str:
    """Rights as certificates and sentences list them: `observe,stop`."""
    held = frozenset(rights)
    return ",".join(right for right in Right if right in held)


def uri_of(kind: Literal["host", "person"], name: str, may: Iterable[Right] = ()) -> str:
    """What a certificate says of a host, or of a person with rights."""
    path = f"lfield://{kind}/{quote(name, safe='')}"
    return f"{path}?may={in_order(may)}" if kind == "person" else path


def identity_of(certificate: Mapping[str, Any]) -> Identity:
    """Whom a certificate names that TLS has verified, as `ssl.SSLSocket.getpeercert()` gives it.

    Whatever is not as an authority of lfield writes it is a STRANGER; nothing is raised.
    """
    try:
        return from_uris(
            (text for kind, text in certificate["subjectAltName"] if kind == "URI"),
            serial=int(certificate["serialNumber"], 16),
            begins=seconds_of(certificate["notBefore"]),
            ends=seconds_of(certificate["notAfter"]),
            authority=_common_name(certificate["issuer"]),
        )
    except (KeyError, ValueError, TypeError, AttributeError):
        return STRANGER


def from_uris(uris: Iterable[str], *, serial: int, begins: float, ends: float, authority: str) -> Identity:
    """The same of the fields of a certificate that was read in another way."""
    ours = [uri for uri in uris if uri.lower().startswith("lfield:")]
    if len(ours) != 1:
        return STRANGER
    try:
        kind, name, may = _read(ours[0])
    except ValueError:
        return STRANGER
    return Identity(kind, name, may, f"{serial:x}", begins, ends, authority)


_URI = re.compile(r"lfield://(host|person)/([^/?#]+)(?:\?may=([a-z,]*))?", re.ASCII)


def _read(uri: str) -> tuple[Literal["host", "person"], str, frozenset[Right]]:
    """Raises ValueError for what `uri_of` does not write. Rights of a newer lfield are left out."""
    found = _URI.fullmatch(uri)
    if found is None:
        raise ValueError("no name of ours")
    kind, name = found[1], unquote(found[2], errors="strict")
    if quote(name, safe="") != found[2] or len(name) > MAX_NAME or not name.isprintable():
        raise ValueError("a name has one spelling")
    if kind == "host":
        if found[3] is not None:
            raise ValueError("a host has no rights")
        return "host", name, NONE
    if found[3] is None:
        raise ValueError("a person without a list of rights")
    return "person", name, frozenset(right for right in Right if right in found[3].split(","))


def _common_name(issuer: Iterable[Iterable[tuple[str, str]]]) -> str:
    """The fingerprint of the authority, which is its common name."""
    names = [value for part in issuer for key, value in part if key == "commonName"]
    if len(names) != 1 or re.fullmatch(r"[0-9a-f]{64}", names[0]) is None:
        raise ValueError("no authority of ours")
    return names[0]


_MONTHS = {
    name: number
    for number, name in enumerate(
        ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"), 1
    )
}
_TIME = re.compile(r"([A-Z][a-z]{2}) ([ \d]\d) (\d\d):(\d\d):(\d\d) (\d{4}) GMT", re.ASCII)


def seconds_of(text: str) -> float:
    """Seconds since 1970 UTC of a time as OpenSSL prints it: `Nov  3 20:00:00 2026 GMT`.

    `ssl.cert_time_to_seconds` does the same, and this room does without sockets. Raises ValueError.
    """
    found = _TIME.fullmatch(text)
    if found is None or found[1] not in _MONTHS:
        raise ValueError(f"no time: {text}")
    day, hour, minute, second, year = (int(found[n]) for n in (2, 3, 4, 5, 6))
    return float(calendar.timegm((year, _MONTHS[found[1]], day, hour, minute, second)))
