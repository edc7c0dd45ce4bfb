"""Signatures of bundles: the signer, and the detection of changes."""

from __future__ import annotations

import hashlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.authority.bundle_signature import sign_bundle, verify_bundle
from lfield.authority.certificate_authority import new_authority
from lfield.authority.certificate_reader import verify_keys
from lfield.authority.ephemeral_ca import EphemeralCa
from lfield.authority.identity import Right
from lfield.authority.key_material import Keys
from lfield.errors import KeysError, SignatureError

AT, DAY = 1795464000.0, 86400.0
DIGEST = hashlib.sha256(b"a bundle").digest()


@pytest.fixture(scope="module")
def ephemeral() -> EphemeralCa:
    return EphemeralCa.for_hosts(["alpha"], AT, "anna")


@pytest.fixture(scope="module")
def signature(ephemeral: EphemeralCa) -> bytes:
    return sign_bundle(DIGEST, ephemeral.operator, AT + 7.5)


def test_signature_has_the_signer_and_the_time(ephemeral: EphemeralCa, signature: bytes) -> None:
    assert verify_bundle(DIGEST, signature, ephemeral.authority) == (
        verify_keys(ephemeral.operator),
        AT + 7.0,
    )
    assert len(signature) < 1000


def test_signing_without_command_right_is_refused(ephemeral: EphemeralCa) -> None:
    with pytest.raises(KeysError, match="host alpha may not sign bundles"):
        sign_bundle(DIGEST, ephemeral.hosts["alpha"], AT)
    authority = new_authority(AT, AT + DAY)
    issued = authority.issue("person", "bob", may=set(Right) - {Right.COMMAND}, at=AT, ends=AT + DAY)
    with pytest.raises(KeysError, match="bob may not sign bundles"):
        sign_bundle(DIGEST, Keys("person", authority.certificate, issued.certificate, issued.key), AT)


def test_signing_outside_the_validity_period_is_refused(ephemeral: EphemeralCa) -> None:
    for at in (AT - 1.0, AT + 1e9):
        with pytest.raises(KeysError, match="is not valid at the present time"):
            sign_bundle(DIGEST, ephemeral.operator, at)


def check_refused(digest: bytes, signature: bytes, authority: bytes, words: str = ".") -> None:
    with pytest.raises(SignatureError, match=words):
        verify_bundle(digest, signature, authority)


def test_signature_of_another_bundle_or_authority_is_refused(
    ephemeral: EphemeralCa, signature: bytes
) -> None:
    other = hashlib.sha256(b"another").digest()
    check_refused(other, signature, ephemeral.authority, "it has changed after anna signed it")
    check_refused(DIGEST, b"", ephemeral.authority, "it is not signed: sign it with 'lfield sign'")
    check_refused(DIGEST, signature + b"\0", ephemeral.authority, "cannot be read: sign it again")
    foreign = EphemeralCa.for_hosts([], AT).authority
    check_refused(DIGEST, signature, foreign, "is not accepted: the certificate is not of this authority")


def test_signature_with_a_changed_bit_is_refused(ephemeral: EphemeralCa, signature: bytes) -> None:
    for at in range(len(signature)):
        wrong = signature[:at] + bytes([signature[at] ^ 1]) + signature[at + 1 :]
        check_refused(DIGEST, wrong, ephemeral.authority)


@given(st.data())
def test_signature_with_removed_or_added_bytes_is_refused(
    ephemeral: EphemeralCa, signature: bytes, data: st.DataObject
) -> None:
    at = data.draw(st.integers(0, len(signature) - 1))
    check_refused(DIGEST, signature[:at], ephemeral.authority)
    check_refused(
        DIGEST, signature[:at] + data.draw(st.binary(min_size=1)) + signature[at:], ephemeral.authority
    )


@given(st.binary(min_size=1, max_size=400))
def test_random_bytes_are_no_signature(ephemeral: EphemeralCa, data: bytes) -> None:
    check_refused(DIGEST, data, ephemeral.authority)
