"""Parses PEM certificates and keys from untrusted input.

The exceptions of cryptography for malformed bytes have no common base class (a malformed key can raise an
error of OpenSSL itself): all are converted to KeysError here.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable
from typing import TypeVar

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from lfield.errors import KeysError

Read = TypeVar("Read")


def parse_or_error(sentence: str, read: Callable[[], Read]) -> Read:
    """The parsed value; raises KeysError with this sentence when parsing fails."""
    try:
        # lfield makes no certificates that cryptography warns about.
        with warnings.catch_warnings(action="error"):
            return read()
    except KeysError:
        raise
    except Exception as error:
        raise KeysError(sentence) from error


def certificate_in(pem: bytes) -> x509.Certificate:
    """The first certificate in a PEM text. Raises KeysError."""
    sentence = "not a certificate (PEM); copy it again from the authority's folder"
    return parse_or_error(sentence, lambda: x509.load_pem_x509_certificate(pem))


def private_in(pem: bytes) -> Ed25519PrivateKey:
    """The private key in a PEM text. Raises KeysError."""
    sentence = "not a private key (PEM, no password); copy it again"
    key = parse_or_error(sentence, lambda: serialization.load_pem_private_key(pem, None))
    if not isinstance(key, Ed25519PrivateKey):
        raise KeysError("not an Ed25519 key; create keys with 'lfield keys'")
    return key


def public_in(certificate: x509.Certificate) -> Ed25519PublicKey:
    """The public key of a certificate. Raises KeysError."""
    sentence = "not a certificate of an Ed25519 key; create certificates with 'lfield keys'"
    public = parse_or_error(sentence, certificate.public_key)
    if not isinstance(public, Ed25519PublicKey):
        raise KeysError(sentence)
    return public


def fingerprint_of(public: Ed25519PublicKey) -> str:
    """SHA-256 of a public key (its SubjectPublicKeyInfo), in hex."""
    info = public.public_bytes(serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo)
    return hashlib.sha256(info).hexdigest()
