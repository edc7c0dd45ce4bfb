"""Deltas of transfers and compressed messages: what arrives equals what was sent, expansion is bounded."""

from __future__ import annotations

import random
import zlib

import pytest
from msgspec.structs import replace

from lfield.errors import WireError
from lfield.net.coding.delta import CHUNK, encode_delta, expand_delta
from lfield.net.coding.link_compression import LinkCompression
from lfield.net.coding.traffic_kinds import TrafficBytes, TrafficKind
from lfield.net.coding.transfer_history import (
    FORGET_AFTER,
    MAX_KEPT,
    Delta,
    MissingReference,
    TransferHistory,
)
from lfield.net.framed_link import FramedLink
from lfield.testing.transport_kit import Recorder, transfer
from lfield.wire.codec import CONTROL, TRANSFER, TRANSFER_DELTA, encode_transfer
from lfield.wire.framing import HEADER_SIZE, frame
from lfield.wire.messages import Backpressure, WholeTransferRequest

SIZES = (0, 1, 600, 8720, CHUNK - 1, CHUNK, CHUNK + 1, 3 * CHUNK, 100_000)


def changed(data: bytes, rng: random.Random, count: int = 8) -> bytes:
    made = bytearray(data)
    for _ in range(count if data else 0):
        made[rng.randrange(len(made))] = rng.randrange(256)
    return bytes(made)


@pytest.mark.parametrize("size", SIZES)
def test_a_delta_restores_every_version(size):
    rng = random.Random(size)
    old = rng.randbytes(size)
    new = changed(old, rng)
    moved = rng.randbytes(100) + old
    for version in (old, new, moved, old[: size // 2], rng.randbytes(size), b""):
        delta = encode_delta(version, old)
        assert expand_delta(delta, old, len(version)) == version
        assert expand_delta(encode_delta(old, version), version, size) == old


def test_a_small_change_gives_a_short_delta():
    rng = random.Random(1)
    for size, most in ((600, 40), (8720, 100), (100_000, 1000)):
        old = rng.randbytes(size)
        assert len(encode_delta(changed(old, rng, 4), old)) <= most


def test_a_moved_heap_gives_a_short_delta():
    old = random.Random(1).randbytes(40_000)
    assert len(encode_delta(bytes(200) + old, old)) < 700


@pytest.mark.parametrize("size", SIZES[2:])
def test_a_truncated_delta_or_a_wrong_size_is_refused(size):
    old = random.Random(1).randbytes(size)
    delta = encode_delta(changed(old, random.Random(2)), old)
    for end in range(0, len(delta) - 1, max(1, len(delta) // 100)):
        with pytest.raises(WireError):
            expand_delta(delta[:end], old, size)
    with pytest.raises(WireError):
        expand_delta(delta, old, size + 1)


def test_expansion_is_limited_by_the_stated_size():
    coder = zlib.compressobj(9, zlib.DEFLATED, -15)
    bomb = coder.compress(bytes(1 << 28)) + coder.flush()
    with pytest.raises(WireError):
        expand_delta(bomb, b"", 1 << 20)
    with pytest.raises(WireError):
        LinkCompression().decode(bomb, 1 << 20)


def test_similar_messages_of_a_stream_are_compressed_and_decoded_in_order():
    near, far, rng = LinkCompression(), LinkCompression(), random.Random(1)
    report = rng.randbytes(300)
    lengths = []
    for _ in range(50):
        report = changed(report, rng, 3)
        data = near.encode(report)
        lengths.append(len(data))
        assert far.decode(data, 300) == report
    assert lengths[0] >= 300
    assert max(lengths[1:]) < 40


def payload(block: bytes, sequence: int) -> bytes:
    return encode_transfer(transfer(len(block), sequence), block)[HEADER_SIZE:] + block


AGENT = transfer(0).agent
BLOCK = random.Random(1).randbytes(600)


def test_both_ends_keep_the_same_reference():
    near, far = TransferHistory(), TransferHistory()
    ends = [near, far]
    for number in range(20):
        sender, receiver = ends[number % 2], ends[1 - number % 2]
        sent = payload(changed(BLOCK, random.Random(number), 4), number)
        data = sender.encode(AGENT, frame(TRANSFER, sent), is_fast=False)
        assert kind(data) == (TRANSFER_DELTA if number else TRANSFER)
        if number:
            delta = receiver.decode(memoryview(data)[HEADER_SIZE:])
            assert isinstance(delta, Delta)
            assert delta.expand() == sent
            assert len(data) < 120
        receiver.keep(AGENT, sent, is_sent=False)


def whole(number: int) -> bytes:
    return frame(TRANSFER, payload(BLOCK, number))


def kind(data: bytes) -> int:
    return data[HEADER_SIZE - 1]


def test_a_transfer_is_sent_whole_on_a_fast_path():
    near = TransferHistory()
    assert [near.encode(AGENT, whole(n), is_fast=True) for n in range(3)] == [whole(n) for n in range(3)]
    assert kind(near.encode(AGENT, whole(3), is_fast=False)) == TRANSFER_DELTA


def test_a_reference_with_another_digest_is_reported_missing():
    near, far = TransferHistory(), TransferHistory()
    near.keep(AGENT, payload(BLOCK, 1), is_sent=False)
    far.keep(AGENT, payload(BLOCK, 2), is_sent=False)
    delta = memoryview(near.encode(AGENT, whole(3), is_fast=False))[HEADER_SIZE:]
    assert far.decode(delta) == MissingReference(AGENT)
    assert TransferHistory().decode(delta) == MissingReference(AGENT)


def test_kept_references_are_bounded_and_not_evicted_by_larger_ones():
    near = TransferHistory()
    stored = [near.keep(f"c{number}", bytes(100_000), is_sent=True) for number in range(20)]
    assert stored == [True] * (MAX_KEPT // 100_000) + [False] * (20 - MAX_KEPT // 100_000)
    assert near._size == sum(len(data) for data, *_ in near._transfers.values()) <= MAX_KEPT
    assert not near.keep("large", bytes(MAX_KEPT + 1), is_sent=True)
    assert near.whole("c0") is not None
    for _ in range(FORGET_AFTER):
        assert near.keep("c19", b"small", is_sent=True)
    assert near.whole("c0") is None
    assert near._size == len(near.whole("c19"))


def test_coordinators_beyond_the_reference_limit_are_sent_whole_others_as_deltas():
    """Five large states are sent in turn, and some transfers cross."""
    near, far = ends(1 << 20)
    rng = random.Random(1)
    blocks = {f"w{number}": rng.randbytes(190_000) for number in range(5)}
    for turn in range(40):
        sender = (near, far)[turn // 5 % 2]
        for agent, block in blocks.items():
            sender.send_transfer(replace(transfer(len(block), turn), agent=agent), changed(block, rng, 9))
    assert (near.closed, far.closed) == (False, False)
    deltas = [data for data in near.written + far.written if kind(data) == TRANSFER_DELTA]
    assert len(deltas) >= 2 * 39
    assert max(map(len, deltas)) < 2000


class End(FramedLink):
    """One end of a link in memory: what is written arrives at the other end at once."""

    other: End

    def __init__(self, max_block: int) -> None:
        super().__init__("peer", max_block)
        self.handler = Recorder()
        self.accept_role("host")
        self.written: list[bytes] = []
        self.loses = False

    def write(self, data) -> None:
        self.written.append(bytes(data))
        if not self.loses:
            self.other.received(bytes(data))

    def close(self) -> None:
        self.closed = True


def ends(max_block: int = 1 << 20) -> tuple[End, End]:
    near, far = End(max_block), End(max_block)
    near.other, far.other = far, near
    return near, far


def test_a_hop_without_a_reference_is_repeated_whole():
    near, far = ends()
    near.send_transfer(transfer(600, 1), BLOCK)
    far._history = TransferHistory()
    near.send_transfer(transfer(600, 2), BLOCK)
    near.send(Backpressure("behind"))
    assert far.handler.messages == [(transfer(600, n), BLOCK) for n in (1, 2)] + [Backpressure("behind")]
    assert [data[HEADER_SIZE - 1] for data in near.written[:3]] == [TRANSFER, TRANSFER_DELTA, TRANSFER]
    near.send_transfer(transfer(600, 3), BLOCK)
    assert near.written[-1][HEADER_SIZE - 1] == TRANSFER_DELTA
    assert far.handler.messages[-1] == (transfer(600, 3), BLOCK)


def test_nothing_is_coded_on_a_local_link_at_any_round_trip_time():
    near, far = ends()
    near.mark_local()
    far.mark_local()
    near.set_round_trip(1.0)
    for number in range(3):
        near.send_transfer(transfer(600, number), BLOCK)
        near.send(Backpressure("behind"))
    assert [kind(data) for data in near.written] == [TRANSFER, CONTROL] * 3
    assert near._history.whole(AGENT) is None


def test_bytes_are_counted_per_link_and_in_total():
    total, links = TrafficBytes(), [ends()[0] for _ in range(2)]
    for number, link in enumerate(links):
        link.count_in(total)
        for _ in range(number + 1):
            link.send(Backpressure("behind"))
    sizes = [link.traffic.counts[TrafficKind.CONTROL] for link in links]
    assert sizes == [sum(map(len, link.written)) for link in links]
    assert total.counts[TrafficKind.CONTROL] == sum(sizes)


def test_crossing_hops_that_cannot_be_repeated_close_the_link():
    """Two starts of one coordinator: the next link begins with queries about both."""
    near, far = ends()
    near.send_transfer(transfer(600, 1), BLOCK)
    near.loses = far.loses = True
    near.send_transfer(transfer(600, 2), BLOCK)
    far.send_transfer(transfer(600, 3), BLOCK)
    near.loses = far.loses = False
    crossing = near.written[-1], far.written[-1]
    far.received(crossing[0])
    assert far.handler.messages[-1] == (transfer(600, 2), BLOCK)
    near.received(crossing[1])
    assert far.closed
    assert isinstance(far._error, WireError)


def test_a_request_for_an_unsent_transfer_closes_the_link():
    near, far = ends()
    far.send(WholeTransferRequest("eve"))
    assert near.closed
    assert isinstance(near._error, WireError)


def test_an_oversized_delta_is_reported_with_its_header():
    near, far = ends(max_block=1000)
    far.other = near
    near.send_transfer(transfer(600, 1), BLOCK)
    near.send_transfer(transfer(5000, 2), bytes(5000))
    assert near.written[-1][HEADER_SIZE - 1] == TRANSFER_DELTA
    assert far.handler.oversize == [(transfer(5000, 2), 5000)]
    assert not far.closed


@pytest.mark.parametrize("place", range(0, 60))
def test_a_damaged_delta_closes_the_link_or_is_requested_again(place):
    near, far = ends()
    near.send_transfer(transfer(600, 1), BLOCK)
    near.loses = True
    near.send_transfer(transfer(600, 2), BLOCK)
    body = bytearray(near.written[-1][HEADER_SIZE:])
    body[place % len(body)] ^= 1 << place % 8
    near.loses = False
    far.received(frame(TRANSFER_DELTA, body))
    arrived = far.handler.messages[1:]
    assert arrived in ([], [(transfer(600, 2), BLOCK)])
    assert arrived or far.closed or near.closed
