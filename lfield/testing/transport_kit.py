"""The requirements for every transport, as tests.

A test module makes a class of its own from `TransportKit` and gives it a `bench` fixture:

    class TestMyTransport(TransportKit):
        @pytest.fixture
        def bench(self):
            yield MyBench()

The kit needs pytest (the `test` extra). `tests/net` runs it on both of lfield's transports.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, TypeVar

import pytest

from lfield.errors import AddressError, CpuBudgetExceeded, HandshakeError, LfieldError, WireError
from lfield.wire.codec import CONTROL, HANDSHAKE_LIMITS, HELLO, TRANSFER, encode, encode_transfer
from lfield.wire.coordinator_messages import Terminated, Transfer
from lfield.wire.events import Event, LineLogged
from lfield.wire.fields import MAX_TEXT
from lfield.wire.framing import frame_header
from lfield.wire.messages import Backpressure, HandshakeRefused, Hello, Message, Ping, Pong, Role
from lfield.wire.observer_messages import EmergencyStop
from lfield.wire.subscription_messages import EventBatch

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from lfield.net.transport import Link, LinkHandler, Transport

T = TypeVar("T")

#: The block limit of a bench's transports, in bytes.
MAX_BLOCK = 1 << 20


class TransportBench(Protocol):
    """A transport under test, and a way to run it."""

    #: The transport, created with a `max_block` of MAX_BLOCK.
    transport: Transport
    #: An address to listen at, with port 0.
    address: str

    def wait(self, work: Coroutine[object, object, T]) -> T:
        """Runs a coroutine of the transport to its end."""

    def until(self, done: Callable[[], bool]) -> None:
        """Runs the network until `done()`; fails if that never becomes true."""

    def write(self, link: Link, data: bytes) -> None:
        """Sends bytes that are not a message."""


class Recorder:
    """A handler that records its calls."""

    def __init__(self, refuse: str = "") -> None:
        self.link: Link | None = None
        self.messages: list[Message | tuple[Transfer, bytes]] = []
        self.oversize: list[tuple[Transfer, int]] = []
        self.excesses: list[CpuBudgetExceeded] = []
        self.ends: list[LfieldError | None] = []
        self._refuse = refuse

    def on_message(self, link: Link, message: Message) -> None:
        """Records a message; refuses the peer if configured."""
        self.messages.append(message)
        if self._refuse:
            link.send(HandshakeRefused(self._refuse))
            raise HandshakeError(self._refuse)

    def on_transfer(self, link: Link, header: Transfer, block: memoryview) -> None:
        self.messages.append((header, bytes(block)))

    def on_oversize(self, link: Link, header: Transfer, size: int) -> None:
        self.oversize.append((header, size))

    def on_excess(self, link: Link, error: CpuBudgetExceeded) -> None:
        self.excesses.append(error)

    def on_closed(self, link: Link, error: LfieldError | None) -> None:
        """Records the reason."""
        self.ends.append(error)


class Pair:
    """A listener and links to it; `near` and `far` are the two ends of the first.

    Both have completed the handshake as `role`; without one, neither has.
    """

    def __init__(self, bench: TransportBench, refuse: str = "", role: Role | None = "host") -> None:
        self.bench = bench
        self.accepted: list[Recorder] = []
        self._refuse, self._role = refuse, role
        self.listener = bench.wait(bench.transport.listen(bench.address, self._on_link))
        self.link, self.near = self.connect()
        self.far = self.accepted[0]

    def connect(self) -> tuple[Link, Recorder]:
        """Opens another link to the listener; returns once both ends exist."""
        recorder, number = Recorder(), len(self.accepted)
        link = self.bench.wait(self.bench.transport.connect(self.listener.address, recorder))
        self.bench.until(lambda: len(self.accepted) > number)
        if self._role:
            link.accept_role(self._role)
        return link, recorder

    def _on_link(self, link: Link) -> LinkHandler:
        handler = Recorder(self._refuse)
        handler.link = link
        if self._role:
            link.accept_role(self._role)
        self.accepted.append(handler)
        return handler


def transfer(size: int, sequence: int = 1) -> Transfer:
    """A header for a block of that size."""
    return Transfer("Tour:one", 1, sequence, 1, b"p" * 32, 7, size)


class TransportKit:
    """The tests. A subclass gives the `bench` fixture."""

    @pytest.fixture
    def pair(self, bench: TransportBench) -> Pair:
        """A new link."""
        return Pair(bench)

    def test_messages_keep_their_order_both_ways(self, bench: TransportBench, pair: Pair) -> None:
        assert pair.far.link is not None
        for token in range(1000):
            pair.link.send(Ping(token))
            pair.far.link.send(Pong(token))
        bench.until(lambda: len(pair.far.messages) == 1000 == len(pair.near.messages))
        assert pair.far.messages == [Ping(token) for token in range(1000)]
        assert pair.near.messages == [Pong(token) for token in range(1000)]

    def test_blocks_and_messages_about_them_keep_their_order(self, bench: TransportBench, pair: Pair) -> None:
        blocks = [
            bytes([i]) * size for i, size in enumerate((0, 1, 1000, 64 * 1024, 64 * 1024 + 1, MAX_BLOCK))
        ]
        for number, block in enumerate(blocks):
            pair.link.send_transfer(transfer(len(block), number), block)
            pair.link.send(Terminated("t", number, "done", "", "a"))
        bench.until(lambda: len(pair.far.messages) == 2 * len(blocks))
        expected: list[Message | tuple[Transfer, bytes]] = []
        for number, block in enumerate(blocks):
            expected += [(transfer(len(block), number), block), Terminated("t", number, "done", "", "a")]
        assert pair.far.messages == expected

    def test_many_small_blocks(self, bench: TransportBench, pair: Pair) -> None:
        for number in range(2000):
            pair.link.send_transfer(transfer(64, number), memoryview(bytearray(64)))
        bench.until(lambda: len(pair.far.messages) == 2000)
        assert pair.far.messages[-1] == (transfer(64, 1999), bytes(64))

    def test_a_close_is_seen_on_both_sides_after_what_was_sent(
        self, bench: TransportBench, pair: Pair
    ) -> None:
        pair.link.send(Ping(1))
        pair.link.close()
        pair.link.close()
        assert pair.near.ends == [], "no callback inside close"
        bench.until(lambda: bool(pair.near.ends and pair.far.ends))
        assert (pair.far.messages, pair.near.ends, pair.far.ends) == ([Ping(1)], [None], [None])

    def test_the_side_that_was_called_may_close_too(self, bench: TransportBench, pair: Pair) -> None:
        assert pair.far.link is not None
        pair.far.link.close()
        bench.until(lambda: bool(pair.near.ends and pair.far.ends))
        assert (pair.near.ends, pair.far.ends) == ([None], [None])

    def test_sending_on_a_closed_link_is_an_error(self, bench: TransportBench, pair: Pair) -> None:
        pair.link.close()
        with pytest.raises(AddressError, match="the link to it is closed"):
            pair.link.send(Ping(1))
        with pytest.raises(AddressError, match="the link to it is closed"):
            pair.link.send_transfer(transfer(1), b"x")
        bench.until(lambda: bool(pair.far.ends))
        assert pair.far.link is not None
        with pytest.raises(AddressError, match="the link to it is closed"):
            pair.far.link.send(Ping(1))

    def test_connecting_where_nobody_listens_is_an_error(self, bench: TransportBench, pair: Pair) -> None:
        address = pair.listener.address
        pair.listener.close()
        with pytest.raises(AddressError, match="no program listens there"):
            bench.wait(bench.transport.connect(address, Recorder()))
        pair.link.send(Ping(1))
        bench.until(lambda: pair.far.messages == [Ping(1)])

    def test_a_port_in_use_is_an_error(self, bench: TransportBench, pair: Pair) -> None:
        with pytest.raises(AddressError, match="the port is in use") as caught:
            bench.wait(bench.transport.listen(pair.listener.address, lambda link: Recorder()))
        assert caught.value.address == pair.listener.address

    @pytest.mark.parametrize("address", ["", ":1", "host:", "host:http", "host:65536", "[::1", "[::1]8181"])
    def test_what_is_no_address_is_an_error(self, bench: TransportBench, address: str) -> None:
        with pytest.raises(AddressError, match="cannot use"):
            bench.wait(bench.transport.connect(address, Recorder()))
        with pytest.raises(AddressError, match="cannot use"):
            bench.wait(bench.transport.listen(address, lambda link: Recorder()))

    def test_an_oversize_block_is_skipped_and_reported(self, bench: TransportBench, pair: Pair) -> None:
        size = MAX_BLOCK + 2000
        pair.link.send_transfer(transfer(size), bytes(size))
        pair.link.send(Backpressure(""))
        bench.until(lambda: bool(pair.far.messages and pair.far.oversize))
        assert pair.far.messages == [Backpressure("")]
        assert pair.far.oversize == [(transfer(size), size)]
        assert pair.far.ends == []

    @pytest.mark.parametrize(
        "data",
        [
            b"GET / HTTP/1.1\r\n\r\n",
            bytes(64),
            b"\xff" * 64,
            (1 << 30).to_bytes(4, "big") + bytes([CONTROL]),
            b"\x00\x00\x00\x03" + bytes([CONTROL]) + b"\x92\x63",
            b"\x00\x00\x00\x03" + bytes([TRANSFER]) + b"\x00\x00",
            encode_transfer(transfer(5), b"four") + b"four",
            encode(Terminated("", 1, "done", "", "a")),
            encode(Ping(2))[:-1] + b"\x03",
            encode_transfer(transfer(4), b"four") + b"foar",
        ],
    )
    def test_bad_bytes_close_that_link_and_no_other(
        self, bench: TransportBench, pair: Pair, data: bytes
    ) -> None:
        other, _ = pair.connect()
        bench.write(pair.link, encode(Ping(1)) + data)
        bench.until(lambda: bool(pair.far.ends and pair.near.ends))
        assert pair.far.messages == [Ping(1)]
        assert isinstance(pair.far.ends[0], WireError)
        other.send(Ping(2))
        bench.until(lambda: pair.accepted[1].messages == [Ping(2)])

    def test_a_message_cut_short_by_a_close_is_reported(self, bench: TransportBench, pair: Pair) -> None:
        bench.write(pair.link, encode_transfer(transfer(1000), bytes(1000)) + bytes(10))
        pair.link.close()
        bench.until(lambda: bool(pair.far.ends))
        assert pair.far.messages == []
        assert isinstance(pair.far.ends[0], WireError)
        assert "in the middle of a message" in str(pair.far.ends[0])

    def test_a_message_may_come_a_byte_at_a_time(self, bench: TransportBench, pair: Pair) -> None:
        for byte in encode(Ping(1)) + encode_transfer(transfer(9), bytes(9)) + bytes(9) + encode(Ping(2)):
            bench.write(pair.link, bytes([byte]))
        bench.until(lambda: len(pair.far.messages) == 3)
        assert pair.far.messages == [Ping(1), (transfer(9), bytes(9)), Ping(2)]

    def test_a_handler_that_refuses_closes_after_its_last_word(self, bench: TransportBench) -> None:
        pair = Pair(bench, refuse="wrong program")
        pair.link.send(Ping(1))
        pair.link.send(Ping(2))
        bench.until(lambda: bool(pair.near.ends and pair.far.ends))
        assert pair.near.messages == [HandshakeRefused("wrong program")]
        assert pair.far.messages == [Ping(1)]
        assert isinstance(pair.far.ends[0], HandshakeError)

    @pytest.mark.parametrize(
        "data",
        [
            encode(Ping(1)),
            encode_transfer(transfer(4), b"four") + b"four",
            encode_transfer(transfer(2 * MAX_BLOCK), b"")[:5],
            frame_header(HELLO, HANDSHAKE_LIMITS[HELLO] + 1),
        ],
    )
    def test_before_the_greeting_only_a_small_greeting_passes(
        self, bench: TransportBench, data: bytes
    ) -> None:
        pair = Pair(bench, role=None)
        bench.write(pair.link, encode(Hello("host", "a", 1)) + data)
        bench.until(lambda: bool(pair.far.ends and pair.near.ends))
        assert pair.far.messages == [Hello("host", "a", 1)]
        assert isinstance(pair.far.ends[0], WireError)

    def test_a_greeted_observer_may_send_what_is_small(self, bench: TransportBench) -> None:
        pair = Pair(bench, role="observer")
        longest = EmergencyStop(bytes(16), "\U0010ffff" * MAX_TEXT)
        pair.link.send(longest)
        bench.until(lambda: pair.far.messages == [longest])
        pair.link.send(EventBatch(1, 1, 0.0, 0.0, 0, 0, [Event(1, 0.0, 0.0, 0, LineLogged("x" * 2000))] * 9))
        bench.until(lambda: bool(pair.far.ends and pair.near.ends))
        assert isinstance(pair.far.ends[0], WireError)

    def test_an_aborted_link_is_seen_on_both_sides(self, bench: TransportBench, pair: Pair) -> None:
        pair.link.abort()
        pair.link.abort()
        assert pair.near.ends == [], "no callback inside abort"
        bench.until(lambda: bool(pair.near.ends and pair.far.ends))
        with pytest.raises(AddressError, match="the link to it is closed"):
            pair.link.send(Ping(1))
