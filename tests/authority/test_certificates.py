"""Certificates and revocation lists: issue, reading, and the check by OpenSSL on both ends of a link."""

from __future__ import annotations

import os
import ssl

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from hypothesis import given
from hypothesis import strategies as st

from lfield.authority.certificate_authority import CertificateAuthority, new_authority, read_authority
from lfield.authority.certificate_reader import (
    der_of,
    fingerprint_in,
    identity_in,
    identity_in_der,
    revoked_in,
    verify_keys,
)
from lfield.authority.ephemeral_ca import EphemeralCa
from lfield.authority.identity import ALL_RIGHTS, ANONYMOUS, Identity, Right, identity_of
from lfield.authority.key_material import MAX_LIST, Keys
from lfield.authority.peer_verification import NO_CHECK_TIME, RevocationList
from lfield.errors import KeysError

AT, DAY = 1795464000.0, 86400.0


@pytest.fixture(scope="module")
def authority() -> CertificateAuthority:
    return new_authority(AT, AT + 3650 * DAY)


@pytest.fixture(scope="module")
def other_authority() -> CertificateAuthority:
    return new_authority(AT, AT + 3650 * DAY)


def keys_of(
    authority: CertificateAuthority, name: str = "alpha", holder="host", ends: float = AT + DAY, may=()
) -> Keys:
    issued = authority.issue(holder, name, may=may, at=AT, ends=ends)
    return Keys(holder, authority.certificate, issued.certificate, issued.key)


def test_issued_keys_have_the_name_and_rights_of_their_holder(authority: CertificateAuthority) -> None:
    identity = verify_keys(keys_of(authority, "alpha"))
    assert (identity.kind, identity.name, identity.may) == ("host", "alpha", frozenset())
    assert (identity.valid_from, identity.valid_until, identity.authority) == (
        AT,
        AT + DAY,
        authority.fingerprint,
    )
    anna = verify_keys(keys_of(authority, "anna", "person", may=[Right.STOP, Right.OBSERVE]))
    assert (anna.kind, anna.name, anna.may) == ("person", "anna", {Right.STOP, Right.OBSERVE})
    assert fingerprint_in(authority.certificate) == authority.fingerprint


def test_validity_is_limited_by_the_authority_and_not_negative(
    authority: CertificateAuthority,
) -> None:
    assert verify_keys(keys_of(authority, ends=AT + 1e12)).valid_until == authority.valid_until
    with pytest.raises(KeysError, match="would end before it begins"):
        keys_of(authority, ends=AT)
    with pytest.raises(KeysError, match="is not a valid name"):
        keys_of(authority, "al\npha")


def test_renewed_certificate_keeps_the_key(authority: CertificateAuthority) -> None:
    old = keys_of(authority)
    renewed = authority.issue("host", "alpha", at=AT + 1, ends=AT + 9 * DAY, renews=old.certificate)
    assert renewed.key == b""
    both = Keys("host", authority.certificate, renewed.certificate, old.key)
    assert verify_keys(both).valid_until == AT + 9 * DAY
    assert verify_keys(both).serial != verify_keys(old).serial


def test_authority_is_read_and_renewed_with_the_same_key(
    authority: CertificateAuthority, other_authority
) -> None:
    old = keys_of(authority)
    again = read_authority(authority.certificate, authority.key)
    later = again.renewed(AT + DAY, AT + 9999 * DAY)
    assert later.fingerprint == authority.fingerprint
    assert identity_in(old.certificate, later.certificate) == verify_keys(old)
    assert verify_keys(keys_of(later, ends=AT + 9000 * DAY)).valid_until == AT + 9000 * DAY
    with pytest.raises(KeysError, match=r"authority.key is not the key of authority.pem"):
        read_authority(authority.certificate, other_authority.key)


def test_mismatched_keys_are_refused(
    authority: CertificateAuthority, other_authority: CertificateAuthority
) -> None:
    alpha, bravo = keys_of(authority), keys_of(authority, "bravo")
    for wrong, text in (
        (
            Keys("host", alpha.authority, alpha.certificate, bravo.key),
            "not that of the certificate of host a",
        ),
        (
            Keys("person", alpha.authority, alpha.certificate, alpha.key),
            "is not that of a person, but of h",
        ),
        (Keys("host", other_authority.certificate, alpha.certificate, alpha.key), "is not of this authority"),
        (Keys("host", alpha.authority, b"x", alpha.key), "not a certificate"),
        (Keys("host", alpha.authority, alpha.certificate, b"x"), "not a private key"),
        (Keys("host", alpha.authority, alpha.certificate, alpha.key, b"x"), "revocation list cannot be read"),
    ):
        with pytest.raises(KeysError, match=text):
            verify_keys(wrong)


def test_keys_of_another_kind_are_refused(authority: CertificateAuthority) -> None:
    curve = ec.generate_private_key(ec.SECP256R1())
    pem = curve.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    with pytest.raises(KeysError, match="not an Ed25519 key"):
        read_authority(authority.certificate, pem)


def test_authority_certificate_has_no_identity(authority: CertificateAuthority) -> None:
    with pytest.raises(KeysError, match="cannot be read"):
        identity_in(authority.certificate, authority.certificate)


def test_private_key_is_not_printed(authority: CertificateAuthority) -> None:
    assert "PRIVATE" not in repr(keys_of(authority))


# --- revocation lists --------------------------------------------------------------------------------------


def test_revocation_list_is_read_back(authority: CertificateAuthority) -> None:
    revoked = RevocationList(7, frozenset({"1", "a1b", "f" * 39}), AT + 5)
    assert revoked_in(authority.revocation_list(revoked), authority.certificate) == revoked
    empty = RevocationList(1, frozenset(), AT)
    assert revoked_in(authority.revocation_list(empty), authority.certificate) == empty


def test_foreign_or_changed_revocation_list_is_refused(authority, other_authority) -> None:
    data = authority.revocation_list(RevocationList(7, frozenset({"a1b"}), AT))
    with pytest.raises(KeysError, match="not signed by this authority"):
        revoked_in(data, other_authority.certificate)
    for at in range(len(data)):
        for bit in (1, 128):
            wrong = data[:at] + bytes([data[at] ^ bit]) + data[at + 1 :]
            with pytest.raises(KeysError):
                revoked_in(wrong, authority.certificate)
    for wrong in (data + b"\0", data[:-1], b"", b"\0" * (MAX_LIST + 1)):
        with pytest.raises(KeysError):
            revoked_in(wrong, authority.certificate)


def test_error_for_a_full_revocation_list_names_the_remedy(authority: CertificateAuthority) -> None:
    many = frozenset(f"{n:x}" for n in range(1 << 80, (1 << 80) + 3000))
    with pytest.raises(KeysError, match="begin a new authority"):
        authority.revocation_list(RevocationList(9, many, AT))


def test_certificate_with_any_changed_byte_is_refused(authority: CertificateAuthority) -> None:
    der = der_of(keys_of(authority).certificate)
    for at in range(len(der)):
        for bit in (1, 128):
            wrong = der[:at] + bytes([der[at] ^ bit]) + der[at + 1 :]
            with pytest.raises(KeysError):
                identity_in_der(wrong, authority.certificate)


@given(st.binary(max_size=300))
def test_random_bytes_are_no_certificate_and_no_list(authority: CertificateAuthority, data: bytes) -> None:
    for read in (identity_in_der, identity_in, revoked_in):
        with pytest.raises(KeysError):
            read(data, authority.certificate)


# --- TLS handshakes ----------------------------------------------------------------------------------------


def context(keys: Keys, *, server: bool) -> ssl.SSLContext:
    made = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if server else ssl.PROTOCOL_TLS_CLIENT)
    made.minimum_version = ssl.TLSVersion.TLSv1_3
    made.check_hostname, made.verify_mode = False, ssl.CERT_REQUIRED
    made.verify_flags |= ssl.VERIFY_X509_STRICT | ssl.VerifyFlags(NO_CHECK_TIME)
    made.load_verify_locations(cadata=keys.authority.decode())
    descriptor = os.memfd_create("keys")
    os.write(descriptor, keys.certificate + keys.key)
    made.load_cert_chain(f"/proc/self/fd/{descriptor}")
    os.close(descriptor)
    return made


def handshake(client_keys: Keys, server_keys: Keys) -> tuple[Identity, Identity]:
    """Do a handshake in memory. Return the identities that the client and the server found for their peer."""
    to_client, to_server = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = context(client_keys, server=False).wrap_bio(to_client, to_server)
    server = context(server_keys, server=True).wrap_bio(to_server, to_client, server_side=True)
    done = set()
    for _ in range(4):
        for side in (client, server):
            try:
                side.do_handshake()
                done.add(side)
            except ssl.SSLWantReadError:
                pass
    assert len(done) == 2
    return identity_of(client.getpeercert() or {}), identity_of(server.getpeercert() or {})


def test_tls_peers_see_the_identities_of_the_certificates(authority: CertificateAuthority) -> None:
    """OpenSSL also accepts expired certificates, because admission checks the validity."""
    alpha, bravo = (keys_of(authority, name, ends=AT + 1) for name in ("alpha", "bravo"))
    assert handshake(alpha, bravo) == (verify_keys(bravo), verify_keys(alpha))
    anna = keys_of(authority, "anna", "person", may=ALL_RIGHTS)
    assert handshake(anna, bravo)[1] == verify_keys(anna)


def test_tls_refuses_keys_of_another_authority(
    authority: CertificateAuthority, other_authority: CertificateAuthority
) -> None:
    with pytest.raises(ssl.SSLError, match="verify failed"):
        handshake(keys_of(authority), keys_of(other_authority))


def test_tls_refuses_a_person_as_server(authority: CertificateAuthority) -> None:
    with pytest.raises(ssl.SSLError, match="unsuitable certificate purpose"):
        handshake(keys_of(authority), keys_of(authority, "bravo", "person", may=ALL_RIGHTS))


def test_host_key_cannot_issue_certificates(authority: CertificateAuthority) -> None:
    """A certificate signed by a host's key belongs to no authority."""
    alpha = keys_of(authority)
    forged = read_authority(alpha.certificate, alpha.key).issue("host", "bravo", at=AT, ends=AT + DAY)
    with pytest.raises(KeysError, match="not of this authority"):
        identity_in(forged.certificate, authority.certificate)


# --- ephemeral keys ----------------------------------------------------------------------------------------


def test_ephemeral_keys_share_one_private_authority() -> None:
    ephemeral = EphemeralCa.for_hosts(["alpha", "bravo"], AT, "anna")
    assert [(name, verify_keys(keys).name) for name, keys in ephemeral.hosts.items()] == [
        ("alpha", "alpha"),
        ("bravo", "bravo"),
    ]
    assert (verify_keys(ephemeral.operator).name, verify_keys(ephemeral.operator).may) == ("anna", ALL_RIGHTS)
    assert handshake(ephemeral.operator, ephemeral.hosts["alpha"])[0].name == "alpha"
    other = EphemeralCa.for_hosts(["alpha"], AT)
    with pytest.raises(ssl.SSLError):
        handshake(ephemeral.hosts["bravo"], other.hosts["alpha"])
    assert ANONYMOUS not in handshake(ephemeral.hosts["bravo"], ephemeral.hosts["alpha"])
