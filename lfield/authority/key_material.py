"""The keys of a host or operator as bytes, and the names of their files.

    authority.pem              certificate of the team's CA, which every member trusts
    host.pem, person.pem       own certificate, signed by the CA
    host.key, person.key       its private key; readable by the owner only
    revoked.crl                revocation list; a host always has one, even if empty

Certificates and keys are PEM, which OpenSSL reads; the list is DER.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

#: The kinds of holders.
Holder = Literal["host", "person"]

#: The largest certificate or key that is read, and the largest list, in bytes. A list of 1,500 entries fits.
MAX_PEM, MAX_LIST = 16 << 10, 64 << 10

#: The certificate of a web page, in its own folder (web_ca/web_keys.py).
WEB_CERTIFICATE = "page.crt"

AUTHORITY, REVOKED = "authority.pem", "revoked.crl"


def certificate_name(holder: Holder) -> str:
    """The name of the file with the certificate."""
    return f"{holder}.pem"


def key_name(holder: Holder) -> str:
    """The name of the file with the private key."""
    return f"{holder}.key"


@dataclass(frozen=True, slots=True)
class Keys:
    """The own certificate and private key, the CA certificate and the revocation list.

    `authority`, `certificate` and `key` are PEM; `revoked` is DER, empty without a list.
    """

    holder: Holder
    authority: bytes
    certificate: bytes
    #: Not in repr(): printed text may be stored.
    key: bytes = field(repr=False)
    revoked: bytes = b""
