"""The certificate authority (CA) of a team: certificates of hosts and operators, and the revocation list.

All keys are Ed25519. A certificate carries its identity as in `identity.py`. It is valid from its issue,
never later, so its notBefore proves that this time has passed (`trusted_clock.py`). A host certificate is
valid for servers and clients, one of an operator for clients only, so that it cannot impersonate a host.
The caller gives the time: no clock is read here.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterable, Sequence
from typing import Generic, NamedTuple, TypeVar

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey, EllipticCurvePublicKey
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from lfield.authority.identity import MAX_NAME, Right, uri_of
from lfield.authority.key_material import MAX_LIST, Holder
from lfield.authority.peer_verification import RevocationList
from lfield.authority.pem import certificate_in, fingerprint_of, private_in, public_in
from lfield.errors import KeysError

PrivateKey = Ed25519PrivateKey | EllipticCurvePrivateKey
PublicKey = Ed25519PublicKey | EllipticCurvePublicKey
_Key = TypeVar("_Key", bound=PrivateKey)

#: The last second that a certificate can encode.
_LAST = datetime.datetime(9999, 12, 31, 23, 59, 59, tzinfo=datetime.UTC).timestamp()


class IssuedCertificate(NamedTuple):
    """A certificate and its new private key, both PEM; the key is empty when an existing key was reused."""

    certificate: bytes
    key: bytes = b""


class CertificateSigner(Generic[_Key]):
    """The CA: its own certificate and private key."""

    def __init__(self, certificate: x509.Certificate, key: _Key) -> None:
        self._certificate, self._key = certificate, key

    @property
    def certificate(self) -> bytes:
        """The CA certificate that peers need to verify others, PEM."""
        return self._certificate.public_bytes(serialization.Encoding.PEM)

    @property
    def key(self) -> bytes:
        """The private key, PEM."""
        return private_pem(self._key)

    @property
    def valid_until(self) -> float:
        """notAfter of the CA in seconds since 1970 UTC; no issued certificate is valid longer."""
        return self._certificate.not_valid_after_utc.timestamp()

    def _signed(
        self,
        subject: str,
        public: PublicKey,
        at: float,
        ends: float,
        usages: Iterable[x509.ObjectIdentifier],
        names: Sequence[x509.GeneralName],
    ) -> bytes:
        """A certificate, PEM, that cannot sign others. It expires with the signer at the latest.

        Raises KeysError.
        """
        certificate = (
            certificate_builder(
                self._certificate.subject, subject_of(subject), public, at, min(ends, self.valid_until)
            )
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(usage(signs_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
            .add_extension(x509.SubjectAlternativeName(names), critical=False)
            .add_extension(
                x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), critical=False
            )
            .sign(self._key, None if isinstance(self._key, Ed25519PrivateKey) else SHA256())
        )
        return certificate.public_bytes(serialization.Encoding.PEM)


class CertificateAuthority(CertificateSigner[Ed25519PrivateKey]):
    """An authority with its private key. `fingerprint` is its name: SHA-256 of its public key, in hex."""

    def __init__(self, certificate: x509.Certificate, key: Ed25519PrivateKey) -> None:
        super().__init__(certificate, key)
        self.fingerprint = fingerprint_of(key.public_key())

    def issue(
        self,
        holder: Holder,
        name: str,
        *,
        may: Iterable[Right] = (),
        at: float,
        ends: float,
        renews: bytes = b"",
    ) -> IssuedCertificate:
        """Issue a certificate valid from now (`at`) until `valid_until`, for a new key or the key of
        `renews`.

        It expires with the CA at the latest. Raises KeysError.
        """
        if not 0 < len(name) <= MAX_NAME or not name.isprintable():
            raise KeysError(f"'{name}' is not a valid name: use 1 to {MAX_NAME} printable characters")
        if renews:
            key, public = None, public_in(certificate_in(renews))
        else:
            key = Ed25519PrivateKey.generate()
            public = key.public_key()
        usages = [ExtendedKeyUsageOID.CLIENT_AUTH]
        if holder == "host":
            usages.append(ExtendedKeyUsageOID.SERVER_AUTH)
        identity = x509.UniformResourceIdentifier(uri_of(holder, name, may))
        certificate = self._signed(f"{holder} {name}", public, at, ends, usages, [identity])
        return IssuedCertificate(certificate, private_pem(key) if key is not None else b"")

    def renewed(self, at: float, ends: float) -> CertificateAuthority:
        """The same key and name with a CA certificate that is valid longer; issued certificates stay
        valid."""
        return CertificateAuthority(_own_certificate(self._key, at, ends), self._key)

    def revocation_list(self, revoked: RevocationList) -> bytes:
        """The list, DER. Its nextUpdate has no meaning: a list is valid until one with a higher number."""
        builder = (
            x509.CertificateRevocationListBuilder()
            .issuer_name(self._certificate.subject)
            .last_update(_whole_seconds(revoked.at))
            .next_update(_whole_seconds(math.inf))
            .add_extension(x509.CRLNumber(revoked.number), critical=False)
            .add_extension(
                x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), critical=False
            )
        )
        for serial in sorted(revoked.serials):
            entry = x509.RevokedCertificateBuilder().serial_number(int(serial, 16))
            builder = builder.add_revoked_certificate(
                entry.revocation_date(_whole_seconds(revoked.at)).build()
            )
        data = builder.sign(self._key, None).public_bytes(serialization.Encoding.DER)
        if len(data) > MAX_LIST:
            raise KeysError(
                f"the revocation list is full ({len(revoked.serials)} certificates): begin a new authority "
                "with 'lfield keys init' in another folder, and give everybody keys of that"
            )
        return data


def new_authority(at: float, ends: float) -> CertificateAuthority:
    """A CA with a new key, valid from now (`at`) until `ends`, in seconds since 1970 UTC."""
    key = Ed25519PrivateKey.generate()
    return CertificateAuthority(_own_certificate(key, at, ends), key)


def read_authority(certificate: bytes, key: bytes) -> CertificateAuthority:
    """The CA in two PEM texts. Raises KeysError."""
    read, private = certificate_in(certificate), private_in(key)
    if fingerprint_of(public_in(read)) != fingerprint_of(private.public_key()):
        raise KeysError("authority.key is not the key of authority.pem: put back both of one copy")
    return CertificateAuthority(read, private)


def _own_certificate(key: Ed25519PrivateKey, at: float, ends: float) -> x509.Certificate:
    """The self-signed certificate of a CA. It can only sign certificates that are not CAs."""
    public = key.public_key()
    name = subject_of(fingerprint_of(public))
    return (
        certificate_builder(name, name, public, at, ends)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage(signs_certificates=True), critical=True)
        .sign(key, None)
    )


def certificate_builder(
    issuer: x509.Name,
    subject: x509.Name,
    public: PublicKey,
    at: float,
    ends: float,
) -> x509.CertificateBuilder:
    """A builder for the certificate of a key, valid from `at` until `ends`. Raises KeysError."""
    if not 0.0 <= at < ends:
        raise KeysError("the certificate would end before it begins; give it longer, or renew the authority")
    return (
        x509.CertificateBuilder()
        .issuer_name(issuer)
        .subject_name(subject)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(_whole_seconds(at))
        .not_valid_after(_whole_seconds(ends))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
    )


def subject_of(name: str) -> x509.Name:
    """The subject, for display by other tools only; a common name has at most 64 characters."""
    return x509.Name(
        [
            x509.NameAttribute(NameOID.ORGANIZATION_NAME, "lfield"),
            x509.NameAttribute(NameOID.COMMON_NAME, name[:64]),
        ]
    )


def usage(*, signs_certificates: bool) -> x509.KeyUsage:
    """The key usage: signing certificates and lists, or proof of possession."""
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def private_pem(key: PrivateKey) -> bytes:
    """A private key as PEM, without a password."""
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _whole_seconds(seconds: float) -> datetime.datetime:
    """Certificates encode whole seconds."""
    return datetime.datetime.fromtimestamp(math.floor(min(seconds, _LAST)), datetime.UTC)
