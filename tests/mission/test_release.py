"""Which bundles a host of a team with keys takes: those alone that somebody has signed who may."""

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
    """Somebody with keys of an authority, from NOW for ten days."""

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
    """What a host of anna's authority does with the bytes of a bundle."""

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


def test_a_signature_changes_nothing_of_the_bundle(data: bytes, anna: Signer) -> None:
    signed = anna.signs(data)
    plain, same = bundle.decode(data), bundle.decode(signed)
    assert same.release.digest == plain.release.digest == bundle.contents(data).digest
    assert (plain.release.signature, bool(same.release.signature)) == (b"", True)
    assert same.program.digest == plain.program.digest
    assert same.team == plain.team
    # Who builds it anew signs it anew.
    assert bundle.encode(same) == data
    assert bundle.with_signature(anna.signs(signed, NOW + 60), b"") == data


def test_who_has_signed_it_and_when_is_known_from_then_on(
    data: bytes, anna: Signer, takes: Callable[..., Acceptance]
) -> None:
    release, doubt = takes(anna.signs(data, NOW + 3600.5), NOW + DAY)
    assert (release.by, release.at, doubt) == ("anna", NOW + 3600.0, "")
    short = bundle.contents(data).digest.hex()[:16]
    assert str(release) == f"{short}, signed by anna 2026-11-23 21:00 UTC"
    assert str(bundle.decode(anna.signs(data)).release) == f"{short}, not signed"
    assert str(FROM_FILES) == "no bundle"


def test_what_nobody_has_signed_does_not_run(data: bytes, takes: Callable[..., Acceptance]) -> None:
    assert "it is not signed: sign it with 'lfield sign', with keys that may 'command'" in why(takes, data)
    with pytest.raises(SignatureError, match="runs bundles only: 'lfield build' makes one"):
        accept_bundle(FROM_FILES, b"", "", at=NOW)


def test_another_authority_and_other_people_do_not_count(
    data: bytes, anna: Signer, takes: Callable[..., Acceptance]
) -> None:
    foreign = signer(new_authority(NOW - DAY, NOW + 900 * DAY))
    assert "is not of this authority" in why(takes, foreign.signs(data))
    # `sign_bundle` refuses that: it is a signature that somebody has made by other means.
    bob = signer(anna.authority, Right.OPERATE, "bob")
    with pytest.raises(KeysError, match="bob may not sign bundles"):
        bob.signs(data)
    digest, second = bundle.contents(data).digest, int(NOW)
    text = b"lfield bundle\0" + digest + struct.pack("<Q", second)
    seal = [der_of(bob.keys.certificate), second, private_in(bob.keys.key).sign(text)]
    forged = bundle.with_signature(data, msgspec.msgpack.encode(seal))
    assert "bob may not sign bundles: that takes keys that may 'command'" in why(takes, forged)


def test_the_signature_of_another_bundle_does_not_count(
    tmp_path: Path, data: bytes, anna: Signer, takes: Callable[..., Acceptance]
) -> None:
    deploy = write_plain(tmp_path)
    deploy.write_text(deploy.read_text() + "//Echo:second@bravo\n")
    other = bundle.encode(load_mission(deploy))
    moved = bundle.with_signature(other, bundle.contents(anna.signs(data)).signature)
    assert "it has changed after anna signed it" in why(takes, moved)


@given(st.data())
def test_one_bit_changed_anywhere_is_seen(
    data: bytes, anna: Signer, takes: Callable[..., Acceptance], draw: st.DataObject
) -> None:
    signed = anna.signs(data)
    at = draw.draw(st.integers(0, 8 * len(signed) - 1))
    changed = bytearray(signed)
    changed[at // 8] ^= 1 << at % 8
    with pytest.raises((SignatureError, BundleError)):
        takes(bytes(changed))


def test_every_bit_of_a_signature_counts(data: bytes, anna: Signer, takes: Callable[..., Acceptance]) -> None:
    """The certificate in it has bits that its own signature says nothing of, and some that cannot be read."""
    signed = anna.signs(data)
    size = len(bundle.contents(signed).signature)
    for bit in [*range(8 * 80), *range(8 * (size - 160), 8 * size)]:
        bit += 8 * (len(signed) - size)
        changed = bytearray(signed)
        changed[bit // 8] ^= 1 << bit % 8
        with pytest.raises(SignatureError):
            takes(bytes(changed))


def test_a_signer_whose_certificate_has_ended_signs_no_start_and_stops_no_mission(
    data: bytes, anna: Signer, takes: Callable[..., Acceptance]
) -> None:
    signed, later = anna.signs(data), NOW + 11 * DAY
    assert "the certificate of its signer anna expired 2026-12-03" in why(takes, signed, later)
    release, doubt = takes(signed, later, runs=True)
    assert release.by == "anna"
    assert "expired 2026-12-03" in doubt


def test_a_revoked_signer_signs_no_start_and_stops_no_mission(
    data: bytes, anna: Signer, takes: Callable[..., Acceptance]
) -> None:
    revoked = RevocationList(3, frozenset({anna.serial}), NOW)
    signed = anna.signs(data)
    assert "the keys of its signer anna are revoked (list 3)" in why(takes, signed, revoked=revoked)
    release, doubt = takes(signed, revoked=revoked, runs=True)
    assert release.by == "anna"
    assert "revoked" in doubt


def test_nobody_has_signed_before_their_certificate_began(
    data: bytes, anna: Signer, takes: Callable[..., Acceptance]
) -> None:
    with pytest.raises(KeysError, match="not valid at the present time"):
        anna.signs(data, NOW - 60.0)
    # A clock that is behind the signer's changes nothing: when it was signed is the signer's word.
    assert takes(anna.signs(data, NOW + 5 * DAY), NOW).bundle.at == NOW + 5 * DAY


def test_bytes_that_are_no_signature(data: bytes, takes: Callable[..., Acceptance]) -> None:
    for signature in (b"\0", b"\xff" * 300, bytes(60_000)):
        assert "its signature cannot be read" in why(takes, bundle.with_signature(data, signature))


def test_a_release_is_short_where_people_compare_it() -> None:
    assert BundleId(bytes(range(32))).short == "0001020304050607"
