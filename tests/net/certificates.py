"""Valid and invalid certificates for tests of links."""

from __future__ import annotations

import datetime
from collections.abc import Iterable
from dataclasses import dataclass

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.x509.oid import NameOID

from lfield.authority.certificate_authority import new_authority
from lfield.authority.identity import Right
from lfield.authority.key_material import Keys
from lfield.authority.peer_verification import RevocationList
from lfield.authority.pem import certificate_in, private_in
from lfield.authority.web_ca.browser_ca import new_browser_ca

NOT_BEFORE, END = (datetime.datetime(year, 1, 1, tzinfo=datetime.UTC) for year in (2026, 2099))


@dataclass(frozen=True)
class CertificateWithKey:
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
    signer: CertificateWithKey | None = None,
) -> CertificateWithKey:
    """A certificate, self-signed if there is no signer."""
    key = Ed25519PrivateKey.generate()
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(signer.certificate.subject if signer else subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(NOT_BEFORE)
        .not_valid_after(END)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    )
    alternatives = [x509.UniformResourceIdentifier(uri) for uri in uris]
    if alternatives:
        builder = builder.add_extension(x509.SubjectAlternativeName(alternatives), critical=False)
    return CertificateWithKey(builder.sign(signer.key if signer else key, None), key)


class Team:
    """A certificate authority and what it signs."""

    def __init__(self) -> None:
        self.authority = new_authority(NOT_BEFORE.timestamp(), END.timestamp())
        self._root = new_browser_ca(NOT_BEFORE.timestamp(), END.timestamp())

    def host(self, name: str, *, begin: float = NOT_BEFORE.timestamp(), end: float = END.timestamp()) -> Keys:
        issued = self.authority.issue("host", name, at=begin, ends=end)
        return Keys("host", self.authority.certificate, issued.certificate, issued.key)

    def person(self, name: str, *may: Right, end: float = END.timestamp()) -> Keys:
        issued = self.authority.issue("person", name, may=may, at=NOT_BEFORE.timestamp(), ends=end)
        return Keys("person", self.authority.certificate, issued.certificate, issued.key)

    def unusual(self, *uris: str) -> Keys:
        """Keys with these names, which the authority would not issue."""
        signer = CertificateWithKey(
            certificate_in(self.authority.certificate), private_in(self.authority.key)
        )
        return self.with_(made("odd", uris, signer=signer))

    def with_(self, shown: CertificateWithKey) -> Keys:
        """Any certificate and key, of an owner that trusts this authority."""
        return Keys("host", self.authority.certificate, shown.pem, shown.key_pem)

    def page(self) -> Keys:
        """The keys of a web page, which browsers trust; the owner trusts this authority."""
        issued = self._root.issue(["10.0.0.1"], at=NOT_BEFORE.timestamp(), ends=END.timestamp())
        return Keys("host", self.authority.certificate, issued.certificate, issued.key)

    def browsers(self) -> Keys:
        """The root CA of the pages, in the same form."""
        return Keys("host", self.authority.certificate, self._root.certificate, self._root.key)

    def revoked(self, number: int, *keys: Keys) -> bytes:
        """The revocation list with those keys."""
        serials = frozenset(f"{certificate_in(one.certificate).serial_number:x}" for one in keys)
        return self.authority.revocation_list(RevocationList(number, serials, NOT_BEFORE.timestamp()))
