"""The credentials of a host: which keys it accepts, what time it believes, where it stores a list."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace

import pytest

from lfield.authority import certificate_reader, keystore
from lfield.authority.admission_policy import CertificateAdmission
from lfield.authority.certificate_reader import identity_in, revoked_in
from lfield.clock import ManualClock
from lfield.errors import KeysError, UsageError
from lfield.host.process import crl_store
from lfield.host.process.credentials import HostCredentials, admission_for, require_credentials
from lfield.host.process.crl_store import CrlStore, write_crl
from lfield.net.tls import TlsIdentity
from lfield.testing.keyring import VALIDITY, Keyring
from lfield.wire.messages import Hello

DAY = 86400.0


@pytest.fixture
def ring(tmp_path):
    return Keyring(tmp_path / "keys")


def now(at: float = 0.0) -> ManualClock:
    """A clock that is `at` seconds ahead."""
    return ManualClock(time.time() + at)


def certificate_admission(
    proof: HostCredentials, clock: ManualClock | None = None, times=()
) -> CertificateAdmission:
    _, admission = admission_for(proof, "alpha", clock or now(), times)
    assert isinstance(admission, CertificateAdmission)
    return admission


def test_valid_keys_are_accepted(ring):
    keys = ring.issue("host", "alpha")
    tls, admission = admission_for(HostCredentials(keys), "alpha", now(), ())
    assert str(tls.own_identity()) == "host alpha"
    assert (admission.number, admission.list, admission.clock_warning()) == (0, b"", None)


def test_keys_of_another_holder_are_refused(ring):
    for keys, sentence in (
        (ring.issue("host", "bravo"), "these are the keys of host bravo, not of host alpha"),
        (ring.issue("person", "alpha"), "keys rejected for a host"),
        (replace(ring.issue("host", "alpha"), key=ring.issue("host", "bravo").key), "damaged or mismatched"),
    ):
        with pytest.raises(KeysError, match=sentence):
            admission_for(HostCredentials(keys), "alpha", now(), ())


def test_keys_that_expire_before_the_mission_ends_are_refused(ring):
    keys = ring.issue("host", "alpha", lasts=3600.0)
    certificate_admission(HostCredentials(keys, min_lifetime=3000.0))
    with pytest.raises(KeysError, match=r"the mission may last 4000 s from .*--lasts"):
        certificate_admission(HostCredentials(keys, min_lifetime=4000.0))
    with pytest.raises(KeysError, match=r"expired .*renew the keys with 'lfield keys renew host alpha'"):
        certificate_admission(HostCredentials(keys), now(3601.0))


def test_a_clock_after_the_keys_is_compared_with_the_time_of_the_signature(ring):
    keys = HostCredentials(ring.issue("host", "alpha", lasts=3600.0))
    signed = time.time()
    admission_for(keys, "alpha", now(), (), signed=lambda: signed)
    with pytest.raises(
        KeysError, match=r"the clock here shows .*the bundle was signed .*set the clock if it is wrong"
    ):
        admission_for(keys, "alpha", now(3601.0), (), signed=lambda: signed)


def test_a_clock_before_the_certificate_is_not_believed(ring):
    admission = certificate_admission(
        HostCredentials(ring.issue("host", "alpha"), min_lifetime=VALIDITY - 3600.0), ManualClock(0.0)
    )
    assert abs(admission.time.now() - time.time()) < 5.0
    assert "since the certificate of host alpha began then; set the clock" in admission.clock_warning()


def test_the_time_in_the_journal_counts_unless_it_is_after_the_end_of_the_keys(ring):
    proof = HostCredentials(ring.issue("host", "alpha"))
    later = time.time() + DAY
    admission = certificate_admission(proof, times=(5.0, later, later + 10 * VALIDITY))
    assert abs(admission.time.now() - later) < 5.0
    assert "the journal of this host has that time" in admission.clock_warning()


def store_in(monkeypatch, *folders):
    """Lists are written at once, into the first of these folders that permits it."""
    monkeypatch.setattr(CrlStore, "store", lambda _, data, on_stored: on_stored(write_crl(folders, data)))


def test_the_newest_list_counts_and_a_new_one_is_stored(ring, tmp_path, monkeypatch):
    keys, backup = ring.issue("host", "alpha"), tmp_path / "kept"
    keys = replace(keys, revoked=ring.revocation_list(2, "ff"))
    own = tmp_path / "own"
    keystore.write_keys(own, keys)
    keystore.write_crl(backup, ring.revocation_list(5, "fe"))
    store_in(monkeypatch, own, backup)
    admission = certificate_admission(HostCredentials(keys, (own, backup)))
    assert (admission.number, admission.revoked.serials) == (5, frozenset({"fe", "ff"}))
    assert admission.on_revocation_list(ring.revocation_list(6, "fd", "fe", "ff")) == (
        "certificate revocation list 6 received",
    )
    assert certificate_admission(HostCredentials(keystore.read_keys(own, "host"))).number == 6
    assert not admission.on_revocation_list(ring.revocation_list(5)), "an older list without new revocations"
    assert keystore.read_crl(own) == admission.list


def test_an_old_list_is_read_once(ring, tmp_path, monkeypatch):
    admission = certificate_admission(
        HostCredentials(replace(ring.issue("host", "alpha"), revoked=ring.revocation_list(5, "fe", "ff")))
    )
    read = []

    def reading_of(data, authority):
        read.append(data)
        return revoked_in(data, authority)

    monkeypatch.setattr(certificate_reader, "revoked_in", reading_of)
    old, other = ring.revocation_list(3, "fe"), ring.revocation_list(4, "ff", "fd")
    for _ in range(3):
        assert not admission.on_revocation_list(old)
    assert read == [old]
    assert admission.on_revocation_list(other), "it revokes one more certificate"
    assert not admission.on_revocation_list(other)
    assert not admission.on_revocation_list(other)
    assert read == [old, other, other]


def test_a_list_is_stored_in_the_next_folder_if_the_first_is_not_writable(ring, tmp_path, monkeypatch):
    keys, backup = ring.issue("host", "alpha"), tmp_path / "kept"
    unwritable = tmp_path / "file"
    unwritable.write_text("no folder can be made here")
    store_in(monkeypatch, unwritable / "keys", backup)
    admission = certificate_admission(HostCredentials(keys, (backup,)))
    assert admission.on_revocation_list(ring.revocation_list(1, "ff"))
    assert keystore.read_crl(backup) == admission.list


@pytest.mark.parametrize("length", [0, 100])
def test_a_damaged_stored_list_is_named(ring, tmp_path, length):
    backup = tmp_path / "kept"
    keystore.write_crl(backup, ring.revocation_list(5, "fe"))
    path = backup / "revoked.crl"
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(KeysError, match=f"{path}.* copy it again"):
        certificate_admission(HostCredentials(ring.issue("host", "alpha"), (backup,)))


def test_a_list_that_cannot_be_stored_is_reported_and_retried(ring, tmp_path, monkeypatch):
    """After a restart this host would accept the revoked certificates."""
    monkeypatch.setattr(crl_store, "RETRY_AFTER", 0.001)
    keys, backup, lines = ring.issue("host", "alpha"), tmp_path / "kept", []
    tries = []

    def keep(folders, data):
        tries.append(data)
        return write_crl(folders, data)

    monkeypatch.setattr(crl_store, "write_crl", keep)
    admission = certificate_admission(HostCredentials(keys, (backup,)))
    admission.note = lines.append
    anna = identity_in(ring.issue("person", "anna").certificate, keys.authority)
    backup.write_text("no folder can be made here")

    async def scenario():
        admission.on_handshake(anna, Hello("observer", "observer", 0))
        admission.on_revocation_list(ring.revocation_list(1, anna.serial, "ff"))
        while len(tries) < 5:
            await asyncio.sleep(0.001)
        assert lines == [admission.persist_error]
        assert f"revocation list 1 not stored: cannot write {backup}" in admission.persist_error
        assert (
            "after a restart this host would accept the certificates that it revokes (anna);"
            in admission.persist_error
        )
        admission.on_revocation_list(newest := ring.revocation_list(2, anna.serial, "ff", "fe"))
        backup.unlink()
        while admission.persist_error:
            await asyncio.sleep(0.001)
        assert lines[-1] == "certificate revocation list 2 stored"
        assert keystore.read_crl(backup) == newest

    asyncio.run(scenario())


def test_a_revoked_host_does_not_start(ring):
    keys = ring.issue("host", "alpha")
    with pytest.raises(
        KeysError, match=r"are revoked \(list 3\): make new ones with 'lfield keys host alpha'"
    ):
        certificate_admission(
            HostCredentials(
                replace(keys, revoked=ring.revocation_list(3, TlsIdentity(keys).own_identity().serial))
            )
        )


def test_a_list_of_another_authority_is_refused(ring):
    other = Keyring(ring.folder).revocation_list(9, "ff")
    with pytest.raises(KeysError, match="the revocation list is not signed by this authority"):
        certificate_admission(HostCredentials(replace(ring.issue("host", "alpha"), revoked=other)))


def test_only_a_single_host_needs_no_keys():
    require_credentials("alpha", ["alpha"])
    with pytest.raises(UsageError, match="alpha has no keys, which it needs to listen on a network"):
        require_credentials("alpha", ["alpha", "bravo"])
