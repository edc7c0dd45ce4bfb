"""Framers of serial ports: any split of the bytes has the same frames, no bytes raise, memory is bounded."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.driver.serial import Lines, Packets

LONGEST = 12
#: A packet is AA 55, the length of the body, the body, and its checksum.
make_packets = {
    "lines": lambda: Lines(longest=LONGEST),
    "two bytes": lambda: Lines(b"\r\n", longest=LONGEST),
    "packets": lambda: Packets(
        b"\xaa\x55",
        3,
        lambda head: head[2] + 4,
        lambda frame: sum(frame[3:-1]) & 0xFF == frame[-1],
        longest=LONGEST,
    ),
}
#: Bytes with a meaning for a framer, and random bytes.
noise = st.lists(
    st.sampled_from([b"\r", b"\n", b"\r\n", b"\xaa", b"\x55", b"\xaa\x55\x01\x07\x07"])
    | st.binary(max_size=9)
).map(b"".join)


def packet(body: bytes) -> bytes:
    return b"\xaa\x55" + bytes([len(body)]) + body + bytes([sum(body) & 0xFF])


@pytest.mark.parametrize("kind", make_packets)
@given(data=noise, cuts=st.lists(st.integers(0, 60)))
def test_any_split_gives_the_same_frames(kind, data, cuts):
    whole, split = make_packets[kind](), make_packets[kind]()
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    pieces = [data[a:b] for a, b in pairwise(edges)]
    assert [f for piece in pieces for f in split.feed(piece)] == whole.feed(data)
    assert split.dropped == whole.dropped


@pytest.mark.parametrize("kind", make_packets)
@given(pieces=st.lists(st.binary(max_size=40)))
def test_partial_frames_use_bounded_memory(kind, pieces):
    framer = make_packets[kind]()
    for piece in pieces:
        assert all(len(frame) <= LONGEST for frame in framer.feed(piece))
        assert len(framer._partial) <= LONGEST + 2


@given(st.lists(st.binary(max_size=LONGEST - 4)), st.binary(max_size=30))
def test_valid_packets_are_found_after_garbage(bodies, garbage):
    framer = make_packets["packets"]()
    framer.feed(garbage)
    framer.feed(bytes(LONGEST))  # ends a frame that started in the garbage
    assert framer.feed(b"".join(map(packet, bodies))) == list(map(packet, bodies))


def test_too_long_line_is_dropped_and_counted_once():
    framer = Lines(longest=4)
    assert framer.feed(b"abc\nabcdefgh") == [b"abc"]
    assert framer.feed(b"ijkl\n\nxy\n") == [b"", b"xy"]
    assert framer.dropped == 1


def test_reset_discards_a_partial_frame():
    for framer in (Lines(), make_packets["packets"]()):
        framer.feed(b"\xaa\x55\x02ab")
        framer.reset()
        assert framer.feed(b"\xc3\n") in ([b"\xc3"], [])


@pytest.mark.parametrize(
    "wrong", [lambda: Lines(b""), lambda: Packets(b"ab", 1, len), lambda: Packets(b"", 1, len)]
)
def test_invalid_framer_options_are_refused(wrong):
    with pytest.raises(ValueError, match="requires a"):
        wrong()
