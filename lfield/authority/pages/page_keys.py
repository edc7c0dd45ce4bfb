"""The keys of a page on a network: what a folder has, where it may be served with that, and until when.

    page.crt    its certificate, and after it those between it and a root, if there are any
    page.key    the private key of the first; nobody else may read it

'lfield keys page' makes them, under the root for browsers. A certificate that others have made, of an
operator's own authority or of a public one, serves as well: what browsers believe is theirs to say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePublicKey
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPublicKey
from cryptography.hazmat.primitives.asymmetric.types import PublicKeyTypes

from lfield.authority.folder import read_file
from lfield.authority.judge import when
from lfield.authority.keys import MAX_PEM, PAGE
from lfield.authority.pages.names import covers
from lfield.authority.pem import sound
from lfield.errors import KeysError
from lfield.text.private import write_private
from lfield.text.suggest import listed

CERTIFICATE, KEY = PAGE, "page.key"


@dataclass(frozen=True, slots=True)
class PageKeys:
    """The keys of a page. `names` are the addresses and names that its certificate is for, `certificate`
    (with those above it) and `key` are PEM; `begins` and `ends` are seconds since 1970 UTC."""

    names: tuple[str, ...]
    begins: float
    ends: float
    certificate: bytes
    #: What is printed is kept, so this is not.
    key: bytes = field(repr=False)

    def refusal(self, name: str, at: float) -> str:
        """Why a page may not be served under this name now (`at`), with what to do; '' when it may."""
        make = f"'lfield keys page {name}' makes one"
        if not any(covers(named, name) for named in self.names):
            return f"the page's certificate is for {listed(self.names)}, not for {name}: {make}"
        if at >= self.ends:
            return f"the page's certificate ended {when(self.ends)}: {make}"
        if at < self.begins:
            return (
                f"the page's certificate begins {when(self.begins)}, and here it is {when(at)}: set the clock"
            )
        return ""


def read_page(folder: Path) -> PageKeys:
    """The keys in a folder. Raises KeysError, which names the file and what to do."""
    if not (folder / CERTIFICATE).exists():
        raise KeysError(
            f"{folder} has no keys of a page ({CERTIFICATE}, {KEY}): 'lfield keys page ADDRESS' makes some, "
            "where the authority is"
        )
    chain = read_file(folder / CERTIFICATE, MAX_PEM)
    key = read_file(folder / KEY, MAX_PEM, secret=True)
    try:
        return page_keys(chain, key)
    except KeysError as error:
        raise KeysError(f"{folder}: {error}") from None


def page_keys(chain: bytes, key: bytes) -> PageKeys:
    """The keys in two PEM texts, whose first certificate is that of the page. Raises KeysError."""
    sentence = f"{CERTIFICATE} is no certificate (PEM) with names of servers: copy it again"
    first = sound(sentence, lambda: x509.load_pem_x509_certificates(chain))[0]
    public, names = sound(sentence, lambda: (first.public_key(), _names(first)))
    sentence = f"{KEY} is no private key (PEM, no password): copy it again"
    private = sound(sentence, lambda: serialization.load_pem_private_key(key, None))
    if not isinstance(public, EllipticCurvePublicKey | RSAPublicKey):
        raise KeysError("browsers take keys of RSA and of NIST's curves alone: 'lfield keys page' makes one")
    if _info(private.public_key()) != _info(public):
        raise KeysError(f"{KEY} is not the key of the first certificate in {CERTIFICATE}: copy both again")
    begins, ends = first.not_valid_before_utc.timestamp(), first.not_valid_after_utc.timestamp()
    return PageKeys(names, begins, ends, chain, key)


def write_page(folder: Path, certificate: bytes, key: bytes) -> None:
    """Write them, each file whole or not at all, into a new folder or over others. Raises OutputFileError."""
    write_private(folder / KEY, key, 0o600, durable=True)
    write_private(folder / CERTIFICATE, certificate, 0o644, durable=True)


def _names(certificate: x509.Certificate) -> tuple[str, ...]:
    """Raises whatever cryptography does where there are none."""
    found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    addresses: Sequence[object] = found.get_values_for_type(x509.IPAddress)
    return (*map(str, addresses), *map(str.lower, found.get_values_for_type(x509.DNSName)))


def _info(public: PublicKeyTypes) -> bytes:
    return public.public_bytes(serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo)
