"""A half-duplex channel that several senders share: the order of transmissions, without a clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Generic, NamedTuple, TypeVar

from emulator.cells import Channel

T = TypeVar("T")


class Transmission(NamedTuple, Generic[T]):
    """The packet of a sender, and its transmission time in s."""

    sender: int
    item: T
    start: float
    end: float


class _Queued(NamedTuple, Generic[T]):
    item: T
    size: int
    offered: float


class SharedChannel(Generic[T]):
    """Senders, by number, send one packet each in turn, as in a token-passing network.

    The times of successive calls must not decrease. Sizes are in bytes.
    """

    def __init__(self, channel: Channel, senders: int) -> None:
        self._channel = channel
        self._queues: list[deque[_Queued[T]]] = [deque() for _ in range(senders)]
        self._sizes = [0] * senders
        self._last = senders - 1
        self._free_at = 0.0

    @property
    def next_event(self) -> float | None:
        """When the next transmission can begin; None when nothing is queued."""
        return self._free_at if any(self._queues) else None

    def offer(self, now: float, sender: int, item: T, size: int) -> bool:
        """Queue a packet; False when the queue of its sender is full."""
        if self._sizes[sender] + size > self._channel.queue:
            return False
        self._queues[sender].append(_Queued(item, size, now))
        self._sizes[sender] += size
        return True

    def pop_started(self, now: float) -> Iterator[Transmission[T]]:
        """The transmissions that have begun by now and were not returned before."""
        while self._free_at <= now and (sender := self._next_sender()) is not None:
            queued = self._queues[sender].popleft()
            self._sizes[sender] -= queued.size
            self._last = sender
            begin = max(self._free_at, queued.offered)
            self._free_at = begin + queued.size * 8 / self._channel.rate
            yield Transmission(sender, queued.item, begin, self._free_at)

    def _next_sender(self) -> int | None:
        """The next sender in turn that has a queued packet."""
        count = len(self._queues)
        order = ((self._last + 1 + step) % count for step in range(count))
        return next((sender for sender in order if self._queues[sender]), None)
