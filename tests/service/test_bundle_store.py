"""The disk of a service: state, bundles, pieces of interrupted uploads."""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import pytest
from service_fakes import run_of

from lfield.errors import DamagedFileError, OutputFileError
from lfield.service import bundle_store
from lfield.service.ballots import ActivationState, propose
from lfield.service.bundle_receiver import UPLOAD_TIMEOUT, BundleReceiver
from lfield.service.bundle_store import KEPT_BUNDLES, KEPT_UPLOADS, BundleStore, ServiceRecord
from lfield.wire.bundle_pieces import compress, piece_of, split
from lfield.wire.service_messages import (
    Ballot,
    BundleInfo,
    BundleOffer,
    BundlePiece,
    StageRequest,
)

DATA = random.Random(2).randbytes(25_000)
CHANGED = DATA[:12_000] + b"another part" + DATA[12_100:]


def digest_of(data: bytes) -> bytes:
    return sha256(data).digest()


def offer(data: bytes) -> BundleOffer:
    pieces = [piece_of(each) for each in split(data)]
    entries = [(piece.digest, piece.size) for piece in pieces]
    return BundleOffer(digest_of(data), digest_of(data), len(data), len(pieces), 0, entries)


def receiver(store: BundleStore, now: Callable[[], float] = lambda: 0.0) -> BundleReceiver:
    def verify(data: bytes) -> BundleInfo:
        return BundleInfo(digest_of(data), "m")

    return BundleReceiver(store, verify, lambda: [], lambda line: None, now)


def send(to: BundleReceiver, data: bytes, numbers: list[int]) -> None:
    pieces = list(split(data))
    for number in numbers:
        packed, sent = compress(pieces[number])
        assert not to.on_piece(BundlePiece(digest_of(data), number, packed, sent)).trouble


def test_saved_state_is_loaded_again(tmp_path: Path) -> None:
    store = BundleStore(tmp_path / "service")
    assert store.load() == ServiceRecord()
    voted = propose(ActivationState(), "alpha", Ballot(bytes(16), bytes(32), ["alpha", "bravo"], "anna"), "")
    record = ServiceRecord(voted, run_of(bytes(32), 7), held=True)
    store.save(record)
    assert BundleStore(tmp_path / "service").load() == record


def test_damaged_state_is_reported_with_a_remedy(tmp_path: Path) -> None:
    store = BundleStore(tmp_path)
    store.save(ServiceRecord())
    (tmp_path / "state.json").write_bytes(b'{"held": 3')
    with pytest.raises(DamagedFileError) as damaged:
        store.load()
    # The remedy.
    assert "lfield push" in str(damaged.value)


def test_interrupted_upload_continues(tmp_path: Path) -> None:
    first = receiver(BundleStore(tmp_path))
    missing = first.on_offer(offer(DATA), "anna").missing
    assert missing == [*range(len(offer(DATA).pieces))]
    send(first, DATA, missing[:9])
    second = receiver(BundleStore(tmp_path))
    rest = second.on_offer(offer(DATA), "anna").missing
    assert rest == missing[9:]
    send(second, DATA, rest)
    assert not second.on_stage(StageRequest(digest_of(DATA), digest_of(DATA))).trouble
    assert BundleStore(tmp_path).read(digest_of(DATA)) == DATA
    assert [info.digest for info in second.infos(9)] == [digest_of(DATA)]
    assert second.is_valid(digest_of(DATA))
    assert not second.is_valid(bytes(32))


def test_only_changed_pieces_of_another_bundle_are_requested(tmp_path: Path) -> None:
    store = BundleStore(tmp_path)
    store.add(digest_of(DATA), DATA, [])
    to = receiver(BundleStore(tmp_path))
    missing = to.on_offer(offer(CHANGED), "anna").missing
    assert 1 <= len(missing) <= 4
    send(to, CHANGED, missing)
    assert not to.on_stage(StageRequest(digest_of(CHANGED), digest_of(CHANGED))).trouble


def test_pieces_of_a_damaged_bundle_are_not_copied(tmp_path: Path) -> None:
    store = BundleStore(tmp_path)
    store.add(digest_of(DATA), DATA, [])
    to = receiver(store)
    assert not to.on_offer(offer(DATA), "anna").missing
    store.drop(digest_of(DATA))
    store.path(digest_of(DATA)).write_bytes(bytes(len(DATA)))
    assert len(to.on_offer(offer(DATA), "anna").missing) == len(offer(DATA).pieces)


@pytest.mark.parametrize("damage", ["missing", "wrong", "surplus", "no offer", "deleted"])
def test_pieces_that_do_not_join_to_the_file_are_refused(tmp_path: Path, damage: str) -> None:
    to = receiver(BundleStore(tmp_path))
    if damage != "no offer":
        missing = to.on_offer(offer(DATA), "anna").missing
        send(to, DATA, missing[:-1] if damage == "missing" else missing)
    if damage == "wrong":
        to.on_piece(BundlePiece(digest_of(DATA), 3, False, b"other"))
    if damage == "surplus":
        to.on_piece(BundlePiece(digest_of(DATA), 3000, False, b"other"))
    if damage == "deleted":
        (tmp_path / "staging" / digest_of(DATA).hex() / "3").unlink()
    result = to.on_stage(StageRequest(digest_of(DATA), digest_of(DATA)))
    assert result.trouble
    assert result.code
    assert BundleStore(tmp_path).stored() == []
    # The upload starts again.
    assert len(to.on_offer(offer(DATA), "anna").missing) == len(offer(DATA).pieces)


def test_stage_request_for_another_bundle_is_refused(tmp_path: Path) -> None:
    to = receiver(BundleStore(tmp_path))
    send(to, DATA, to.on_offer(offer(DATA), "anna").missing)
    assert to.on_stage(StageRequest(digest_of(CHANGED), digest_of(DATA))).trouble


def test_full_disk_accepts_no_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    to = receiver(BundleStore(tmp_path))
    monkeypatch.setattr(bundle_store, "RESERVE", 1 << 60)
    to.on_offer(offer(DATA), "anna")
    assert to.on_piece(BundlePiece(digest_of(DATA), 0, False, b"data")).trouble
    with pytest.raises(OutputFileError):
        BundleStore(tmp_path).put(digest_of(DATA), 0, b"data")


def test_old_bundles_and_uploads_are_removed_unless_in_use(tmp_path: Path) -> None:
    store = BundleStore(tmp_path)
    (tmp_path / "bundles" / "note.lfm").write_bytes(b"a file of another program")
    (tmp_path / "staging" / "lost+found").mkdir()
    digests = [digest_of(bytes([n])) for n in range(KEPT_BUNDLES + 4)]
    for n, digest in enumerate(digests):
        store.add(digest, bytes([n]), digests[:1])
        os.utime(store.path(digest), (n, n))
    assert set(store.stored()) == {digests[0], *digests[-KEPT_BUNDLES - 1 :]}
    files = [digest_of(b"upload %d" % n) for n in range(KEPT_UPLOADS + 2)]
    for n, file in enumerate(files):
        store.start_upload(file, [])
        os.utime(tmp_path / "staging" / file.hex(), (n, n))
    assert {path.name for path in (tmp_path / "staging").iterdir()} == {
        "lost+found",
        *(file.hex() for file in files[-KEPT_UPLOADS:]),
    }
    # An upload in progress stays, at any age.
    os.utime(tmp_path / "staging" / files[-1].hex(), (0, 0))
    store.start_upload(files[0], [files[-1]])
    remaining = {"lost+found", files[0].hex(), files[-1].hex()}
    assert {path.name for path in (tmp_path / "staging").iterdir()} == remaining


def test_upload_in_progress_is_not_removed_for_another(tmp_path: Path) -> None:
    time = 0.0
    to = receiver(BundleStore(tmp_path), lambda: time)
    first, second, third = (DATA + bytes([number]) for number in range(3))
    missing = to.on_offer(offer(first), "anna").missing
    assert to.on_offer(offer(second), "bob").missing
    busy = to.on_offer(offer(third), "carl")
    assert (busy.missing, busy.retry) == ([], True)
    assert "anna" in busy.trouble
    assert "bob" in busy.trouble
    assert to.on_piece(BundlePiece(digest_of(third), 0, False, b"data")).retry
    # An offer of the same file needs no second place.
    assert to.on_offer(offer(first), "bob").missing == missing
    time = UPLOAD_TIMEOUT - 1.0
    send(to, first, missing[:1])
    time = UPLOAD_TIMEOUT
    # The second has timed out, the first is in progress.
    assert to.on_offer(offer(third), "carl").missing
    send(to, first, missing[1:])
    assert not to.on_stage(StageRequest(digest_of(first), digest_of(first))).trouble
    assert to.on_offer(offer(second), "bob").missing
    # Pieces of the displaced upload are requested again.
    assert to.on_stage(StageRequest(digest_of(second), digest_of(second))).retry
