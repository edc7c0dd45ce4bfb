"""The signature of a bundle: who says that this may fly. Who has keys that may `command` makes it.

It is msgpack: the signer's certificate, the time, and an Ed25519 signature of

    "lfield bundle\\0"  32 bytes digest of the bundle  u64 seconds since 1970 UTC, little-endian

so that no other signature that the same key ever makes can be taken for it. The digest covers every part of a
bundle. The time is the signer's own word: `judge.judged_signer` says what it is worth.
"""

from __future__ import annotations

import struct
from typing import Annotated, NamedTuple

import msgspec
from msgspec import Meta

from lfield.authority.identity import Identity, Right
from lfield.authority.keys import MAX_PEM, Keys
from lfield.authority.pem import private_in
from lfield.authority.reading import certificate_in_der, checked, der_of, identity_in_der, is_signed_by
from lfield.errors import KeysError, SignatureError

_PURPOSE = b"lfield bundle\0"


class _Seal(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    certificate: Annotated[bytes, Meta(max_length=MAX_PEM)]
    at: Annotated[int, Meta(ge=0, lt=1 << 40)]
    signature: Annotated[bytes, Meta(min_length=64, max_length=64)]


class Signed(NamedTuple):
    """Who has signed a bundle, and when that was by the signer's clock, in seconds since 1970 UTC."""

    who: Identity
    at: float


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(_Seal)


def sign(digest: bytes, keys: Keys, at: float) -> bytes:
    """The signature of a bundle of this digest, now (`at`). Raises KeysError for keys that may not."""
    who = checked(keys)
    if Right.COMMAND not in who.may:
        raise KeysError(
            f"{who} may not sign bundles: that takes keys that may 'command' ('lfield keys person NAME --may "
            "command')"
        )
    if not who.begins <= at < who.ends:
        raise KeysError(f"the certificate of {who} is not valid now: set the clock, or renew it")
    second = int(at)
    signature = private_in(keys.key).sign(_text(digest, second))
    return _encoder.encode(_Seal(der_of(keys.certificate), second, signature))


def signed(digest: bytes, signature: bytes, authority: bytes) -> Signed:
    """Who has signed the bundle of this digest, if anybody of the authority in a PEM text has.

    That nobody has changed the bundle is seen by this, and by its digests (`bundle.contents`); whether the
    signer may, `judge.judged_signer` says. Raises SignatureError.
    """
    if not signature:
        raise SignatureError("nobody has signed it: 'lfield sign' does, with keys that may 'command'")
    try:
        seal = _decoder.decode(signature)
        who = identity_in_der(seal.certificate, authority)
        sound = is_signed_by(certificate_in_der(seal.certificate), seal.signature, _text(digest, seal.at))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise SignatureError("its signature cannot be read: sign it again with 'lfield sign'") from None
    except KeysError as error:
        raise SignatureError(f"its signature does not count: {error}") from None
    if not sound:
        raise SignatureError(f"it is not what {who} has signed: copy it again, or sign it with 'lfield sign'")
    return Signed(who, float(seal.at))


def _text(digest: bytes, at: int) -> bytes:
    return _PURPOSE + digest + struct.pack("<Q", at)
