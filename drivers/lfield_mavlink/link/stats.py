"""How good a link is, by the gaps in the sequence numbers of each sender's packets."""

from __future__ import annotations

from collections import deque

#: Seconds that the quality looks back over.
WINDOW = 10.0
#: Packets within so many seconds share an entry, so that a flood costs no memory.
TOGETHER = 0.1
#: The longest gap that is taken for lost packets; a longer one is a sender that has started again.
LONGEST_GAP = 64


class SenderStats:
    """The packets of one sender (system and component), which numbers them 0 to 255 and round again."""

    def __init__(self) -> None:
        self.lost = 0
        self._next: int | None = None
        # Numbers that were passed over; a packet that was only overtaken is taken out again.
        self._missing: deque[int] = deque(maxlen=LONGEST_GAP)
        # [time, received, lost] of the packets in the window.
        self._recent: deque[list[float]] = deque()

    def add(self, sequence: int, now: float) -> None:
        """A packet has come."""
        if sequence == self._next and self._recent and now - self._recent[-1][0] < TOGETHER:
            # Nearly always; a busy link has hundreds a second.
            self._recent[-1][1] += 1
            self._next = (sequence + 1) % 256
            return
        gap = 0 if self._next is None else (sequence - self._next) % 256
        if gap >= 256 - LONGEST_GAP:
            # Of the packets before the last one: it was overtaken, or it comes once more.
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
        """The share of the packets of the last WINDOW seconds that have come, 0 to 1; 0 when none have."""
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
