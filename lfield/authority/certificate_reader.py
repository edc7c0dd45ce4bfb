"""Parses certificates and revocation lists and verifies the signature of the CA.

TLS does this for links. This module does it for the own keys, the signer of a bundle, and revocation lists.
All input is untrusted: sizes are bounded, and every fault is a KeysError.
"""

from __future__ import annotations

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding

from lfield.authority.identity import Identity, from_uris
from lfield.authority.key_material import MAX_LIST, MAX_PEM, Keys
from lfield.authority.peer_verification import RevocationList
from lfield.authority.pem import certificate_in, fingerprint_of, parse_or_error, private_in, public_in
from lfield.errors import KeysError

_CERTIFICATE = "the certificate cannot be read: copy it again"


def identity_in(certificate: bytes, authority: bytes) -> Identity:
    """The identity in a certificate; both PEM. Raises KeysError, also for a certificate of another CA."""
    return identity_of_certificate(certificate_in(certificate), authority)


def identity_in_der(certificate: bytes, authority: bytes) -> Identity:
    """The identity in a certificate in DER, as `identity_in`."""
    return identity_of_certificate(certificate_in_der(certificate), authority)


def certificate_in_der(data: bytes) -> x509.Certificate:
    """A certificate in DER. Raises KeysError."""
    if len(data) > MAX_PEM:
        raise KeysError("the certificate is too large")
    read = parse_or_error(_CERTIFICATE, lambda: x509.load_der_x509_certificate(data))
    if not _ends_with(data, read.signature):
        raise KeysError("the certificate is not as lfield makes it: copy it again")
    return read


def der_of(certificate: bytes) -> bytes:
    """The DER of a certificate in a PEM text. Raises KeysError."""
    return certificate_in(certificate).public_bytes(Encoding.DER)


def is_signed_by(certificate: x509.Certificate, signature: bytes, text: bytes) -> bool:
    """Whether the key of a certificate has signed a text. Raises KeysError for another kind of key."""
    try:
        public_in(certificate).verify(signature, text)
    except InvalidSignature:
        return False
    return True


def identity_of_certificate(certificate: x509.Certificate, authority: bytes) -> Identity:
    """The identity in a certificate if the CA in a PEM text has signed it. Raises KeysError."""
    trusted = certificate_in(authority)
    try:
        certificate.verify_directly_issued_by(trusted)
    except (InvalidSignature, ValueError, TypeError, UnsupportedAlgorithm):
        own_ca = fingerprint_of(public_in(trusted))[:12]
        raise KeysError(
            f"the certificate is not of this authority ({own_ca}): give everybody keys of one authority"
        ) from None
    return parse_or_error(
        _CERTIFICATE, lambda: _verified_identity(certificate, fingerprint_of(public_in(trusted)))
    )


def fingerprint_in(authority: bytes) -> str:
    """The fingerprint of the CA in a PEM text. Raises KeysError."""
    return fingerprint_of(public_in(certificate_in(authority)))


def revoked_in(data: bytes, authority: bytes) -> RevocationList:
    """A revocation list, DER, if the CA in a PEM text has signed it. Raises KeysError."""
    if len(data) > MAX_LIST:
        raise KeysError("the revocation list is too large")
    public = public_in(certificate_in(authority))
    return parse_or_error(
        "the revocation list cannot be read: copy it again", lambda: _verified_list(data, public)
    )


def verify_keys(keys: Keys) -> Identity:
    """The identity of the keys. Raises KeysError when key, certificate and CA do not match."""
    identity = identity_in(keys.certificate, keys.authority)
    public = public_in(certificate_in(keys.certificate))
    if identity.kind != keys.holder:
        raise KeysError(f"the certificate is not that of a {keys.holder}, but of {identity}")
    if fingerprint_of(private_in(keys.key).public_key()) != fingerprint_of(public):
        raise KeysError(
            f"the private key is not that of the certificate of {identity}: copy both again, from the folder "
            "that 'lfield keys' has made"
        )
    if keys.revoked:
        revoked_in(keys.revoked, keys.authority)
    return identity


def _verified_identity(certificate: x509.Certificate, authority: str) -> Identity:
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return from_uris(
        names.get_values_for_type(x509.UniformResourceIdentifier),
        serial=certificate.serial_number,
        valid_from=certificate.not_valid_before_utc.timestamp(),
        valid_until=certificate.not_valid_after_utc.timestamp(),
        authority=authority,
    )


def _verified_list(data: bytes, public: Ed25519PublicKey) -> RevocationList:
    read = x509.load_der_x509_crl(data)
    if not (read.is_signature_valid(public) and _ends_with(data, read.signature)):
        raise KeysError("the revocation list is not signed by this authority: copy it again")
    number = read.extensions.get_extension_for_class(x509.CRLNumber).value.crl_number
    serials = frozenset(f"{entry.serial_number:x}" for entry in read)
    return RevocationList(number, serials, read.last_update_utc.timestamp())


def _ends_with(data: bytes, signature: bytes) -> bool:
    """Whether data ends with an Ed25519 signature without unused bits: their number is not signed."""
    return data.endswith(b"\x03\x41\x00" + signature)
