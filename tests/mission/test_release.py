"""The bundles that a host of a team with keys accepts: only those signed by a person with the right."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from missions import write_plain

from lfield.authority.bundle_signature import sign_bundle
from lfield.authority.certificate_authority import CertificateAuthority, new_authority
from lfield.authority.certificate_reader import der_of, fingerprint_in, identity_in
from lfield.authority.identity import Right
from lfield.authority.key_material import Keys
from lfield.authority.peer_verification import RevocationList
from lfield.authority.pem import private_in
from lfield.errors import BundleError, KeysError, SignatureError
from lfield.mission import bundle
from lfield.mission.access.signed_bundle import FROM_FILES, Acceptance, BundleId, accept_bundle
from lfield.mission.loader import load_mission

#: 2026-11-23 20:00 UTC, and a day.
NOW, DAY = 1_795_464_000.0, 86400.0


@dataclass(frozen=True)
class Signer:
    """A person with keys of an authority, from NOW for ten days."""

    authority: CertificateAuthority
    keys: Keys

    def signs(self, data: bytes, at: float = NOW) -> bytes:
        return bundle.with_signature(data, sign_bundle(bundle.contents(data).digest, self.keys, at))

    @property
    def serial(self) -> str:
        return identity_in(self.keys.certificate, self.keys.authority).serial


def signer(authority: CertificateAuthority, may: Right = Right.COMMAND, name: str = "anna") -> Signer:
    issued = authority.issue("person", name, may=[may], at=NOW, ends=NOW + 10 * DAY)
    return Signer(authority, Keys("person", authority.certificate, issued.certificate, issued.key))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return bundle.encode(load_mission(write_plain(tmp_path_factory.mktemp("release"))))


@pytest.fixture(scope="module")
def anna() -> Signer:
    return signer(new_authority(NOW - DAY, NOW + 900 * DAY))


@pytest.fixture(scope="module")
def takes(anna: Signer) -> Callable[..., Acceptance]:
    """The result of a host of anna's authority for the bytes of a bundle."""

    def look(data: bytes, at: float = NOW, **options: object) -> Acceptance:
        certificate = anna.authority.certificate
        release = bundle.decode(data).release
        return accept_bundle(release, certificate, fingerprint_in(certificate), at=at, **options)  # type: ignore[arg-type]

    return look


def why(takes: Callable[..., Acceptance], data: bytes, at: float = NOW, **options: object) -> str:
    with pytest.raises(SignatureError) as error:
        takes(data, at, **options)
    assert error.value.exit_status == 65
    short = bundle.contents(data).digest.hex()[:16]
    assert str(error.value).startswith(f"bundle {short} does not run here: ")
    return str(error.value)


def test_a_signature_does_not_change_the_bundle(data: bytes, anna: Signer) -> None:
    signed = anna.signs(data)
    plain, same = bundle.decode(data), bundle.decode(signed)
    assert same.release.digest == plain.release.digest == bundle.contents(data).digest
    assert (plain.release.signature, bool(same.release.signature)) == (b"", True)
    assert same.program.digest == plain.program.digest
    assert same.team == plain.team
    # A new build needs a new signature.
    assert bundle.encode(same) == data
    assert bundle.with_signature(anna.signs(signed, NOW + 60), b"") == data


def test_the_signer_and_the_time_are_known_after_acceptance(
    data: bytes, anna: Signer, takes: Callable[..., Acceptance]
) -> None:
    release, doubt = takes(anna.signs(data, NOW + 3600.5), NOW + DAY)
    assert (release.by, release.at, doubt) == ("anna", NOW + 3600.0, "")
    short = bundle.contents(data).digest.hex()[:16]
    assert str(release) == f"{short}, signed by anna 2026-11-23 21:00 UTC"
    assert str(bundle.decode(anna.signs(data)).release) == f"{short}, not signed"
    assert str(FROM_FILES) == "no bundle"


def test_an_unsigned_bundle_does_not_run(data: bytes, takes: Callable[..., Acceptance]) -> None:
    assert "it is not signed: sign it with 'lfield sign', with keys that may 'command'" in why(takes, data)
    with pytest.raises(SignatureError, match="runs bundles only: 'lfield build' makes one"):
        accept_bundle(FROM_FILES, b"", "", at=NOW)


def test_signatures_of_another_authority_or_without_the_right_are_refused(
    data: bytes, anna: Signer, takes: Callable[..., Acceptance]
) -> None:
    foreign = signer(new_authority(NOW - DAY, NOW + 900 * DAY))
    assert "is not of this authority" in why(takes, foreign.signs(data))
    # `sign_bundle` refuses that: such a signature was made by other means.
    bob = signer(anna.authority, Right.OPERATE, "bob")
    with pytest.raises(KeysError, match="bob may not sign bundles"):
        bob.signs(data)
    digest, second = bundle.contents(data).digest, int(NOW)
    text = b"lfield bundle\0" + digest + struct.pack("<Q", second)
    seal = [der_of(bob.keys.certificate), second, private_in(bob.keys.key).sign(text)]
    forged = bundle.with_signature(data, msgspec.msgpack.encode(seal))
    assert "bob may not sign bundles: that takes keys that may 'command'" in why(takes, forged)


def test_the_signature_of_another_bundle_is_refused(
    tmp_path: Path, data: bytes, anna: Signer, takes: Callable[..., Acceptance]
) -> None:
    deploy = write_plain(tmp_path)
    deploy.write_text(deploy.read_text() + "//Echo:second@bravo\n")
    other = bundle.encode(load_mission(deploy))
    moved = bundle.with_signature(other, bundle.contents(anna.signs(data)).signature)
    assert "it has changed after anna signed it" in why(takes, moved)


@given(st.data())
def test_any_changed_bit_of_a_signed_bundle_is_detected(
    data: bytes, anna: Signer, takes: Callable[..., Acceptance], draw: st.DataObject
) -> None:
    signed = anna.signs(data)
    at = draw.draw(st.integers(0, 8 * len(signed) - 1))
    changed = bytearray(signed)
    changed[at // 8] ^= 1 << at % 8
    with pytest.raises((SignatureError, BundleError)):
        takes(bytes(changed))


def test_any_changed_bit_of_a_signature_is_detected(
    data: bytes, anna: Signer, takes: Callable[..., Acceptance]
) -> None:
    """The certificate in it has bits that its own signature does not cover, and some that cannot be
    decoded.
    """
    signed = anna.signs(data)
    size = len(bundle.contents(signed).signature)
    for bit in [*range(8 * 80), *range(8 * (size - 160), 8 * size)]:
        bit += 8 * (len(signed) - size)
        changed = bytearray(signed)
        changed[bit // 8] ^= 1 << bit % 8
        with pytest.raises(SignatureError):
            takes(bytes(changed))


def test_an_expired_signer_prevents_a_start_but_stops_no_mission(
    data: bytes, anna: Signer, takes: Callable[..., Acceptance]
) -> None:
    signed, later = anna.signs(data), NOW + 11 * DAY
    assert "the certificate of its signer anna expired 2026-12-03" in why(takes, signed, later)
    release, doubt = takes(signed, later, runs=True)
    assert release.by == "anna"
    assert "expired 2026-12-03" in doubt


def test_a_revoked_signer_prevents_a_start_but_stops_no_mission(
    data: bytes, anna: Signer, takes: Callable[..., Acceptance]
) -> None:
    revoked = RevocationList(3, frozenset({anna.serial}), NOW)
    signed = anna.signs(data)
    assert "the keys of its signer anna are revoked (list 3)" in why(takes, signed, revoked=revoked)
    release, doubt = takes(signed, revoked=revoked, runs=True)
    assert release.by == "anna"
    assert "revoked" in doubt


def test_a_signature_before_the_certificate_is_valid_is_refused(
    data: bytes, anna: Signer, takes: Callable[..., Acceptance]
) -> None:
    with pytest.raises(KeysError, match="not valid at the present time"):
        anna.signs(data, NOW - 60.0)
    # A clock that is behind the signer's changes nothing: the time of the signature is the signer's
    # statement.
    assert takes(anna.signs(data, NOW + 5 * DAY), NOW).bundle.at == NOW + 5 * DAY


def test_invalid_signature_bytes_are_refused(data: bytes, takes: Callable[..., Acceptance]) -> None:
    for signature in (b"\0", b"\xff" * 300, bytes(60_000)):
        assert "its signature cannot be read" in why(takes, bundle.with_signature(data, signature))


def test_a_bundle_id_has_a_short_form() -> None:
    assert BundleId(bytes(range(32))).short == "0001020304050607"
