"""Link quality from gaps in the sequence numbers of each sender."""

from __future__ import annotations

from collections import deque

#: Averaging window in seconds.
WINDOW = 10.0
#: Packets within this many seconds share an entry, which bounds memory.
TOGETHER = 0.1
#: The longest gap that counts as loss; a longer one is a restarted sender.
LONGEST_GAP = 64


class SenderStats:
    """Statistics of one sender (system and component) with sequence numbers 0 to 255."""

    def __init__(self) -> None:
        self.lost = 0
        self._next: int | None = None
        # Skipped numbers; a reordered packet is removed again.
        self._missing: deque[int] = deque(maxlen=LONGEST_GAP)
        # [time, received, lost] of the packets in the window.
        self._recent: deque[list[float]] = deque()

    def add(self, sequence: int, now: float) -> None:
        """Counts a packet that has arrived."""
        if sequence == self._next and self._recent and now - self._recent[-1][0] < TOGETHER:
            # The common case; a busy link has hundreds of packets a second.
            self._recent[-1][1] += 1
            self._next = (sequence + 1) % 256
            return
        gap = 0 if self._next is None else (sequence - self._next) % 256
        if gap >= 256 - LONGEST_GAP:
            # An earlier packet: reordered or repeated.
            if sequence in self._missing:
                self._missing.remove(sequence)
                self._note(now, 1, -1)
            return
        if gap > LONGEST_GAP:
            gap = 0
            self._missing.clear()
        self._missing.extend((sequence - back) % 256 for back in range(gap, 0, -1))
        self._next = (sequence + 1) % 256
        self._note(now, 1, gap)

    def quality(self, now: float) -> float:
        """The share of received packets in the last WINDOW seconds, 0 to 1; 0 without packets."""
        self._forget(now)
        received = sum(count for _, count, _ in self._recent)
        lost = max(sum(count for _, _, count in self._recent), 0)
        return received / (received + lost) if received else 0.0

    def _note(self, now: float, received: int, lost: int) -> None:
        self.lost += lost
        self._forget(now)
        if self._recent and now - self._recent[-1][0] < TOGETHER:
            self._recent[-1][1] += received
            self._recent[-1][2] += lost
        else:
            self._recent.append([now, received, lost])

    def _forget(self, now: float) -> None:
        while self._recent and now - self._recent[0][0] > WINDOW:
            self._recent.popleft()
