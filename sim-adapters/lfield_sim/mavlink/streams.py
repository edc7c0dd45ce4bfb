"""Which messages are sent how often, and when the next is due."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

#: Nothing is streamed faster than this, in Hz.
MAX_RATE = 100.0
#: The message that is always sent, at least at 1 Hz.
HEARTBEAT = 0


@dataclass(slots=True)
class _Stream:
    interval: float
    due: float


class Streams:
    """The streams of one vehicle, by message id. Times in seconds, as the caller counts them."""

    def __init__(self, rates: Mapping[int, float], now: float) -> None:
        self._streams: dict[int, _Stream] = {}
        for kind, rate in {HEARTBEAT: 1.0, **rates}.items():
            self.set(kind, rate, now)

    def set(self, kind: int, rate: float, now: float) -> None:
        """Stream a message at a rate in Hz from now on; 0 stops it, but for the heartbeat."""
        if kind == HEARTBEAT:
            rate = max(rate, 1.0)
        if rate <= 0.0:
            self._streams.pop(kind, None)
        else:
            self._streams[kind] = _Stream(1.0 / min(rate, MAX_RATE), now)

    def interval(self, kind: int) -> float:
        """Seconds between two messages of a stream; 0 when it is not streamed."""
        return self._streams[kind].interval if kind in self._streams else 0.0

    def due(self, now: float) -> list[int]:
        """What is to be sent now; after a pause each once, not the whole backlog."""
        due = [kind for kind, stream in self._streams.items() if now >= stream.due]
        for kind in due:
            stream = self._streams[kind]
            stream.due = max(stream.due + stream.interval, now)
        return due
