"""Send queue of a connection: priorities and shares by kind of traffic, adaptive fragmentation. Sans-IO.

Frames of one kind keep their order. Stops precede all other frames. Each of the other waiting kinds gets its
share of the data that the connection accepts (start-time fair queueing).

Kernel and transport hold little unsent data (`TCP_NOTSENT_LOWAT`, `HIGH_WATER`), so that a stop order waits
behind at most this data and one fragment. Long frames are sent in fragments, short ones on a slow radio (low
delay), long ones on a fast network (low overhead). Whole frames of other kinds may be sent between two
fragments. The owner of the connection passes the time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from lfield.net.coding.traffic_kinds import TrafficKind
from lfield.wire.codec import COMPRESSED, MAX_PART, PART, may_be_fragmented
from lfield.wire.framing import HEADER_SIZE, Buffer, frame

#: Maximum bytes buffered in the transport.
HIGH_WATER = 2 << 10
#: Fragment length in bytes: initial, minimum, maximum.
INITIAL_PART, MIN_PART, LARGEST_PART = 4 << 10, 1 << 10, MAX_PART
#: A fragment accepted within this many seconds makes the next one longer, otherwise shorter.
FAST_DRAIN, SLOW_DRAIN = 0.005, 0.05
#: Shares of the kinds, relative to one another; a kind without waiting frames leaves its share to the others.
SHARES = {
    TrafficKind.CONTROL: 8,
    TrafficKind.HOP: 8,
    TrafficKind.EVENTS: 2,
    TrafficKind.TELEMETRY: 1,
    TrafficKind.UPDATE: 1,
}

#: Changes a whole frame before it is sent: called in the order of sending.
Coding = Callable[[Buffer, TrafficKind], Buffer]


class SendQueue:
    """The waiting frames, and the length of the next fragment."""

    def __init__(self, code: Coding = lambda data, kind: data) -> None:
        self._code = code
        self._waiting: dict[TrafficKind, deque[Buffer]] = {}
        #: The virtual time, and the time when the next frame of each kind starts.
        self._time, self._starts = 0.0, dict.fromkeys(SHARES, 0.0)
        #: The unsent rest of a frame in fragments, with its kind and whether it is compressed.
        self._remainder, self._remainder_kind, self._is_remainder_compressed = (
            memoryview(b""),
            TrafficKind.HOP,
            False,
        )
        #: The length of the next fragment.
        self.part = INITIAL_PART
        #: The number of waiting bytes.
        self.size = 0
        #: The time since when the connection accepts no data, in seconds; None while it accepts data.
        self._full_since: float | None = None
        #: Whether a frame can be sent at once: no frame waits, and the connection accepts data.
        self.is_idle = True

    @property
    def is_busy(self) -> bool:
        """Whether a frame must wait."""
        return not self.is_idle

    def _update(self) -> None:
        self.is_idle = not self._is_waiting and self._full_since is None

    @property
    def _is_waiting(self) -> bool:
        return bool(self._waiting or self._remainder)

    @property
    def is_full(self) -> bool:
        """Whether the connection accepts no data now."""
        return self._full_since is not None

    @property
    def is_due(self) -> bool:
        """Whether `next` is to be called."""
        return self._is_waiting and self._full_since is None

    def add(self, data: Buffer, kind: TrafficKind) -> None:
        """Queue a whole frame."""
        # The data is copied, since its buffer may change before it is sent.
        copy = data if isinstance(data, bytes) else bytes(data)
        if kind not in self._waiting:
            self._waiting[kind] = deque()
            if kind in SHARES and not (self._remainder and self._remainder_kind == kind):
                self._starts[kind] = max(self._starts[kind], self._time)
        self._waiting[kind].append(copy)
        self.size += len(copy)
        self.is_idle = False

    def next(self) -> Buffer:
        """The bytes to send next; the queue must not be empty."""
        kind = self._next_kind()
        data = self._next_fragment() if kind is None else self._next_frame(kind)
        charged = self._remainder_kind if kind is None else kind
        if charged in SHARES:
            self._time = max(self._time, self._starts[charged])
            self._starts[charged] += len(data) / SHARES[charged]
        self._update()
        return data

    def _next_kind(self) -> TrafficKind | None:
        """The kind of the frame to send next; None for the next fragment."""
        if TrafficKind.STOP in self._waiting:
            return TrafficKind.STOP
        kinds = self._waiting.keys() | ({self._remainder_kind} if self._remainder else set())
        first = min(kinds, key=lambda kind: (self._starts[kind], kind))
        if not self._remainder:
            return first
        # Only one frame at a time is in fragments, and frames of its kind follow it.
        if first == self._remainder_kind or len(self._waiting[first][0]) > self.part:
            return None
        return first

    def _next_frame(self, kind: TrafficKind) -> Buffer:
        """The next frame of a kind, or its first fragment."""
        frames = self._waiting[kind]
        plain = frames.popleft()
        if not frames:
            del self._waiting[kind]
        self.size -= len(plain)
        if self._remainder and self._is_remainder_compressed:
            # The peer expands compressed frames in the order in which they are complete.
            return plain
        data = self._code(plain, kind)
        is_whole = self._remainder or len(data) <= self.part or kind == TrafficKind.STOP
        if is_whole or not may_be_fragmented(data):
            return data
        self._remainder, self._remainder_kind = memoryview(data), kind
        self._is_remainder_compressed = data[HEADER_SIZE - 1] == COMPRESSED
        self.size += len(data)
        return self._next_fragment()

    def _next_fragment(self) -> Buffer:
        fragment, self._remainder = self._remainder[: self.part], self._remainder[self.part :]
        self.size -= len(fragment)
        return frame(PART, fragment)

    def rest(self) -> list[Buffer]:
        """All waiting bytes, in the order of `next`."""
        frames = []
        while self._is_waiting:
            frames.append(self.next())
        return frames

    def on_accepted(self) -> None:
        """The connection has accepted the bytes of `next`, and accepts more."""
        self.part = min(LARGEST_PART, self.part * 2)

    def on_full(self, now: float) -> None:
        """The connection accepts no more data for now."""
        self._full_since = now
        self.is_idle = False

    def on_writable(self, now: float) -> None:
        """The connection accepts data again."""
        took = 0.0 if self._full_since is None else now - self._full_since
        self._full_since = None
        self._update()
        if took > SLOW_DRAIN:
            self.part = max(MIN_PART, self.part // 2)
        elif took < FAST_DRAIN:
            self.on_accepted()

    def clear(self) -> None:
        """Discard all waiting frames."""
        self._waiting.clear()
        self._remainder, self.size = memoryview(b""), 0
        self._update()
