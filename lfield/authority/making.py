"""The authority of a team: makes the certificates of hosts and persons, and the list of those revoked.

All keys are Ed25519. A certificate says its identity as `identity.py` reads it; it holds from the moment in
which it is made, never from later on, so its begin is the authority's word that it was this time already
(`believed.py`). A host may be called and call; a person only calls, so that nobody who has a person's keys
can pass for a host. Who makes them gives the time: no clock is read here.
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
from lfield.authority.judge import Revoked
from lfield.authority.keys import MAX_LIST, Holder
from lfield.authority.pem import certificate_in, fingerprint_of, private_in, public_in
from lfield.errors import KeysError

PrivateKey = Ed25519PrivateKey | EllipticCurvePrivateKey
PublicKey = Ed25519PublicKey | EllipticCurvePublicKey
_Key = TypeVar("_Key", bound=PrivateKey)

#: The last second that a certificate can tell.
_LAST = datetime.datetime(9999, 12, 31, 23, 59, 59, tzinfo=datetime.UTC).timestamp()


class Issued(NamedTuple):
    """A certificate, and the private key that was made for it, both PEM; no key where it was there before."""

    certificate: bytes
    key: bytes = b""


class Signer(Generic[_Key]):
    """Whoever signs certificates, with one of its own and the private key."""

    def __init__(self, certificate: x509.Certificate, key: _Key) -> None:
        self._certificate, self._key = certificate, key

    @property
    def certificate(self) -> bytes:
        """What whoever believes it has to have, PEM."""
        return self._certificate.public_bytes(serialization.Encoding.PEM)

    @property
    def key(self) -> bytes:
        """Its private key, PEM. Whoever has it can sign the same."""
        return private_pem(self._key)

    @property
    def ends(self) -> float:
        """Until when it holds, in seconds since 1970 UTC; nothing that it makes holds longer."""
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
        """A certificate, PEM, of somebody who signs none. It ends with the signer at the latest.

        Raises KeysError.
        """
        made = (
            begun(self._certificate.subject, subject_of(subject), public, at, min(ends, self.ends))
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(usage(signs_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
            .add_extension(x509.SubjectAlternativeName(names), critical=False)
            .add_extension(
                x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), critical=False
            )
            .sign(self._key, None if isinstance(self._key, Ed25519PrivateKey) else SHA256())
        )
        return made.public_bytes(serialization.Encoding.PEM)


class Authority(Signer[Ed25519PrivateKey]):
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
    ) -> Issued:
        """A certificate from now (`at`) until `ends`, for a new key, or that of a certificate it `renews`.

        It ends with the authority at the latest. Raises KeysError.
        """
        if not 0 < len(name) <= MAX_NAME or not name.isprintable():
            raise KeysError(
                f"'{name}' is no name: give one of 1 to {MAX_NAME} characters that can be printed"
            )
        if renews:
            key, public = None, public_in(certificate_in(renews))
        else:
            key = Ed25519PrivateKey.generate()
            public = key.public_key()
        usages = [ExtendedKeyUsageOID.CLIENT_AUTH]
        if holder == "host":
            usages.append(ExtendedKeyUsageOID.SERVER_AUTH)
        identity = x509.UniformResourceIdentifier(uri_of(holder, name, may))
        made = self._signed(f"{holder} {name}", public, at, ends, usages, [identity])
        return Issued(made, private_pem(key) if key is not None else b"")

    def renewed(self, at: float, ends: float) -> Authority:
        """The same key and name with a certificate of its own until later; what it has made stays good."""
        return Authority(_own_certificate(self._key, at, ends), self._key)

    def revocation_list(self, revoked: Revoked) -> bytes:
        """The list, DER. Its end says nothing: it holds until there is one with a higher number."""
        builder = (
            x509.CertificateRevocationListBuilder()
            .issuer_name(self._certificate.subject)
            .last_update(_moment(revoked.at))
            .next_update(_moment(math.inf))
            .add_extension(x509.CRLNumber(revoked.number), critical=False)
            .add_extension(
                x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), critical=False
            )
        )
        for serial in sorted(revoked.serials):
            entry = x509.RevokedCertificateBuilder().serial_number(int(serial, 16))
            builder = builder.add_revoked_certificate(entry.revocation_date(_moment(revoked.at)).build())
        data = builder.sign(self._key, None).public_bytes(serialization.Encoding.DER)
        if len(data) > MAX_LIST:
            raise KeysError(
                f"the revocation list is full ({len(revoked.serials)} certificates): begin a new authority "
                "with 'lfield keys init' in another folder, and give everybody keys of that"
            )
        return data


def new_authority(at: float, ends: float) -> Authority:
    """An authority with a key of its own, from now (`at`) until `ends`, in seconds since 1970 UTC."""
    key = Ed25519PrivateKey.generate()
    return Authority(_own_certificate(key, at, ends), key)


def read_authority(certificate: bytes, key: bytes) -> Authority:
    """The authority in two PEM texts. Raises KeysError."""
    read, private = certificate_in(certificate), private_in(key)
    if fingerprint_of(public_in(read)) != fingerprint_of(private.public_key()):
        raise KeysError("authority.key is not the key of authority.pem: put back both of one copy")
    return Authority(read, private)


def _own_certificate(key: Ed25519PrivateKey, at: float, ends: float) -> x509.Certificate:
    """The certificate of an authority, which it signs itself. It can only sign what is none."""
    public = key.public_key()
    name = subject_of(fingerprint_of(public))
    return (
        begun(name, name, public, at, ends)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage(signs_certificates=True), critical=True)
        .sign(key, None)
    )


def begun(
    issuer: x509.Name,
    subject: x509.Name,
    public: PublicKey,
    at: float,
    ends: float,
) -> x509.CertificateBuilder:
    """A certificate of a key from `at` until `ends`, to be added to and signed. Raises KeysError."""
    if not 0.0 <= at < ends:
        raise KeysError("the certificate would end before it begins; give it longer, or renew the authority")
    return (
        x509.CertificateBuilder()
        .issuer_name(issuer)
        .subject_name(subject)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(_moment(at))
        .not_valid_after(_moment(ends))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
    )


def subject_of(name: str) -> x509.Name:
    """For people who look at it with other tools; a common name has 64 characters at most."""
    return x509.Name(
        [
            x509.NameAttribute(NameOID.ORGANIZATION_NAME, "lfield"),
            x509.NameAttribute(NameOID.COMMON_NAME, name[:64]),
        ]
    )


def usage(*, signs_certificates: bool) -> x509.KeyUsage:
    """What a key is for: to sign certificates and lists, or to prove that one has it."""
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


def _moment(seconds: float) -> datetime.datetime:
    """Certificates have whole seconds."""
    return datetime.datetime.fromtimestamp(math.floor(min(seconds, _LAST)), datetime.UTC)
