"""Pieces of bundles: same pieces after a small change, bounds, and damaged data."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.errors import WireError
from lfield.wire.bundle_pieces import MIN_PIECE, compress, decompress, piece_of, split
from lfield.wire.service_messages import MAX_PIECE, PIECE_DIGEST_SIZE

DATA = random.Random(1).randbytes(200_000)


@given(st.binary(max_size=20_000))
def test_pieces_join_to_the_data_and_are_bounded(data: bytes) -> None:
    pieces = list(split(data))
    assert b"".join(pieces) == data
    assert all(1 <= len(piece) <= MAX_PIECE for piece in pieces)
    assert all(len(piece) >= MIN_PIECE for piece in pieces[:-1])


@pytest.mark.parametrize("data", [b"", b"x", bytes(100_000), DATA], ids=["none", "one", "zeros", "random"])
def test_pieces_of_special_data_are_bounded(data: bytes) -> None:
    pieces = list(split(data))
    assert b"".join(pieces) == data
    assert all(MIN_PIECE <= len(piece) <= MAX_PIECE for piece in pieces[:-1])


@pytest.mark.parametrize("at", [0, 1, 70_000, 199_999])
@pytest.mark.parametrize(
    "change", [b"", b"longer by some", b"x" * 3000], ids=["cut", "longer", "much longer"]
)
def test_small_change_keeps_most_pieces(at: int, change: bytes) -> None:
    changed = DATA[:at] + change + DATA[at + 1 :]
    old = {piece_of(piece) for piece in split(DATA)}
    new = [piece_of(piece) for piece in split(changed)]
    assert len([piece for piece in new if piece not in old]) <= 3 + len(change) // MIN_PIECE
    assert len(new) > 100


def test_piece_is_identified_by_its_bytes() -> None:
    piece = piece_of(DATA[:1000])
    assert (len(piece.digest), piece.size) == (PIECE_DIGEST_SIZE, 1000)
    assert piece_of(DATA[:1000]) == piece
    assert piece_of(DATA[1:1001]) != piece


@given(st.binary(max_size=MAX_PIECE))
def test_compressed_piece_is_restored(data: bytes) -> None:
    is_compressed, sent = compress(data)
    assert len(sent) <= len(data)
    assert decompress(sent, is_compressed=is_compressed) == data


@given(st.binary(max_size=200))
def test_damaged_piece_is_refused_or_bounded(data: bytes) -> None:
    try:
        found = decompress(data, is_compressed=True)
    except WireError:
        return
    assert len(found) <= MAX_PIECE


def test_piece_that_expands_beyond_the_limit_is_refused() -> None:
    is_compressed, bomb = compress(bytes(1_000_000))
    assert is_compressed
    assert len(bomb) < MAX_PIECE
    with pytest.raises(WireError):
        decompress(bomb, is_compressed=True)
    _, compressed = compress(bytes(MAX_PIECE))
    assert decompress(compressed, is_compressed=True) == bytes(MAX_PIECE)
    with pytest.raises(WireError):
        decompress(compressed[:-1], is_compressed=True)
