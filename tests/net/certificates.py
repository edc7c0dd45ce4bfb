"""Certificates for tests of links, good ones and others."""

from __future__ import annotations

import datetime
from collections.abc import Iterable
from dataclasses import dataclass

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.x509.oid import NameOID

from lfield.authority.identity import uri_of
from lfield.net.tls import Tls

BEGIN, END = datetime.datetime(2026, 1, 1), datetime.datetime(2099, 1, 1)


@dataclass(frozen=True)
class Shown:
    """A certificate and its key."""

    certificate: x509.Certificate
    key: Ed25519PrivateKey

    @property
    def pem(self) -> bytes:
        return self.certificate.public_bytes(serialization.Encoding.PEM)

    @property
    def key_pem(self) -> bytes:
        return self.key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )


def made(
    name: str,
    uris: Iterable[str] = (),
    *,
    signer: Shown | None = None,
    ca: bool = False,
    begin: datetime.datetime = BEGIN,
    end: datetime.datetime = END,
) -> Shown:
    """A certificate, signed by itself where nobody else signs it."""
    key = Ed25519PrivateKey.generate()
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(signer.certificate.subject if signer else subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin)
        .not_valid_after(end)
        .add_extension(x509.BasicConstraints(ca=ca, path_length=0 if ca else None), critical=True)
    )
    alternatives = [x509.UniformResourceIdentifier(uri) for uri in uris]
    if alternatives:
        builder = builder.add_extension(x509.SubjectAlternativeName(alternatives), critical=False)
    return Shown(builder.sign(signer.key if signer else key, None), key)


class Team:
    """An authority and what it signs."""

    def __init__(self) -> None:
        self.authority = made("a" * 64, ca=True)

    def host(self, name: str, **options) -> Shown:
        return made(name, [uri_of("host", name)], signer=self.authority, **options)

    def person(self, name: str, *may: str, **options) -> Shown:
        return made(name, [uri_of("person", name, may)], signer=self.authority, **options)

    def tls(self, shown: Shown) -> Tls:
        """What whoever has that certificate proves itself with, who believes this authority."""
        return Tls(shown.pem, shown.key_pem, self.authority.pem)
