"""Numbered stream: an ordered, reliable stream of bytes over packets that may be lost, repeated or reordered.

Sans-IO: events in, effects out; the time is passed in. Zenoh's own order and reliability hold from hop to hop
only: a router that ends, a full queue, and a subscription that is not declared everywhere yet lose packets,
and neither end gets a report. So both ends number their packets and repeat those that are not acknowledged.
Opening and closing are packets of this stream too: the end of a liveliness token may overtake data.
"""

from __future__ import annotations

from collections import deque

from msgspec import Struct

from lfield.net.health.traffic import Delivery
from lfield.net.zenoh.packets import MAX_NUMBER, Kind, Packet, decode_packet
from lfield.net.zenoh.receive_buffer import MAX_AHEAD, Arrival, ReceiveBuffer
from lfield.net.zenoh.send_window import MAX_SEGMENT, SendWindow

#: Delay of an acknowledgement in seconds, and the received bytes that are acknowledged at once.
ACK_DELAY, ACK_BYTES = 0.02, MAX_SEGMENT
#: First and longest delay in seconds between two requests to open a stream.
FIRST_OPEN, LAST_OPEN = 0.1, 1.0
#: Seconds of silence that end a stream with unacknowledged data, and that end a stream whose peer has lost
#: its session.
SILENCE, SUSPECTED_SILENCE = 10.0, 3.0
#: Seconds of silence after which an idle stream asks its peer, and after which a stream whose peer has not
#: read asks again.
IDLE, STALLED = 15.0, 1.0


class SendPacket(Struct, frozen=True):
    """Publish a packet."""

    data: bytes


class Deliver(Struct, frozen=True):
    """Pass bytes to the owner of the stream."""

    data: bytes


class Opened(Struct, frozen=True):
    """The peer has accepted the stream."""


class Closed(Struct, frozen=True):
    """The stream has ended; `reason` is '' after a regular close by either side. Always the last effect."""

    reason: str


Effect = SendPacket | Deliver | Opened | Closed


class _Sent(Struct):
    """A numbered packet that is not acknowledged: the time of sending, and the number of sendings."""

    kind: Kind
    data: bytes
    at: float
    times: int = 1


class NumberedStream:
    """One end of a stream, which the end with `calls` opens.

    Each method returns the effects in order. The owner calls `on_time` at `deadline`.
    """

    def __init__(self, now: float, *, calls: bool) -> None:
        self._calls, self.is_open, self.is_closed = calls, not calls, False
        self.window = SendWindow()
        #: The data that was not sent, and its size.
        self._pending: deque[memoryview] = deque()
        self.pending = 0
        #: Packets from `_acknowledged` to `_next` - 1; the peer has read those before `_read_by_peer`.
        self._sent: deque[_Sent] = deque()
        self._next = self._acknowledged = self._read_by_peer = 0
        #: Sizes of the packets that the peer has not read, and their sum.
        self._unread_sizes: deque[int] = deque()
        self.in_flight = 0
        #: The time when the peer is asked for the first of these packets; the number of the last question,
        #: and of the next packet at that time.
        self._check_at, self._question, self._asked_next = 0.0, 0, 0
        #: Packets before this one are repeated, each when the one before was acknowledged; and the number of
        #: acknowledgements of no further packet.
        self._recover_to, self._same_acks = 0, 0
        self._buffer = ReceiveBuffer()
        self._is_paused = self._is_closing = self._has_sent_end = False
        self._ack_at: float | None = None
        self._unacknowledged = 0
        self._last_received, self._asked_at = now, now
        self._suspected_at: float | None = None
        self._open_at, self._open_delay = now, FIRST_OPEN
        self._effects: list[Effect] = []

    # --- events -------------------------------------------------------------------------------------------

    def write(self, data: bytes, now: float) -> list[Effect]:
        """Send bytes; ignored after `close`."""
        if not (self._is_closing or self.is_closed):
            view = memoryview(data)
            self._pending.extend(view[at : at + MAX_SEGMENT] for at in range(0, len(view), MAX_SEGMENT))
            self.pending += len(view)
            self._send_pending(now)
        return self._drain()

    def close(self, now: float) -> list[Effect]:
        """Send the pending data, then the end; `Closed` follows when the peer has acknowledged it."""
        if not (self._is_closing or self.is_closed):
            self._is_closing = True
            self._is_paused = False
            self._read_on()
            self._send_pending(now)
        return self._drain()

    def abort(self) -> list[Effect]:
        """End at once."""
        if not self.is_closed:
            self._send(Kind.RESET)
            self._end("")
        return self._drain()

    def pause(self) -> None:
        """Stop the delivery until `resume`."""
        self._is_paused = not self._is_closing

    def resume(self, now: float) -> list[Effect]:
        """Deliver the data that has arrived since `pause`."""
        if self._is_paused and not self.is_closed:
            self._is_paused = False
            if self._read_on() and not self.is_closed:
                # The peer may wait for this acknowledgement before it sends more.
                self._send(Kind.ACK)
        return self._drain()

    def on_suspicion(self, now: float) -> list[Effect]:
        """The peer seems to have ended: ask it, and close soon without an answer."""
        if not self.is_closed and self._suspected_at is None:
            self._suspected_at = now
            self._ask(now)
        return self._drain()

    def on_packet(self, data: bytes, now: float) -> list[Effect]:
        """A packet of the peer arrived."""
        packet = None if self.is_closed else decode_packet(data)
        if packet is None or not self._is_plausible(packet):
            return self._drain()
        self._last_received, self._suspected_at = now, None
        if packet.kind is Kind.RESET:
            self._end("" if self._is_closing else "the peer has reset the stream")
            return self._drain()
        if packet.kind is Kind.OPEN:
            self._send(Kind.ACCEPT)
            return self._drain()
        if not self.is_open:
            self.is_open = True
            self._effects.append(Opened())
        self._on_acknowledgement(packet, now)
        if packet.kind in (Kind.DATA, Kind.FIN):
            self._on_numbered(packet, now)
        elif packet.kind is Kind.PROBE:
            self._send(Kind.ANSWER, packet.number)
        elif packet.kind is Kind.ANSWER and packet.number == self._question:
            self._on_answer(now)
        self._send_pending(now)
        return self._drain()

    def on_time(self, now: float) -> list[Effect]:
        """`deadline` has passed."""
        if self.is_closed:
            return self._drain()
        if now >= self._silence_end:
            self._end(f"no answer for {now - self._silence_start:.0f} s")
            return self._drain()
        if not self.is_open:
            if now >= self._open_at:
                self._send(Kind.OPEN)
                self._open_at, self._open_delay = now + self._open_delay, min(2 * self._open_delay, LAST_OPEN)
            return self._drain()
        if self._sent and now >= self._check_at:
            self.window.on_silence()
            self._check_at = now + self.window.timeout
            self._ask(now)
        if self._ack_at is not None and now >= self._ack_at:
            self._send(Kind.ACK)
        if now >= self._ask_at:
            self._ask(now)
        return self._drain()

    @property
    def delivery(self) -> Delivery:
        """The data that the peer has acknowledged, in packets."""
        return Delivery(self._acknowledged, bool(self._sent), *self.window.round_trip)

    @property
    def deadline(self) -> float | None:
        """The time when `on_time` is due; None after the end."""
        if self.is_closed:
            return None
        if not self.is_open:
            return min(self._open_at, self._silence_end)
        due = min(self._ask_at, self._silence_end)
        if self._sent:
            due = min(due, self._check_at)
        return due if self._ack_at is None else min(due, self._ack_at)

    # --- time-outs ----------------------------------------------------------------------------------------

    @property
    def _silence_start(self) -> float:
        """The time since when an answer of the peer is missing."""
        return max(self._last_received, self._sent[0].at) if self._sent else self._last_received

    @property
    def _silence_end(self) -> float:
        """The time when silence ends the stream."""
        if self._suspected_at is not None:
            return self._suspected_at + SUSPECTED_SILENCE
        is_answer_due = bool(self._sent) or not self.is_open
        return self._silence_start + (SILENCE if is_answer_due else IDLE + SILENCE)

    @property
    def _ask_at(self) -> float:
        """The time at which to ask the peer for a sign of life, or whether it has read more data."""
        stalled = (
            bool(self._pending) or self._suspected_at is not None or self._last_received < self._asked_at
        )
        return max(self._asked_at, self._last_received) + (STALLED if stalled else IDLE)

    # --- sending ------------------------------------------------------------------------------------------

    def _drain(self) -> list[Effect]:
        effects, self._effects = self._effects, []
        return effects

    def _send(self, kind: Kind, number: int = 0, data: bytes = b"") -> None:
        """Send a packet, with the current acknowledgement."""
        buffer = self._buffer
        self._effects.append(SendPacket(Packet(kind, number, buffer.expected, buffer.unread, data).encode()))
        self._ack_at, self._unacknowledged = None, 0

    def _send_pending(self, now: float) -> None:
        """Send the data that the window admits, and then the end."""
        if self.is_closed or not self.is_open:
            return
        while self._may_send and not self.is_closed:
            self._send_numbered(Kind.DATA, self._next_segment(), now)
        if self._is_closing and not (self._pending or self._has_sent_end or self.is_closed):
            self._has_sent_end = True
            self._send_numbered(Kind.FIN, b"", now)

    @property
    def _may_send(self) -> bool:
        has_space = self.in_flight < self.window.size and len(self._unread_sizes) < MAX_AHEAD
        return has_space and bool(self._pending)

    def _next_segment(self) -> bytes:
        """The data of the next packet: small writes that have waited are joined."""
        parts = [self._pending.popleft()]
        size = len(parts[0])
        while self._pending and size + len(self._pending[0]) <= MAX_SEGMENT:
            parts.append(self._pending.popleft())
            size += len(parts[-1])
        self.pending -= size
        return b"".join(parts)

    def _send_numbered(self, kind: Kind, data: bytes, now: float) -> None:
        if self._next == MAX_NUMBER:
            self._send(Kind.RESET)
            self._end("its numbers are used up")
            return
        if not self._sent:
            self._check_at = now + self.window.timeout
        self._sent.append(_Sent(kind, data, now))
        self._unread_sizes.append(len(data))
        self.in_flight += len(data)
        self._send(kind, self._next, data)
        self._next += 1

    def _ask(self, now: float) -> None:
        """Ask for the packets that have arrived. A packet is repeated only after the answer: on a slow path
        it may be late.
        """
        self._asked_at, self._asked_next = now, self._next
        self._question = (self._question + 1) & MAX_NUMBER
        self._send(Kind.PROBE, self._question)

    def _on_answer(self, now: float) -> None:
        """The answer to the last question arrived: packets that were sent before the question and are not
        acknowledged are lost.
        """
        if self._sent and self._acknowledged < self._asked_next:
            self._recover(self._asked_next, now)
        self._asked_next = 0

    def _recover(self, before: int, now: float) -> None:
        """Repeat the unacknowledged packets before a number, one with each acknowledgement."""
        self._recover_to = before
        self.window.on_loss()
        self._repeat(now)

    def _repeat(self, now: float) -> None:
        """Repeat the first packet that is not acknowledged."""
        first = self._sent[0]
        first.times += 1
        self._check_at = now + self.window.timeout
        self._send(first.kind, self._acknowledged, first.data)

    def _on_acknowledgement(self, packet: Packet, now: float) -> None:
        """Forget acknowledged packets; repeat the next one if it seems lost."""
        count = packet.expected - self._acknowledged
        if count > 0:
            self._forget(count, now)
            self._same_acks = 0
            if self._sent and self._acknowledged < self._recover_to:
                self._repeat(now)
        elif count == 0 and self._sent and packet.kind is Kind.ACK:
            self._same_acks += 1
            if self._same_acks == 3 and self._acknowledged >= self._recover_to:
                self._recover(self._next, now)
        while self._read_by_peer < packet.expected - packet.unread:
            self.in_flight -= self._unread_sizes.popleft()
            self._read_by_peer += 1

    def _forget(self, count: int, now: float) -> None:
        """Remove `count` more packets, which the peer has received."""
        in_flight, size, is_first, is_ended = self.in_flight, 0, True, False
        for _ in range(count):
            last = self._sent.popleft()
            size += len(last.data)
            is_first &= last.times == 1
            is_ended = last.kind is Kind.FIN
        self._acknowledged += count
        self._check_at = now + self.window.timeout
        if is_first:
            # Otherwise the last packet may have waited for the repetition of another one.
            self.window.on_answer(now - last.at, size, in_flight)
        if is_ended:
            self._end("")

    # --- receiving ----------------------------------------------------------------------------------------

    def _is_plausible(self, packet: Packet) -> bool:
        """Whether a packet may be from the peer: it acknowledges only packets that were sent."""
        if packet.kind is Kind.OPEN and self._calls:
            return False
        return packet.expected <= self._next or packet.kind is Kind.RESET

    def _on_numbered(self, packet: Packet, now: float) -> None:
        if self.is_closed:
            return
        arrival = self._buffer.add(packet)
        if arrival is Arrival.EXCESS:
            self._send(Kind.RESET)
            self._end("the peer exceeds the window")
            return
        self._read_on()
        if self.is_closed:
            return
        self._unacknowledged += len(packet.data)
        if arrival is not Arrival.EXPECTED or self._unacknowledged >= ACK_BYTES:
            # The peer has to be informed of a gap, and of a repetition, since the acknowledgement was lost.
            self._send(Kind.ACK)
        elif self._ack_at is None:
            self._ack_at = now + ACK_DELAY

    def _read_on(self) -> bool:
        """Deliver received packets unless paused; returns whether there were any.

        The delivery is one effect, because the owner may pause when it receives the data.
        """
        if self._is_paused or self.is_closed or not self._buffer.unread:
            return False
        parts: list[bytes] = []
        is_ended = False
        while (packet := self._buffer.read()) is not None:
            parts.append(packet.data)
            is_ended = is_ended or packet.kind is Kind.FIN
        if not self._is_closing and (data := b"".join(parts)):
            self._effects.append(Deliver(data))
        if is_ended:
            self._send(Kind.ACK)
            self._end("")
        return True

    def _end(self, reason: str) -> None:
        if not self.is_closed:
            self.is_closed = True
            self._pending.clear()
            self._sent.clear()
            self._buffer.clear()
            self._effects.append(Closed(reason))
