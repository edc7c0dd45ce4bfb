"""Message framing shared by all links: encodes and decodes messages, and closes a link on protocol errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.authority.identity import ANONYMOUS
from lfield.errors import AddressError, HandshakeError, WireError
from lfield.event_loop import report_exception
from lfield.net.coding.link_compression import LinkCompression
from lfield.net.coding.traffic_kinds import STOP_MESSAGES, TrafficBytes, TrafficKind, kind_of
from lfield.net.coding.transfer_history import FAST_PATH, MissingReference, TransferHistory
from lfield.net.scheduling.cpu_budgets import PROOF_WEIGHT
from lfield.wire.codec import (
    COMPRESSED,
    CONTROL,
    MAX_TRANSFER_HEADER,
    PART,
    TRANSFER,
    TRANSFER_DELTA,
    compress_frame,
    decode,
    decode_compressed,
    decode_transfer,
    encode,
    encode_transfer,
    frame_decoder,
    limits,
    part_limits,
    transfer_header,
)
from lfield.wire.framing import HEADER_SIZE, frame
from lfield.wire.messages import (
    Backpressure,
    DirectoryUpdate,
    GossipUpdate,
    HandshakeRefused,
    Ping,
    Pong,
    RevocationUpdate,
    WholeTransferRequest,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lfield.authority.identity import Identity
    from lfield.errors import LfieldError
    from lfield.net.health.traffic import Delivery, TcpCounts
    from lfield.net.transport import LinkHandler
    from lfield.wire.coordinator_messages import Transfer
    from lfield.wire.framing import Buffer
    from lfield.wire.messages import Message, Role

#: Bytes of a message that count as one more message (`FramedLink.weight`).
_HEAVY = 1 << 11

#: More oversized bytes than this factor times the limit prove that the peer does not wait for answers.
_OVERSIZE_FACTOR = 16
#: Messages sent before queued data: stops; and heartbeats, so that a busy link does not seem silent.
_URGENT = (*STOP_MESSAGES, Ping, Pong)
#: Messages that are never withheld: they cause no transfer of a coordinator, and some of them stop robots.
_NEVER_WITHHELD = (*_URGENT, HandshakeRefused)
#: Messages that hosts without common work send regularly.
_BACKGROUND = (Ping, Pong, DirectoryUpdate, GossipUpdate, Backpressure, RevocationUpdate)


class FramedLink:
    """A link over a byte stream; a transport provides `write` and `close`.

    The transport sets `handler` before the first bytes arrive, and passes bytes to `received` and the end of
    the stream to `on_eof`.
    """

    handler: LinkHandler

    def __init__(self, peer: str, max_block: int) -> None:
        self.peer = peer
        self.identity: Identity = ANONYMOUS
        self.closed = self.is_answered = False
        #: The data withheld while coordinators and answers are withheld, else None; since then, the weight of
        #: the messages that arrived, and their coordinators.
        self._withheld: list[tuple[Buffer, TrafficKind]] | None = None
        self._weight, self._withheld_weight = 0, set[str]()
        #: See `Link.work` and `Link.traffic`.
        self.work, self.traffic = 0, TrafficBytes()
        self._error: LfieldError | None = None
        self._max_block = max_block
        self._history = TransferHistory()
        #: The compression, created for the first compressed message because it takes 50 kB.
        self._compression: LinkCompression | None = None
        #: Whether the peer is known to support compressed messages; the maximum length of these messages.
        self._may_compress, self._longest = False, 0
        #: Whether the peer is on this computer, and whether sending bytes takes less time than coding them.
        self._is_local = self._is_fast = False
        self._decoder = frame_decoder(self._oversize)
        #: Decoder of a frame that arrives in parts.
        self._parts = frame_decoder(self._oversize)

    def write(self, data: Buffer) -> None:
        """Write raw bytes. Only this class, transports, and tests of malformed bytes call it."""
        raise NotImplementedError

    def write_frame(self, data: Buffer, kind: TrafficKind) -> None:
        """Write a frame, or queue it by its kind; a queue passes it to `coded` when it is due."""
        self.write(self.coded(data, kind))

    def write_now(self, data: Buffer) -> None:
        """Write a coordinator immediately if no frame waits; same as `write` in transports without a
        queue.
        """
        self.write(data)

    def write_urgent(self, data: Buffer) -> None:
        """Write a frame before all queued data; same as `write` in transports without a queue."""
        self.write(data)

    def coded(self, data: Buffer, kind: TrafficKind) -> Buffer:
        """A frame in its form for sending: messages are compressed unless this is too slow, stops never.
        Called in the order of sending.
        """
        if self._is_fast or not self._may_compress or kind == TrafficKind.STOP:
            return data
        if data[HEADER_SIZE - 1] != CONTROL:
            return data
        self._compression = self._compression or LinkCompression()
        compressed = compress_frame(data, self._compression.encode)
        self.traffic.add(kind, len(compressed) - len(data))
        return compressed

    def close(self) -> None:
        """Send queued data, then close; sets `closed`."""
        raise NotImplementedError

    def abort(self) -> None:
        """Close and discard queued data; sets `closed`."""
        raise NotImplementedError

    def accept_role(self, role: Role) -> None:
        """See `Link.accept_role`."""
        accepted = limits(role, self._max_block)
        self._may_compress, self._longest = True, accepted[CONTROL]
        self._decoder.set_limits(accepted)
        self._parts.set_limits(part_limits(role, self._max_block))

    def set_round_trip(self, round_trip: float) -> None:
        """See `Link.set_round_trip`."""
        self._is_fast = self._is_local or round_trip <= FAST_PATH

    def mark_local(self) -> None:
        """The peer is on this computer: transfers are sent whole and not kept. Either both ends call this
        method, or neither.
        """
        self._is_local = self._is_fast = True

    def on_idle(self) -> None:
        """See `Link.on_idle`: no effect without a socket."""

    def count_in(self, traffic: TrafficBytes) -> None:
        """See `Link.count_in`."""
        self.traffic = TrafficBytes(traffic)

    def counts(self) -> TcpCounts | None:
        """See `Link.counts`."""
        return None

    def delivery(self) -> Delivery | None:
        """See `Link.delivery`."""
        return None

    def set_handler(self, handler: LinkHandler) -> None:
        """See `Link.set_handler`."""
        self.handler = handler

    def send(self, message: Message) -> None:
        """Queue a message, before queued data if urgent. Raises AddressError on a closed link."""
        self._require_open()
        self.work += not isinstance(message, _BACKGROUND)
        data, kind = encode(message), kind_of(message)
        self.traffic.add(kind, len(data))
        if isinstance(message, _URGENT):
            self.write_urgent(data)
        elif self._withheld is None or isinstance(message, _NEVER_WITHHELD):
            self.write_frame(data, kind)
        else:
            self._withheld.append((data, kind))

    def send_transfer(self, header: Transfer, block: Buffer) -> None:
        """Send a coordinator immediately. Raises AddressError on a closed link."""
        if self.closed:
            self._require_open()
        self.work += 1
        data = b"".join((encode_transfer(header, block), block))
        if not self._is_local:
            data = self._history.encode(header.agent, data, is_fast=self._is_fast)
        self.traffic.counts[TrafficKind.HOP] += len(data)
        if self._withheld is not None:
            self._withheld.append((data, TrafficKind.HOP))
        else:
            self.write_now(data)

    def received(self, data: Buffer) -> None:
        """Decode bytes and deliver completed messages; close on a protocol error."""
        frame = self._decoder.decode_single_frame(data)
        try:
            for kind, payload in self._decoder.feed(data) if frame is None else (frame,):
                if kind == PART:
                    self._on_part(payload)
                else:
                    self._on_frame(kind, payload)
                if self.closed:
                    break
        except Exception as error:
            self._on_error(error)

    def receive_frame(self, data: Buffer) -> bool:
        """Process these bytes if they are exactly one frame; otherwise without effect."""
        if self.closed or (frame := self._decoder.decode_single_frame(data)) is None:
            return False
        kind, payload = frame
        try:
            if kind == PART:
                self._on_part(payload)
            else:
                self._on_frame(kind, payload)
        except Exception as error:
            self._on_error(error)
        return True

    def _on_error(self, error: Exception) -> None:
        """Close the link: the peer violated the protocol, or its message exposed a bug."""
        if isinstance(error, WireError | HandshakeError):
            self._error = error
            self.close()
        else:
            self.close()
            report_exception(error)

    def _on_part(self, data: memoryview) -> None:
        if self._parts.next_frame_length(data) < len(data):
            raise WireError("a part has bytes of two frames")
        for kind, payload in self._parts.feed(data):
            self._on_frame(kind, payload)

    def _on_frame(self, kind: int, payload: memoryview) -> None:
        if kind in (TRANSFER, TRANSFER_DELTA):
            self.traffic.counts[TrafficKind.HOP] += HEADER_SIZE + len(payload)
        if kind == TRANSFER:
            # Copied: the payload may be a small part of a large buffer.
            self._on_transfer(bytes(payload))
        elif kind == TRANSFER_DELTA:
            self._on_delta(payload)
        else:
            if self._withheld is not None:
                self._weight += 1 + len(payload) // _HEAVY
            if kind == COMPRESSED:
                message: Message = decode_compressed(payload, self._expand)
            else:
                message = decode(kind, payload)
            self.work += not isinstance(message, _BACKGROUND)
            self.traffic.add(kind_of(message), HEADER_SIZE + len(payload))
            if isinstance(message, WholeTransferRequest):
                self._resend(message.agent)
            else:
                self.handler.on_message(self, message)

    def _expand(self, payload: Buffer) -> bytes:
        self._compression = self._compression or LinkCompression()
        return self._compression.decode(payload, self._longest)

    def _on_transfer(self, payload: bytes) -> None:
        header, block = decode_transfer(payload)
        self.work += 1
        if self._withheld is not None:
            self._weigh(header.agent)
        if not self._is_local:
            # This call precedes that of the handler, which may send the coordinator back.
            self._history.keep(header.agent, payload, is_sent=False)
        self.handler.on_transfer(self, header, block)

    def _on_delta(self, payload: memoryview) -> None:
        delta = self._history.decode(payload)
        if isinstance(delta, MissingReference):
            if self._withheld is not None:
                self._weigh(delta.agent)
            self.send(WholeTransferRequest(delta.agent))
        elif delta.size > self._max_block + MAX_TRANSFER_HEADER:
            header = transfer_header(delta.leading_bytes(), delta.size)
            self._oversize(header, header.size)
        else:
            self._on_transfer(delta.expand())

    def _resend(self, agent: str) -> None:
        """Send the last transfer of a coordinator whole; the peer has no reference for its delta."""
        payload = self._history.whole(agent)
        if payload is None:
            # Another transfer has replaced this one. The next link starts with queries about both.
            raise WireError(f"a whole transfer of {agent} was requested, and none was sent last")
        data = frame(TRANSFER, payload)
        if self._withheld is not None:
            self._withheld.append((data, TrafficKind.HOP))
        else:
            self.write_frame(data, TrafficKind.HOP)

    def withhold(self, *, on: bool) -> None:
        """Withhold coordinators and answers from now on, or send the withheld ones.

        Withheld messages are lost if the link is lost, like data in a socket.
        """
        waiting, self._withheld = self._withheld, [] if on else None
        if on:
            self._weight, self._withheld_weight = 0, set()
            self._decoder.reset_skipped()
            self._parts.reset_skipped()
        for data, kind in waiting or ():
            self.write_frame(data, kind)

    @property
    def weight(self) -> int:
        """The amount of data that has arrived since answers are withheld, in messages; 0 while they are not.

        A transfer counts as one message, a message as one and one more per _HEAVY bytes. A host repeats a
        coordinator only after an answer, so a second transfer of it is proof of flooding (PROVEN), as is an
        amount of oversized blocks that no host sends before an answer.
        """
        skipped = self._decoder.skipped + self._parts.skipped
        return self._weight + PROOF_WEIGHT * skipped // (_OVERSIZE_FACTOR * self._max_block)

    def _weigh(self, agent: str) -> None:
        self._weight += PROOF_WEIGHT if agent in self._withheld_weight else 1
        self._withheld_weight.add(agent)

    def deliver_pending(self, data: Buffer) -> Iterator[None]:
        """As `received`, for a sender of possibly thousands of messages: each step processes at most one
        message.
        """
        remaining = memoryview(data)
        while True:
            yield
            if self.closed:
                return
            size = self._decoder.next_frame_length(remaining)
            self.received(remaining[:size])
            remaining = remaining[size:]
            if not remaining:
                return

    def on_eof(self, error: LfieldError | None) -> None:
        """The stream has ended; the first known reason is reported."""
        is_cut = not self.closed and (self._decoder.is_mid_frame or self._parts.is_mid_frame)
        self.closed = True
        # Release the buffers now, not at garbage collection: unauthenticated links must not accumulate.
        self._decoder.discard_partial()
        self._parts.discard_partial()
        if self._error is None and error is None and is_cut:
            error = WireError("peer closed the link in the middle of a message")
        self.handler.on_closed(self, self._error or error)

    def _oversize(self, header: Transfer, size: int) -> None:
        if self._withheld is not None:
            self._weigh(header.agent)
        self.handler.on_oversize(self, header, size)

    def _require_open(self) -> None:
        if self.closed:
            raise AddressError(self.peer, "the link to it is closed")
