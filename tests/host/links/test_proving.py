"""With what a host proves who it is: which keys it takes, what time it believes, where it keeps a list."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace
from functools import partial

import pytest

from lfield.authority import folder, reading
from lfield.authority.admission import Judged
from lfield.authority.reading import identity_in, revoked_in
from lfield.clock import ManualClock
from lfield.errors import KeysError, UsageError
from lfield.host.process import own_list
from lfield.host.process.own_list import keep_list
from lfield.host.process.proving import Proof, admitted, insist_on_keys
from lfield.net.tls import Tls
from lfield.testing.keys import LASTS, Keyring
from lfield.wire.messages import Hello

DAY = 86400.0


@pytest.fixture
def ring(tmp_path):
    return Keyring(tmp_path / "keys")


def now(at: float = 0.0) -> ManualClock:
    """A clock that says it is so many seconds from now."""
    return ManualClock(time.time() + at)


def judged(proof: Proof, clock: ManualClock | None = None, times=()) -> Judged:
    _, admission = admitted(proof, "alpha", clock or now(), times)
    assert isinstance(admission, Judged)
    return admission


def test_good_keys_are_taken(ring):
    keys = ring.made("host", "alpha")
    tls, admission = admitted(Proof(keys), "alpha", now(), ())
    assert str(tls.own()) == "host alpha"
    assert (admission.number, admission.list, admission.line()) == (0, b"", "")


def test_keys_of_somebody_else_are_not(ring):
    for keys, sentence in (
        (ring.made("host", "bravo"), "these are the keys of host bravo, not of host alpha"),
        (ring.made("person", "alpha"), "these keys are no good for a host"),
        (replace(ring.made("host", "alpha"), key=ring.made("host", "bravo").key), "do not belong together"),
    ):
        with pytest.raises(KeysError, match=sentence):
            admitted(Proof(keys), "alpha", now(), ())


def test_keys_that_end_before_the_mission_does_are_not(ring):
    keys = ring.made("host", "alpha", lasts=3600.0)
    judged(Proof(keys, lasts=3000.0))
    with pytest.raises(KeysError, match=r"and the mission may last 4000 s from .*say with --lasts"):
        judged(Proof(keys, lasts=4000.0))
    with pytest.raises(KeysError, match="renew it with 'lfield keys renew host alpha'"):
        judged(Proof(keys), now(3601.0))


def test_a_clock_before_the_certificate_is_not_believed(ring):
    admission = judged(Proof(ring.made("host", "alpha"), lasts=LASTS - 3600.0), ManualClock(0.0))
    assert abs(admission.time.now() - time.time()) < 5.0
    assert "since the certificate of host alpha began then; set the clock" in admission.line()


def test_what_the_journal_kept_counts_unless_it_is_after_the_keys_have_ended(ring):
    proof = Proof(ring.made("host", "alpha"))
    later = time.time() + DAY
    admission = judged(proof, times=(5.0, later, later + 10 * LASTS))
    assert abs(admission.time.now() - later) < 5.0
    assert "it was so late already when this host ran before" in admission.line()


def test_the_newest_list_counts_wherever_it_is_and_a_new_one_is_kept(ring, tmp_path):
    keys, kept = ring.made("host", "alpha"), tmp_path / "kept"
    keys = replace(keys, revoked=ring.listed(2, "ff"))
    own = tmp_path / "own"
    folder.write(own, keys)
    folder.write_list(kept, ring.listed(5, "fe"))
    admission = judged(Proof(keys, (own, kept)))
    admission.keep = partial(keep_list, (own, kept))
    assert (admission.number, admission.revoked.serials) == (5, frozenset({"fe", "ff"}))
    assert admission.news(ring.listed(6, "fd", "fe", "ff")) == "revocation list 6 has come"
    assert judged(Proof(folder.read(own, "host"))).number == 6
    assert not admission.news(ring.listed(5)), "an older one that revokes nobody else"
    assert folder.read_list(own) == admission.list


def test_an_old_list_is_read_once_however_often_it_comes(ring, tmp_path, monkeypatch):
    admission = judged(Proof(replace(ring.made("host", "alpha"), revoked=ring.listed(5, "fe", "ff"))))
    read = []

    def reading_of(data, authority):
        read.append(data)
        return revoked_in(data, authority)

    monkeypatch.setattr(reading, "revoked_in", reading_of)
    old, other = ring.listed(3, "fe"), ring.listed(4, "ff", "fd")
    for _ in range(3):
        assert not admission.news(old)
    assert read == [old]
    assert admission.news(other), "it revokes one more"
    assert not admission.news(other)
    assert not admission.news(other)
    assert read == [old, other, other]


def test_where_the_keys_are_of_a_service_a_list_is_kept_elsewhere(ring, tmp_path):
    keys, kept = ring.made("host", "alpha"), tmp_path / "kept"
    unwritable = tmp_path / "file"
    unwritable.write_text("no folder can be made here")
    admission = judged(Proof(keys, (kept,)))
    admission.keep = partial(keep_list, (unwritable / "keys", kept))
    assert admission.news(ring.listed(1, "ff"))
    assert folder.read_list(kept) == admission.list


@pytest.mark.parametrize("length", [0, 100])
def test_a_list_that_was_kept_and_is_damaged_is_named(ring, tmp_path, length):
    kept = tmp_path / "kept"
    folder.write_list(kept, ring.listed(5, "fe"))
    path = kept / "revoked.crl"
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(KeysError, match=f"{path}.* copy it again"):
        judged(Proof(ring.made("host", "alpha"), (kept,)))


def test_a_list_that_cannot_be_kept_is_told_and_tried_again(ring, tmp_path, monkeypatch):
    """Whom it revokes this host would let in after a restart."""
    monkeypatch.setattr(own_list, "AGAIN", 0.001)
    keys, kept, lines = ring.made("host", "alpha"), tmp_path / "kept", []
    tries = []

    def keep(folders, data):
        tries.append(data)
        return keep_list(folders, data)

    monkeypatch.setattr(own_list, "keep_list", keep)
    admission = judged(Proof(keys, (kept,)))
    admission.note = lines.append
    anna = identity_in(ring.made("person", "anna").certificate, keys.authority)
    kept.write_text("no folder can be made here")

    async def story():
        admission.greeted(anna, Hello("observer", "observer", 0))
        admission.news(ring.listed(1, anna.serial, "ff"))
        while len(tries) < 5:
            await asyncio.sleep(0.001)
        assert lines == [admission.unkept]
        assert f"revocation list 1 is not kept: cannot write {kept}" in admission.unkept
        assert "After a restart this host would let in whom it revokes (anna):" in admission.unkept
        admission.news(newest := ring.listed(2, anna.serial, "ff", "fe"))
        kept.unlink()
        while admission.unkept:
            await asyncio.sleep(0.001)
        assert lines[-1] == "revocation list 2 is kept now"
        assert folder.read_list(kept) == newest

    asyncio.run(story())


def test_a_revoked_host_does_not_begin(ring):
    keys = ring.made("host", "alpha")
    with pytest.raises(
        KeysError, match=r"are revoked \(list 3\): make new ones with 'lfield keys host alpha'"
    ):
        judged(Proof(replace(keys, revoked=ring.listed(3, Tls(keys).own().serial))))


def test_a_list_of_another_authority_is_no_list(ring):
    other = Keyring(ring.folder).listed(9, "ff")
    with pytest.raises(KeysError, match="the revocation list is not signed by this authority"):
        judged(Proof(replace(ring.made("host", "alpha"), revoked=other)))


def test_only_a_host_that_is_alone_needs_no_keys():
    insist_on_keys("alpha", ["alpha"])
    with pytest.raises(UsageError, match="alpha has no keys, and no host listens on a network without"):
        insist_on_keys("alpha", ["alpha", "bravo"])
