"""The send queue of a link: stops precede everything, other kinds share the link, and each keeps its
order."""

from __future__ import annotations

import asyncio
import random
import socket

import pytest

from lfield.authority.identity import ANONYMOUS
from lfield.errors import WireError
from lfield.net.coding.traffic_kinds import TrafficKind
from lfield.net.framed_link import FramedLink
from lfield.net.scheduling.link_schedulers import LinkScheduler
from lfield.net.scheduling.send_queue import INITIAL_PART, LARGEST_PART, MIN_PART, SHARES, SendQueue
from lfield.net.stream_link import StreamLink
from lfield.testing.transport_kit import Recorder, transfer
from lfield.wire.codec import CONTROL, HELLO, PART, encode
from lfield.wire.events import Event, LineLogged
from lfield.wire.framing import frame
from lfield.wire.messages import Backpressure, Ping
from lfield.wire.observer_messages import EmergencyStop, EmergencyStopResult
from lfield.wire.subscription_messages import EventBatch

STOP = EmergencyStop(bytes(16), "fire")


class NoSocket:
    """Accepts every socket option."""

    family = socket.AF_INET

    def setsockopt(self, level, option, value) -> None:
        pass


class Slow(asyncio.Transport):
    """A connection that accepts `room` bytes, then nothing until `drain`."""

    def __init__(self, room: int) -> None:
        super().__init__()
        self.room, self.left, self.written_parts = room, room, []
        self.is_over = False

    def link(self, max_pending: int = 1 << 24) -> StreamLink:
        made = StreamLink(
            1 << 23, max_pending, lambda link: Recorder(), LinkScheduler(), lambda at: ANONYMOUS, calls=True
        )
        self._link = made
        made.connection_made(self)
        made.accept_role("host")
        return made

    def write(self, data) -> None:
        self.written_parts.append(bytes(data))
        full = self.left <= 0
        self.left -= len(data)
        if self.left <= 0 and not full:
            self._link.pause_writing()

    def drain(self) -> None:
        self.left = self.room
        self._link.resume_writing()

    def get_extra_info(self, name, default=None):
        if name == "socket":
            return NoSocket()
        return ("10.0.0.1", 6000) if name == "peername" else default

    def set_write_buffer_limits(self, high=None, low=None) -> None:
        pass

    def is_closing(self) -> bool:
        return self.is_over

    def abort(self) -> None:
        self.is_over = True

    def close(self) -> None:
        self.is_over = True

    def get_write_buffer_size(self) -> int:
        return 0


class FarEnd(FramedLink):
    """The peer of the connection."""

    def __init__(self) -> None:
        super().__init__("near", 1 << 23)
        self.handler = Recorder()
        self.accept_role("host")

    def close(self) -> None:
        self.closed = True


def decoded_messages(written_parts) -> list[object]:
    far = FarEnd()
    for data in written_parts:
        far.received(data)
    assert far._error is None
    return far.handler.messages


def in_loop(scenario) -> None:
    async def main():
        scenario()

    asyncio.run(main())


def test_a_stop_is_sent_between_two_parts_of_a_block():
    def scenario():
        slow = Slow(8 << 10)
        link = slow.link()
        block = random.Random(1).randbytes(1 << 20)
        link.send_transfer(transfer(len(block)), block)
        link.send(Backpressure("behind"))
        link._flush()
        written = sum(map(len, slow.written_parts))
        assert written < 64 << 10
        link.send(STOP)
        assert slow.written_parts[-1] == encode(STOP)
        while slow._link._sending.is_busy:
            slow.drain()
        assert decoded_messages(slow.written_parts) == [
            STOP,
            Backpressure("behind"),
            (transfer(len(block)), block),
        ]

    in_loop(scenario)


def test_each_kind_keeps_its_order_and_is_decoded_when_others_overtake_it():
    """Compressed messages, coordinators and long reports on a link that accepts a few bytes at a time."""

    def scenario():
        slow, rng = Slow(700), random.Random(1)
        link = slow.link()
        sent: dict[str, list[object]] = {"control": [], "hops": [], "events": [], "stops": []}
        for number in range(300):
            size = rng.choice((10, 300, 6000))
            match rng.choice(tuple(sent)):
                case "control":
                    sent["control"].append(Backpressure(rng.randbytes(min(size, 1000)).hex()))
                    link.send(sent["control"][-1])
                case "hops":
                    block = rng.randbytes(size)
                    sent["hops"].append((transfer(size, number), block))
                    link.send_transfer(*sent["hops"][-1])
                case "events":
                    lines = [LineLogged(rng.randbytes(900).hex()) for _ in range(size // 300)]
                    events = [Event(number, 0.0, 0.0, 0, line) for line in lines]
                    sent["events"].append(EventBatch(1, number, 0.0, 0.0, 0, 0, events))
                    link.send(sent["events"][-1])
                case "stops":
                    sent["stops"].append(STOP)
                    link.send(STOP)
            if rng.random() < 0.5:
                link._flush()
            if rng.random() < 0.02:
                slow.drain()
        link._flush()
        assert slow._link._sending.is_busy
        while slow._link._sending.is_busy:
            slow.drain()
        found = decoded_messages(slow.written_parts)
        assert [each for each in found if isinstance(each, Backpressure)] == sent["control"]
        assert [each for each in found if isinstance(each, EventBatch)] == sent["events"]
        assert [each for each in found if isinstance(each, tuple)] == sent["hops"]
        assert sum(each == STOP for each in found) == len(sent["stops"])
        assert link.traffic.counts[TrafficKind.EVENTS] > 0
        assert link.traffic.counts[TrafficKind.STOP] == len(encode(STOP)) * len(sent["stops"])

    in_loop(scenario)


def test_waiting_kinds_share_the_connection():
    queue = SendQueue()
    for kind in SHARES:
        for _ in range(2000):
            queue.add(frame(CONTROL, bytes(100)) + bytes([kind]), kind)
    sent = [queue.next()[-1] for _ in range(2000)]
    assert TrafficKind(sent[0]) == TrafficKind.CONTROL
    for kind, share in SHARES.items():
        assert sent.count(kind) == pytest.approx(2000 * share / sum(SHARES.values()), abs=2)


def test_an_idle_kind_gets_no_more_than_its_share_later():
    queue = SendQueue()
    for _ in range(1000):
        queue.add(frame(CONTROL, bytes(100)), TrafficKind.HOP)
    for _ in range(500):
        queue.next()
    for _ in range(500):
        queue.add(frame(CONTROL, bytes(10)), TrafficKind.CONTROL)
    sizes = [len(queue.next()) for _ in range(100)]
    assert sum(size for size in sizes if size > 50) == pytest.approx(sum(s for s in sizes if s < 50), abs=110)


def test_answers_to_stops_and_heartbeats_precede_reports_to_observers():
    def scenario():
        slow = Slow(1 << 10)
        link = slow.link()
        rng = random.Random(1)
        reports = [Backpressure(rng.randbytes(400).hex()) for n in range(10)]
        for message in reports:
            link.send(message)
            link._flush()
        answer = EmergencyStopResult({"fc": ""}, "", bytes(16))
        link.send(answer)
        link.send(Ping(7))
        while slow._link._sending.is_busy:
            slow.drain()
        found = decoded_messages(slow.written_parts)
        assert [message for message in found if isinstance(message, Backpressure)] == reports
        assert found.index(answer) <= 4
        assert found.index(Ping(7)) == found.index(answer) + 1

    in_loop(scenario)


def test_a_message_is_not_overtaken_by_one_sent_later_in_the_same_turn():
    def scenario():
        slow = Slow(1 << 20)
        link = slow.link()
        link.send(Backpressure("first"))
        link.send(STOP)
        link._flush()
        assert decoded_messages(slow.written_parts) == [Backpressure("first"), STOP]

    in_loop(scenario)


def test_a_link_whose_peer_does_not_read_is_closed_at_the_queue_limit():
    def scenario():
        slow = Slow(1 << 10)
        link, rng = slow.link(max_pending=1 << 16), random.Random(1)
        for _ in range(200):
            link.send(Backpressure(rng.randbytes(500).hex()))
            link._flush()
            if link.closed:
                break
        assert link.closed
        assert isinstance(link._error, WireError)
        assert sum(map(len, slow.written_parts)) < 4 << 10

    in_loop(scenario)


def test_queued_bytes_are_sent_before_a_link_is_closed():
    def scenario():
        slow = Slow(1 << 10)
        link = slow.link()
        block = bytes(100_000)
        link.send_transfer(transfer(len(block)), block)
        link.close()
        assert decoded_messages(slow.written_parts) == [(transfer(len(block)), block)]

    in_loop(scenario)


def test_parts_are_short_on_a_slow_connection_and_long_on_a_fast_one():
    slow, now = SendQueue(), 0.0
    slow.add(frame(CONTROL, bytes(1 << 20)), TrafficKind.CONTROL)
    lengths = []
    for _ in range(12):
        lengths.append(len(slow.next()))
        slow.on_full(now)
        now += lengths[-1] / 7200.0
        slow.on_writable(now)
    assert slow.part == MIN_PART
    assert lengths[-1] <= MIN_PART + 5
    fast = SendQueue()
    fast.add(frame(CONTROL, bytes(1 << 20)), TrafficKind.CONTROL)
    for _ in range(12):
        fast.next()
        fast.on_accepted()
    assert fast.part == LARGEST_PART


def test_a_hello_is_never_sent_in_parts():
    sending = SendQueue()
    hello = frame(HELLO, bytes(4 * INITIAL_PART))
    sending.add(hello, TrafficKind.CONTROL)
    assert sending.next() == hello
    assert not sending.is_busy


@pytest.mark.parametrize(
    "bad",
    [
        frame(PART, encode(Backpressure("a")) + encode(Backpressure("b"))),
        frame(PART, frame(PART, encode(Backpressure("a")))),
        frame(PART, encode(Backpressure("a"))[:9]) + frame(PART, encode(Backpressure("a"))[9:] + b"x"),
        frame(PART, bytes(1 << 18)),
    ],
)
def test_parts_that_do_not_form_one_frame_close_the_link(bad):
    far = FarEnd()
    far.received(bad)
    assert far.closed
    assert isinstance(far._error, WireError)
