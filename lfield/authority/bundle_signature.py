"""The signature of a bundle, made with keys that have the right `command`.

Encoded as msgpack: the signer's certificate, the time, and an Ed25519 signature of

    "lfield bundle\\0"  32 bytes digest of the bundle  u64 seconds since 1970 UTC, little-endian

The prefix prevents that another signature of the same key is accepted as one of a bundle. The digest covers
every part of a bundle. The signer states the time; `peer_verification` checks it.
"""

from __future__ import annotations

import struct
from typing import Annotated, NamedTuple

import msgspec
from msgspec import Meta

from lfield.authority.certificate_reader import (
    certificate_in_der,
    der_of,
    identity_in_der,
    is_signed_by,
    verify_keys,
)
from lfield.authority.identity import Identity, Right
from lfield.authority.key_material import MAX_PEM, Keys
from lfield.authority.pem import private_in
from lfield.errors import KeysError, SignatureError

_PURPOSE = b"lfield bundle\0"


class _Seal(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    certificate: Annotated[bytes, Meta(max_length=MAX_PEM)]
    at: Annotated[int, Meta(ge=0, lt=1 << 40)]
    signature: Annotated[bytes, Meta(min_length=64, max_length=64)]


class BundleSignature(NamedTuple):
    """The signer of a bundle, and the time of signing by the signer's clock, in seconds since 1970 UTC."""

    identity: Identity
    at: float


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(_Seal)


def sign_bundle(digest: bytes, keys: Keys, at: float) -> bytes:
    """Sign a bundle of this digest at the time `at`. Raises KeysError for keys without the right."""
    identity = verify_keys(keys)
    if Right.COMMAND not in identity.may:
        raise KeysError(
            f"{identity} may not sign bundles: that takes keys that may 'command' ('lfield keys person NAME "
            "--may command')"
        )
    if not identity.valid_from <= at < identity.valid_until:
        raise KeysError(
            f"the certificate of {identity} is not valid at the present time: set the clock, or renew it"
        )
    second = int(at)
    signature = private_in(keys.key).sign(_signed_text(digest, second))
    return _encoder.encode(_Seal(der_of(keys.certificate), second, signature))


def verify_bundle(digest: bytes, signature: bytes, authority: bytes) -> BundleSignature:
    """The signer of the bundle with this digest, verified with the CA in a PEM text.

    This verifies the signature only; the digests of the parts are checked by `bundle.contents`, the right
    of the signer by `verify_signer`. Raises SignatureError.
    """
    if not signature:
        raise SignatureError("it is not signed: sign it with 'lfield sign', with keys that may 'command'")
    try:
        seal = _decoder.decode(signature)
        identity = identity_in_der(seal.certificate, authority)
        is_valid = is_signed_by(
            certificate_in_der(seal.certificate), seal.signature, _signed_text(digest, seal.at)
        )
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise SignatureError("its signature cannot be read: sign it again with 'lfield sign'") from None
    except KeysError as error:
        raise SignatureError(f"its signature is not accepted: {error}") from None
    if not is_valid:
        raise SignatureError(
            f"it has changed after {identity} signed it: copy it again, or sign it with 'lfield sign'"
        )
    return BundleSignature(identity, float(seal.at))


def _signed_text(digest: bytes, at: int) -> bytes:
    return _PURPOSE + digest + struct.pack("<Q", at)
