"""The keys of a web page on a network: the files of its folder, its names and its validity.

    page.crt    its certificate, followed by intermediate certificates, if any
    page.key    its private key; readable by the owner only

'lfield keys page' makes them with the root CA for browsers. A certificate of another CA, private or public,
can be used as well: the browser decides which CAs it trusts.
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

from lfield.authority.key_material import MAX_PEM, WEB_CERTIFICATE
from lfield.authority.keystore import read_file
from lfield.authority.peer_verification import format_time
from lfield.authority.pem import parse_or_error
from lfield.authority.web_ca.web_names import is_match
from lfield.errors import KeysError
from lfield.text.secure_files import write_private
from lfield.text.suggestions import listed

CERTIFICATE, KEY = WEB_CERTIFICATE, "page.key"


@dataclass(frozen=True, slots=True)
class WebKeys:
    """The keys of a page. `names` are the addresses and names in its certificate, `certificate` (with its
    chain) and `key` are PEM; `valid_from` and `valid_until` are seconds since 1970 UTC."""

    names: tuple[str, ...]
    valid_from: float
    valid_until: float
    certificate: bytes
    #: Not in repr(): printed text may be stored.
    key: bytes = field(repr=False)

    def refusal(self, name: str, at: float) -> str:
        """The reason why a page may not be served under this name at the time `at`, and the remedy; '' if
        it may.
        """
        make = f"'lfield keys page {name}' makes one"
        if not any(is_match(named, name) for named in self.names):
            return f"the page's certificate is for {listed(self.names)}, not for {name}: {make}"
        if at >= self.valid_until:
            return f"the page's certificate ended {format_time(self.valid_until)}: {make}"
        if at < self.valid_from:
            return (
                f"the page's certificate begins {format_time(self.valid_from)}, and here it is "
                f"{format_time(at)}: set the clock"
            )
        return ""


def read_web_keys(folder: Path) -> WebKeys:
    """Read the keys in a folder. Raises KeysError, which names the file and the remedy."""
    if not (folder / CERTIFICATE).exists():
        raise KeysError(
            f"{folder} has no keys of a page ({CERTIFICATE}, {KEY}): 'lfield keys page ADDRESS' makes some, "
            "where the authority is"
        )
    chain = read_file(folder / CERTIFICATE, MAX_PEM)
    key = read_file(folder / KEY, MAX_PEM, secret=True)
    try:
        return parse_web_keys(chain, key)
    except KeysError as error:
        raise KeysError(f"{folder}: {error}") from None


def parse_web_keys(chain: bytes, key: bytes) -> WebKeys:
    """The keys in two PEM texts; the first certificate is that of the page. Raises KeysError."""
    sentence = f"{CERTIFICATE} is not a certificate (PEM) with names of servers: copy it again"
    first = parse_or_error(sentence, lambda: x509.load_pem_x509_certificates(chain))[0]
    public, names = parse_or_error(sentence, lambda: (first.public_key(), _names_in(first)))
    sentence = f"{KEY} is not a private key (PEM, no password): copy it again"
    private = parse_or_error(sentence, lambda: serialization.load_pem_private_key(key, None))
    if not isinstance(public, EllipticCurvePublicKey | RSAPublicKey):
        raise KeysError("browsers take keys of RSA and of NIST's curves alone: 'lfield keys page' makes one")
    if _public_der(private.public_key()) != _public_der(public):
        raise KeysError(f"{KEY} is not the key of the first certificate in {CERTIFICATE}: copy both again")
    not_before, ends = first.not_valid_before_utc.timestamp(), first.not_valid_after_utc.timestamp()
    return WebKeys(names, not_before, ends, chain, key)


def write_web_keys(folder: Path, certificate: bytes, key: bytes) -> None:
    """Write the files, each atomically, into a new or existing folder. Raises OutputFileError."""
    write_private(folder / KEY, key, 0o600, durable=True)
    write_private(folder / CERTIFICATE, certificate, 0o644, durable=True)


def _names_in(certificate: x509.Certificate) -> tuple[str, ...]:
    """The names in a certificate. Raises exceptions of cryptography if there are none."""
    found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    addresses: Sequence[object] = found.get_values_for_type(x509.IPAddress)
    return (*map(str, addresses), *map(str.lower, found.get_values_for_type(x509.DNSName)))


def _public_der(public: PublicKeyTypes) -> bytes:
    return public.public_bytes(serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo)
