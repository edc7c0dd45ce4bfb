"""The proven identity of a peer, and its rights.

An identity is a URI in the subjectAltName of a certificate that the CA of the team has signed:

    lfield://host/alpha                      a host, by its name in the deployment
    lfield://person/anna?may=observe,stop    a person, with rights

A certificate contains exactly one such URI, in the normal form of this module; otherwise the peer has no
identity. The common name of the issuer is the fingerprint of the CA: SHA-256 of its public key, in hex.

Validity is not checked here: TLS verifies the signature, `peer_verification` the rest.
"""

from __future__ import annotations

import calendar
import math
import re
from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Any, Literal
from urllib.parse import quote, unquote

from msgspec import Struct


class Right(StrEnum):
    """A right of an operator. A host needs none: it uses the protocol between hosts."""

    #: Read status: `ps`, `query`.
    OBSERVE = "observe"
    #: Make devices safe: `estop` and `pause`.
    STOP = "stop"
    #: Continue operation: `resume`, lifting a stop, `forget`, `recover`.
    OPERATE = "operate"
    #: Choose the mission: sign bundles.
    COMMAND = "command"


ALL_RIGHTS = frozenset(Right)
NO_RIGHTS: frozenset[Right] = frozenset()

#: Implied rights: `resume` includes `stop`, and `stop` includes `observe`.
_IMPLIES = {Right.OPERATE: {Right.STOP, Right.OBSERVE}, Right.STOP: {Right.OBSERVE}}

Kind = Literal["host", "person", "local", "anonymous"]

#: The longest name of a host or person, in characters.
MAX_NAME = 128


class Identity(Struct, frozen=True):
    """An identity; `str()` is its name in messages.

    `local` is a user of this computer, identified by the kernel (`name` is the user name). `serial` is the
    serial number of the certificate in hex (lower case, no leading zeros), `valid_from` and `valid_until` are
    seconds since 1970 UTC, `authority` is the fingerprint of the issuing CA.
    """

    kind: Kind
    name: str
    may: frozenset[Right]
    serial: str = ""
    valid_from: float = 0.0
    valid_until: float = math.inf
    authority: str = ""

    def __str__(self) -> str:
        if self.kind == "local":
            return f"user {self.name} of this computer"
        if self.kind == "person":
            return self.name
        return f"host {self.name}" if self.name else "an unauthenticated peer"


#: A peer without proof of identity.
ANONYMOUS = Identity("anonymous", "", NO_RIGHTS)


def with_implied(rights: Iterable[Right]) -> frozenset[Right]:
    """Rights with those that they imply; a certificate lists all of them."""
    explicit = frozenset(rights)
    return explicit.union(*(_IMPLIES.get(right, ()) for right in explicit))


def sorted_rights(rights: Iterable[Right]) -> str:
    """Rights as certificates and messages list them: `observe,stop`."""
    held = frozenset(rights)
    return ",".join(right for right in Right if right in held)


def uri_of(kind: Literal["host", "person"], name: str, may: Iterable[Right] = ()) -> str:
    """The URI of a host, or of a person with rights."""
    path = f"lfield://{kind}/{quote(name, safe='')}"
    return f"{path}?may={sorted_rights(may)}" if kind == "person" else path


def identity_of(certificate: Mapping[str, Any]) -> Identity:
    """The identity in a certificate that TLS has verified, from `ssl.SSLSocket.getpeercert()`.

    A certificate with other contents than a CA of lfield writes is ANONYMOUS; no error is raised.
    """
    try:
        return from_uris(
            (text for kind, text in certificate["subjectAltName"] if kind == "URI"),
            serial=int(certificate["serialNumber"], 16),
            valid_from=seconds_of(certificate["notBefore"]),
            valid_until=seconds_of(certificate["notAfter"]),
            authority=_common_name(certificate["issuer"]),
        )
    except (KeyError, ValueError, TypeError, AttributeError):
        return ANONYMOUS


def from_uris(
    uris: Iterable[str], *, serial: int, valid_from: float, valid_until: float, authority: str
) -> Identity:
    """The identity from the fields of a certificate that was parsed by other means."""
    lfield_uris = [uri for uri in uris if uri.lower().startswith("lfield:")]
    if len(lfield_uris) != 1:
        return ANONYMOUS
    try:
        kind, name, may = _read(lfield_uris[0])
    except ValueError:
        return ANONYMOUS
    return Identity(kind, name, may, f"{serial:x}", valid_from, valid_until, authority)


_URI = re.compile(r"lfield://(host|person)/([^/?#]+)(?:\?may=([a-z,]*))?", re.ASCII)


def _read(uri: str) -> tuple[Literal["host", "person"], str, frozenset[Right]]:
    """Parse a URI. Raises ValueError unless `uri_of` writes it. Rights of a newer lfield are ignored."""
    match = _URI.fullmatch(uri)
    if match is None:
        raise ValueError("no name of ours")
    kind, name = match[1], unquote(match[2], errors="strict")
    if quote(name, safe="") != match[2] or len(name) > MAX_NAME or not name.isprintable():
        raise ValueError("a name has one spelling")
    if kind == "host":
        if match[3] is not None:
            raise ValueError("a host has no rights")
        return "host", name, NO_RIGHTS
    if match[3] is None:
        raise ValueError("a person without a list of rights")
    return "person", name, frozenset(right for right in Right if right in match[3].split(","))


def _common_name(issuer: Iterable[Iterable[tuple[str, str]]]) -> str:
    """The fingerprint of the CA, which is the common name."""
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
    """Seconds since 1970 UTC of a time as printed by OpenSSL: `Nov  3 20:00:00 2026 GMT`.

    Like `ssl.cert_time_to_seconds`, but this package does not import sockets. Raises ValueError.
    """
    found = _TIME.fullmatch(text)
    if found is None or found[1] not in _MONTHS:
        raise ValueError(f"no time: {text}")
    day, hour, minute, second, year = (int(found[n]) for n in (2, 3, 4, 5, 6))
    return float(calendar.timegm((year, _MONTHS[found[1]], day, hour, minute, second)))
