"""Send queue of a connection with priorities and adaptive fragmentation. Sans-IO.

Kernel and transport hold little unsent data (`TCP_NOTSENT_LOWAT`, `HIGH_WATER`), so that a stop order waits
behind at most that and one fragment. Long frames are sent in fragments, short ones on a slow radio (low
delay), long ones on a fast network (low overhead). The owner of the connection passes the time.
"""

from __future__ import annotations

from collections import deque

from lfield.wire.codec import MAX_PART, PART, may_be_fragmented
from lfield.wire.framing import Buffer, frame

#: Maximum bytes buffered in the transport.
HIGH_WATER = 2 << 10
#: Fragment length in bytes: initial, minimum, maximum.
INITIAL_PART, MIN_PART, LARGEST_PART = 4 << 10, 1 << 10, MAX_PART
#: A fragment accepted within this many seconds makes the next one longer, otherwise shorter.
FAST_DRAIN, SLOW_DRAIN = 0.005, 0.05


class SendQueue:
    """The waiting frames, and the length of the next fragment."""

    def __init__(self) -> None:
        self._waiting: deque[Buffer] = deque()
        #: The length of the next fragment.
        self.part = INITIAL_PART
        #: Waiting bytes.
        self.size = 0
        #: Since when the connection accepts no data, in seconds; None while it does.
        self._full_since: float | None = None
        #: Whether a frame can be sent at once: none waits, and the connection accepts data.
        self.is_idle = True

    @property
    def is_busy(self) -> bool:
        """Whether a frame must wait."""
        return not self.is_idle

    def _update(self) -> None:
        self.is_idle = not self._waiting and self._full_since is None

    @property
    def is_full(self) -> bool:
        """Whether the connection accepts no data now."""
        return self._full_since is not None

    @property
    def is_due(self) -> bool:
        """Whether `next` is to be called."""
        return bool(self._waiting) and self._full_since is None

    def add(self, data: Buffer) -> None:
        """Queue a whole frame."""
        # Copied, since its buffer may change before it is sent.
        kept = data if isinstance(data, bytes) else bytes(data)
        self._waiting.append(kept)
        self.size += len(kept)
        self.is_idle = False

    def next(self) -> Buffer:
        """The bytes to send next; the queue must not be empty."""
        data = self._waiting.popleft()
        self._update()
        if len(data) <= self.part or not (isinstance(data, memoryview) or may_be_fragmented(data)):
            self.size -= len(data)
            # The rest of a fragmented frame is sent in fragments too.
            return frame(PART, data) if isinstance(data, memoryview) else data
        view = memoryview(data)
        self._waiting.appendleft(view[self.part :])
        self.is_idle = False
        self.size -= self.part
        return frame(PART, view[: self.part])

    def rest(self) -> list[Buffer]:
        """All waiting bytes, in the order of `next`."""
        found = []
        while self._waiting:
            found.append(self.next())
        return found

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
        self.size = 0
        self._update()
