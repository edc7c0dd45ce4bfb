"""Frames cut from any stream."""

import tracemalloc
from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.errors import WireError
from lfield.wire.framing import HEADER_SIZE, FrameDecoder, frame, frame_header

REPEATABLE = settings(derandomize=True, deadline=None)
LIMITS = {1: 100, 2: 1 << 20}


def cut(decoder: FrameDecoder, *pieces: bytes) -> list[tuple[int, bytes]]:
    return [(kind, bytes(payload)) for piece in pieces for kind, payload in decoder.feed(piece)]


def test_the_layout_of_a_frame():
    assert frame(7, b"ab") == b"\x00\x00\x00\x03\x07ab"
    assert frame_header(7, 2) == b"\x00\x00\x00\x03\x07"
    assert len(frame_header(7, 2)) == HEADER_SIZE


@REPEATABLE
@given(st.lists(st.tuples(st.sampled_from([1, 2]), st.binary(max_size=100))), st.data())
def test_frames_are_restored_from_a_stream_in_any_pieces(frames, data):
    stream = b"".join(frame(kind, payload) for kind, payload in frames)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    pieces = [stream[i:j] for i, j in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    decoder = FrameDecoder(LIMITS)
    assert cut(decoder, *pieces) == frames
    assert not decoder.is_mid_frame


@REPEATABLE
@given(st.binary(max_size=300), st.integers(1, 300))
def test_any_bytes_give_frames_or_a_wire_error(stream, size):
    decoder = FrameDecoder(LIMITS, skippable={1: 4})
    with suppress(WireError):
        cut(decoder, *(stream[start : start + size] for start in range(0, len(stream), size)))


@REPEATABLE
@given(
    st.one_of(st.binary(max_size=40), st.builds(frame, st.integers(0, 3), st.binary(max_size=200))),
    st.sampled_from([b"", b"\0", frame(1, b"abc")[:-1]]),
)
def test_decode_single_frame_accepts_exactly_one_whole_frame(stream, before):
    decoder, other = FrameDecoder(LIMITS), FrameDecoder(LIMITS)
    assert cut(decoder, before) == cut(other, before) == []
    found = decoder.decode_single_frame(stream)
    assert decoder.is_mid_frame == other.is_mid_frame
    if found is not None:
        assert cut(other, stream) == [(found[0], bytes(found[1]))]
    else:
        with suppress(WireError):
            assert len(cut(other, stream)) != 1 or before or other.is_mid_frame or len(stream) < HEADER_SIZE


@REPEATABLE
@given(
    st.lists(st.tuples(st.sampled_from([1, 2]), st.binary(max_size=100))),
    st.binary(max_size=20),
    st.integers(1, 300),
)
def test_frames_fed_one_at_a_time_give_the_same_result(frames, end, size):
    stream = b"".join(frame(kind, payload) for kind, payload in frames) + end
    decoder, other, found, expected = FrameDecoder(LIMITS), FrameDecoder(LIMITS), [], []
    with suppress(WireError):
        for piece in (stream[start : start + size] for start in range(0, len(stream), size)):
            for one in other.feed(piece):
                expected.append((one[0], bytes(one[1])))
    with suppress(WireError):
        for piece in (stream[start : start + size] for start in range(0, len(stream), size)):
            while piece:
                length = decoder.next_frame_length(piece)
                assert length > 0
                step = cut(decoder, piece[:length])
                assert len(step) <= 1
                found += step
                piece = piece[length:]
    assert found == expected
    assert decoder.is_mid_frame == other.is_mid_frame


def test_a_whole_frame_is_not_copied():
    stream = frame(1, b"abc")
    (found,) = FrameDecoder(LIMITS).feed(stream)
    assert found[1].obj is stream


def test_a_cut_frame_is_reported_as_unfinished():
    decoder = FrameDecoder(LIMITS)
    for stream in (b"\x00", b"\x00\x00\x00\x05\x01ab"):
        decoder = FrameDecoder(LIMITS)
        assert cut(decoder, stream) == []
        assert decoder.is_mid_frame


@pytest.mark.parametrize(
    ("stream", "words"),
    [
        (frame(1, bytes(101)), "a frame of kind 1 has 101 bytes; at most 100 are allowed"),
        (frame(1, bytes(101))[:5], "a frame of kind 1 has 101 bytes"),
        (frame(3, b""), "does not speak lfield"),
        (b"\x00\x00\x00\x00\x01", "does not speak lfield"),
        (b"GET / HTTP/1.1", "does not speak lfield"),
    ],
)
def test_a_frame_over_the_limits_is_an_error_after_earlier_frames(stream, words):
    for pieces in ([frame(1, b"x") + stream], [frame(1, b"x"), *(bytes([byte]) for byte in stream)]):
        found = stream_of(FrameDecoder(LIMITS), pieces)
        assert next(found) == (1, b"x")
        with pytest.raises(WireError, match=words):
            next(found)


def stream_of(decoder, pieces):
    for piece in pieces:
        for kind, payload in decoder.feed(piece):
            yield kind, bytes(payload)


@pytest.mark.parametrize("size", [1, 7, 1 << 16])
def test_an_oversize_frame_is_skipped_where_the_caller_permits(size):
    skipped = []
    decoder = FrameDecoder(LIMITS, skippable={1: 8}, on_skipped=lambda *what: skipped.append(what))
    stream = frame(1, b"a") + frame(1, b"0123456789" * 20) + frame(1, b"b")
    found = cut(decoder, *(stream[start : start + size] for start in range(0, len(stream), size)))
    assert found == [(1, b"a"), (1, b"b")]
    assert skipped == [(1, 200, b"01234567")]


def test_a_skipped_frame_needs_no_memory():
    decoder = FrameDecoder(LIMITS, skippable={2: 16})
    piece = bytes(1 << 16)
    tracemalloc.start()
    cut(decoder, frame_header(2, 1 << 30))
    for _ in range(1 << 14):
        cut(decoder, piece)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 16
    assert cut(decoder, frame(1, b"x")) == [(1, b"x")]
