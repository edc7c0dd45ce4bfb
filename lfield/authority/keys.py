"""The keys of a host or of a person, as bytes, and what the files are called that have them.

    authority.pem              the certificate of the team's authority: what everybody trusts
    host.pem, person.pem       the own certificate, signed by the authority
    host.key, person.key       the private key of it; nobody else may read it
    revoked.crl                whose certificates count no more: of a host always, if only an empty one

Certificates and keys are PEM, which OpenSSL reads; the list is DER, as it travels.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

#: Who has keys.
Holder = Literal["host", "person"]

#: The largest certificate or key that is read, and the largest list, in bytes. A list of 1,500 fits.
MAX_PEM, MAX_LIST = 16 << 10, 64 << 10

#: The certificate of a page, in a folder of its own (pages/page_keys.py).
PAGE = "page.crt"

AUTHORITY, REVOKED = "authority.pem", "revoked.crl"


def certificate_name(holder: Holder) -> str:
    """The name of the file with the own certificate."""
    return f"{holder}.pem"


def key_name(holder: Holder) -> str:
    """The name of the file with the private key."""
    return f"{holder}.key"


@dataclass(frozen=True, slots=True)
class Keys:
    """What somebody proves with who they are, and what they hold others against.

    `authority`, `certificate` and `key` are PEM; `revoked` is DER, empty where there is no list.
    """

    holder: Holder
    authority: bytes
    certificate: bytes
    #: What is printed is kept, so this is not.
    key: bytes = field(repr=False)
    revoked: bytes = b""
