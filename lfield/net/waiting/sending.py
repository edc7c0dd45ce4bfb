"""What a connection has to send, in order, and what passes in front of it.

The kernel and the transport get little at a time (`TCP_NOTSENT_LOWAT` and `HIGH_WATER`), so that an order
to stop waits behind at most that and one piece. A long frame goes out in parts. The length of a part follows
from how fast the connection takes them: on a slow radio a part is short, on a fast network a long one costs
less. Pure: whoever has the connection gives it the time.
"""

from __future__ import annotations

from collections import deque

from lfield.wire.codec import MAX_PART, PART, may_be_parted
from lfield.wire.framing import Buffer, frame

#: So many bytes the transport may have that the kernel does not take.
HIGH_WATER = 2 << 10
#: The length of a part at first, the least and the most, in bytes.
FIRST_PART, LEAST_PART, MOST_PART = 4 << 10, 1 << 10, MAX_PART
#: A part that is taken within so many seconds makes the next one longer, one that takes longer shorter.
QUICK, SLOW = 0.005, 0.05


class Sending:
    """The frames that wait, and the length of the next part."""

    def __init__(self) -> None:
        self._waiting: deque[Buffer] = deque()
        #: The length of the next part.
        self.part = FIRST_PART
        #: The bytes that wait.
        self.size = 0
        #: Since when the connection takes nothing, in seconds; None while it does.
        self._full_since: float | None = None

    @property
    def is_busy(self) -> bool:
        """Whether a frame has to wait."""
        return bool(self._waiting) or self._full_since is not None

    @property
    def is_full(self) -> bool:
        """Whether the connection takes nothing now."""
        return self._full_since is not None

    @property
    def is_due(self) -> bool:
        """Whether `next` is to be called."""
        return bool(self._waiting) and self._full_since is None

    def add(self, data: Buffer) -> None:
        """A whole frame."""
        # What it belongs to may change before it is sent.
        kept = data if isinstance(data, bytes) else bytes(data)
        self._waiting.append(kept)
        self.size += len(kept)

    def next(self) -> Buffer:
        """The bytes to send next; there must be some."""
        data = self._waiting.popleft()
        if len(data) <= self.part or not (isinstance(data, memoryview) or may_be_parted(data)):
            self.size -= len(data)
            # The rest of a frame whose beginning went out in a part goes out in one too.
            return frame(PART, data) if isinstance(data, memoryview) else data
        view = memoryview(data)
        self._waiting.appendleft(view[self.part :])
        self.size -= self.part
        return frame(PART, view[: self.part])

    def rest(self) -> list[Buffer]:
        """All that waits, as `next` gives it."""
        found = []
        while self._waiting:
            found.append(self.next())
        return found

    def taken(self) -> None:
        """The connection has taken what `next` gave, and takes more."""
        self.part = min(MOST_PART, self.part * 2)

    def full(self, now: float) -> None:
        """The connection takes nothing more for now."""
        self._full_since = now

    def free(self, now: float) -> None:
        """It takes something again."""
        took = 0.0 if self._full_since is None else now - self._full_since
        self._full_since = None
        if took > SLOW:
            self.part = max(LEAST_PART, self.part // 2)
        elif took < QUICK:
            self.taken()

    def clear(self) -> None:
        """Lose what waits."""
        self._waiting.clear()
        self.size = 0
