"""The numbered stream: order, loss, window, opening and closing, in virtual time."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from stream_pair import DELAY, StreamPair

from lfield.net.zenoh.packets import MAX_NUMBER, Kind, Packet, decode_packet
from lfield.net.zenoh.receive_buffer import MAX_AHEAD, MAX_BYTES
from lfield.net.zenoh.send_window import INITIAL_WINDOW, MAX_SEGMENT, MAX_WINDOW, MIN_WINDOW, SendWindow
from lfield.net.zenoh.stream import ACK_DELAY, IDLE, SILENCE, SUSPECTED_SILENCE, Closed, NumberedStream

BLOCK = bytes(range(256)) * 4096


def kinds(pair: StreamPair, calls: bool) -> list[Kind]:
    return [decode_packet(data).kind for of, data in pair.sent if of is calls]


def opened(**faults) -> StreamPair:
    pair = StreamPair(**faults)
    pair.run(1.0)
    assert pair.near.opened == 1
    pair.sent.clear()
    return pair


def test_unacknowledged_data_is_pending():
    """A link leaves a dead path before heartbeats notice it."""
    pair = opened()
    pair.write(pair.near, b"one")
    assert pair.near.stream.delivery.is_pending
    pair.run(1.0)
    before = pair.near.stream.delivery
    assert not before.is_pending
    assert 2 * DELAY <= before.round_trip <= 2 * DELAY + ACK_DELAY + 1e-6
    pair.is_lost = lambda calls, data: True
    pair.write(pair.near, b"two")
    pair.run(1.0)
    after = pair.near.stream.delivery
    assert (after.acked, after.is_pending) == (before.acked, True)
    assert before.acked > 0


# Opening


def test_a_stream_is_opened_once():
    pair = StreamPair(repeat=1.0)
    pair.run(5.0)
    assert (pair.near.opened, pair.far.opened) == (1, 0)
    assert kinds(pair, True).count(Kind.OPEN) == 1


def test_a_lost_open_is_repeated():
    """Subscriptions are declared asynchronously: the first packets may have no receiver."""
    pair = StreamPair()
    pair.is_lost = lambda calls, data: pair.now < 100.5
    pair.run(3.0)
    assert pair.near.opened == 1
    assert kinds(pair, True) == [Kind.OPEN] * 4


def test_data_that_overtakes_the_acceptance_opens_the_stream():
    pair = StreamPair()
    pair.is_lost = lambda calls, data: decode_packet(data).kind is Kind.ACCEPT
    pair.write(pair.far, b"first")
    pair.run(0.5)
    assert (pair.near.opened, pair.near.received) == (1, b"first")


def test_an_open_without_an_answer_ends_after_the_silence_limit():
    pair = StreamPair()
    pair.is_lost = lambda calls, data: True
    pair.run(SILENCE - 0.1)
    assert pair.near.ends == []
    pair.run(0.2)
    assert pair.near.ends == ["no answer for 10 s"]


# Order


@given(
    st.integers(0, 1 << 20),
    st.floats(0, 0.3),
    st.floats(0, 0.5),
    st.floats(0, 0.5),
    st.lists(st.integers(0, 3 * MAX_SEGMENT), max_size=20),
)
def test_bytes_keep_their_order_on_any_path(seed, lose, repeat, reorder, sizes):
    pair = StreamPair(seed, lose, repeat, reorder)
    sent = {id(pair.near): b"", id(pair.far): b""}
    for number, size in enumerate(sizes):
        end = pair.near if number % 3 else pair.far
        data = bytes([number]) * size
        pair.write(end, data)
        sent[id(end)] += data
        pair.run(0.05)
        assert sent[id(pair.near)].startswith(pair.far.received)
    pair.run(200.0)
    if pair.near.ends or pair.far.ends:
        # So many packets were lost that both ends consider the path dead; the received bytes are in order.
        assert lose > 0.1
        assert sent[id(pair.near)].startswith(pair.far.received)
        assert sent[id(pair.far)].startswith(pair.near.received)
    else:
        assert pair.far.received == sent[id(pair.near)]
        assert pair.near.received == sent[id(pair.far)]


def test_a_gap_is_repeated_before_the_time_out():
    pair = opened()
    lost = []

    def is_lost(calls, data):
        packet = decode_packet(data)
        if calls and packet.kind is Kind.DATA and packet.number == 2 and not lost:
            lost.append(data)
            return True
        return False

    pair.is_lost = is_lost
    for number in range(8):
        pair.write(pair.near, bytes([number]))
    pair.run(3 * 0.01 + 0.02)
    assert pair.far.received == bytes(range(8))


def test_the_last_packet_of_a_burst_is_repeated_after_the_time_out():
    pair = opened()
    first = []
    pair.is_lost = lambda calls, data: calls and not first and not first.append(data)
    pair.write(pair.near, b"alone")
    pair.run(0.1)
    assert pair.far.received == b""
    pair.run(1.0)
    assert pair.far.received == b"alone"
    assert pair.near.ends == []


def test_a_reply_carries_the_acknowledgement():
    """A hop and its confirmation are two packets, and one acknowledgement."""
    pair = opened()
    pair.write(pair.near, b"hop")
    pair.run(0.01)
    pair.write(pair.far, b"confirmation")
    pair.run(5.0)
    assert kinds(pair, False) == [Kind.DATA]
    assert kinds(pair, True) == [Kind.DATA, Kind.ACK]


def test_a_late_packet_is_not_counted_as_several_lost_ones():
    """A pause of the path longer than the time-out repeats one packet, not all packets in flight."""
    pair = opened()
    for _ in range(20):
        pair.write(pair.near, b"x")
        pair.run(0.1)
    pair.sent.clear()
    pair._free[True] = pair.now + 0.35
    for number in range(10):
        pair.write(pair.near, bytes([number]))
    pair.run(3.0)
    assert pair.far.received[-10:] == bytes(range(10))
    repeated = [data for of, data in pair.sent if of and decode_packet(data).kind is Kind.DATA]
    assert len(repeated) <= 12


# Malformed packets


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x03" * 10,
        bytes(11),
        b"\xff" * 40,
        Packet(Kind.ACK, 0, 1000, 0, b"").encode(),
        Packet(Kind.ACK, 0, 0, 1, b"").encode(),
        Packet(Kind.ACK, 0, 0, 0, b"more").encode(),
        Packet(Kind.DATA, 0, 1000, 0, b"x").encode(),
    ],
)
def test_a_malformed_packet_counts_as_lost(data):
    pair = opened()
    before = pair.near.stream.deadline
    assert pair.near.stream.on_packet(data, pair.now) == []
    assert pair.near.stream.deadline == before
    pair.write(pair.far, b"after")
    pair.run(1.0)
    assert pair.near.received == b"after"


@given(st.lists(st.binary(max_size=40), max_size=30))
def test_any_bytes_end_the_stream_at_most(packets):
    stream = NumberedStream(0.0, calls=False)
    for data in packets:
        effects = stream.on_packet(data, 1.0)
        assert sum(isinstance(effect, Closed) for effect in effects) <= 1
    stream.on_time(1000.0)
    assert stream.is_closed


def test_a_packet_far_ahead_is_not_kept():
    pair = opened()
    for number in range(1, 3 * MAX_AHEAD):
        pair.far.stream.on_packet(Packet(Kind.DATA, number, 0, 0, bytes(MAX_SEGMENT)).encode(), pair.now)
    assert MAX_BYTES - MAX_SEGMENT < pair.far.stream._buffer.size <= MAX_BYTES


def test_a_peer_that_exceeds_the_window_is_reset():
    pair = opened()
    pair.far.stream.pause()
    for number in range(2 * MAX_AHEAD):
        packet = Packet(Kind.DATA, number, 0, 0, bytes(MAX_SEGMENT)).encode()
        pair.do(pair.far, pair.far.stream.on_packet(packet, pair.now))
        if pair.far.ends:
            break
    assert pair.far.ends == ["the peer exceeds the window"]
    pair.run(1.0)
    assert pair.near.ends == ["the peer has reset the stream"]


def test_a_stream_ends_before_its_numbers_repeat():
    pair = opened()
    pair.near.stream._next = MAX_NUMBER
    pair.write(pair.near, b"one more")
    assert pair.near.ends == ["its numbers are used up"]


# The window


def test_a_paused_reader_stops_the_sender_and_keeps_the_stream():
    pair = opened()
    pair.far.stream.pause()
    pair.write(pair.near, BLOCK)
    pair.run(60.0)
    assert pair.far.received == b""
    assert pair.near.stream.pending >= len(BLOCK) - MAX_WINDOW - MAX_SEGMENT
    assert pair.near.ends == pair.far.ends == []
    pair.do(pair.far, pair.far.stream.resume(pair.now))
    pair.run(2.0)
    assert pair.far.received == BLOCK


def test_a_lost_resume_notice_is_requested_again():
    pair = opened()
    pair.far.stream.pause()
    pair.write(pair.near, BLOCK)
    pair.run(5.0)
    pair.is_lost = lambda calls, data: not calls
    pair.do(pair.far, pair.far.stream.resume(pair.now))
    pair.run(0.005)
    pair.is_lost = lambda calls, data: False
    pair.run(3.0)
    assert pair.far.received == BLOCK


def test_at_most_a_window_is_in_flight_to_a_stopped_process():
    pair = opened()
    pair.stopped.add(id(pair.far))
    for _ in range(16):
        pair.write(pair.near, BLOCK)
    assert pair.near.stream.in_flight <= MAX_WINDOW + MAX_SEGMENT
    pair.run(SILENCE - 0.5)
    assert pair.near.ends == []
    pair.run(1.0)
    assert pair.near.ends == ["no answer for 10 s"]
    # One packet is repeated, with growing pauses: the fabric queues little for the process.
    assert sum(len(data) for of, data in pair.sent if of) < MAX_WINDOW


def test_a_slow_path_keeps_the_window_small():
    """A stop order waits behind the packets that the fabric has queued."""
    pair = opened()
    pair.per_byte = 8 / 57_600
    pair.write(pair.near, BLOCK[:200_000])
    pair.run(20.0)
    assert pair.near.stream.window.size <= 3 * MIN_WINDOW
    pair.run(60.0)
    assert pair.far.received == BLOCK[:200_000]


def test_a_fast_path_opens_the_window():
    pair = opened()
    pair.write(pair.near, BLOCK)
    pair.run(3.0)
    assert pair.near.stream.window.size == MAX_WINDOW


def test_the_time_out_grows_and_shrinks_again():
    window = SendWindow()
    window.on_answer(0.01, 100, 100)
    usual = window.timeout
    for _ in range(20):
        window.on_silence()
    assert window.timeout == 1.0
    window.on_answer(0.01, 100, 100)
    assert window.timeout <= usual


def test_an_unused_window_does_not_grow():
    """Small messages on a slow path must not admit a large block at once."""
    window = SendWindow()
    for _ in range(1000):
        window.on_answer(0.01, 1000, 1000)
    assert window.size == INITIAL_WINDOW


# Silence


def test_an_idle_stream_probes_rarely_and_stays_open():
    pair = opened()
    pair.run(10 * IDLE)
    assert pair.near.ends == pair.far.ends == []
    assert len(pair.sent) <= 2 * 2 * 11


def test_a_peer_that_vanishes_while_idle_is_noticed():
    pair = opened()
    pair.stopped.add(id(pair.far))
    pair.run(IDLE + SILENCE + 1.0)
    assert pair.near.ends == ["no answer for 25 s"]


def test_data_after_a_long_silence_gets_the_full_time_limit():
    pair = opened()
    pair.run(IDLE - 2.0)
    pair.stopped.add(id(pair.far))
    pair.write(pair.near, b"x")
    pair.run(SILENCE - 0.5)
    assert pair.near.ends == []
    pair.run(1.0)
    assert len(pair.near.ends) == 1


def test_a_stream_with_a_suspected_peer_ends_soon():
    pair = opened()
    pair.stopped.add(id(pair.far))
    pair.do(pair.near, pair.near.stream.on_suspicion(pair.now))
    pair.run(SUSPECTED_SILENCE + 0.1)
    assert len(pair.near.ends) == 1


def test_a_suspected_peer_that_answers_is_kept():
    """The end of a liveliness token may be that of a router, and it may overtake data."""
    pair = opened()
    pair.write(pair.far, b"sent before the end of the token")
    pair.do(pair.near, pair.near.stream.on_suspicion(pair.now))
    pair.run(3 * SUSPECTED_SILENCE)
    assert (pair.near.ends, pair.near.received) == ([], b"sent before the end of the token")


# Closing


@pytest.mark.parametrize("lose", [0.0, 0.2])
def test_a_close_follows_the_data_sent_before(lose):
    pair = opened(seed=7, lose=lose)
    pair.write(pair.near, BLOCK)
    pair.close(pair.near)
    pair.close(pair.near)
    pair.write(pair.near, b"ignored")
    pair.run(200.0)
    assert (pair.far.received, pair.far.ends) == (BLOCK, [""])


def test_both_ends_may_close_at_once():
    pair = opened()
    pair.close(pair.near)
    pair.close(pair.far)
    pair.run(1.0)
    assert pair.near.ends == pair.far.ends == [""]


def test_a_paused_reader_receives_all_data_before_the_end():
    pair = opened()
    pair.far.stream.pause()
    pair.write(pair.near, b"last")
    pair.close(pair.near)
    pair.run(5.0)
    assert (pair.far.received, pair.far.ends) == (b"", [])
    pair.do(pair.far, pair.far.stream.resume(pair.now))
    assert (pair.far.received, pair.far.ends) == (b"last", [""])


def test_a_reset_after_the_own_end_is_a_regular_close():
    """The other end has closed the stream: its acknowledgement of the end was lost."""
    pair = opened()
    pair.is_lost = lambda calls, data: not calls
    pair.close(pair.near)
    pair.run(0.1)
    assert (pair.near.ends, pair.far.ends) == ([], [""])
    pair.do(pair.near, pair.near.stream.on_packet(Packet(Kind.RESET, 0, 0, 0, b"").encode(), pair.now))
    assert pair.near.ends == [""]


def test_both_ends_report_an_abort():
    pair = opened()
    pair.do(pair.near, pair.near.stream.abort())
    pair.do(pair.near, pair.near.stream.abort())
    pair.run(1.0)
    assert pair.near.ends == [""]
    assert pair.far.ends == ["the peer has reset the stream"]
    assert pair.far.stream.deadline is None
