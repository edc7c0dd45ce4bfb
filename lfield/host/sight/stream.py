"""The states that a host has told in this life: numbered without a gap, the newest of them kept. Pure."""

from __future__ import annotations

import msgspec

from lfield.wire.events import Event, State

#: How much is kept for watchers that were away: so many states, and so many bytes of them.
MOST_EVENTS, MOST_BYTES = 32768, 4 << 20

_encode = msgspec.msgpack.Encoder().encode


class Stream:
    """A ring: what is told pushes out the oldest, by number and by bytes as they are sent."""

    def __init__(self, most_events: int = MOST_EVENTS, most_bytes: int = MOST_BYTES) -> None:
        self._most_events, self._most_bytes = most_events, most_bytes
        self._events: dict[int, tuple[Event, int]] = {}
        self._bytes = 0
        #: The number of the newest state, 0 before the first, and of the oldest that is kept, or will be.
        self.latest, self.oldest = 0, 1

    def tell(self, what: State, at: float, up: float, cause: int = 0) -> int:
        """Something has happened, `at` Unix time and `up` seconds after the host began; its number."""
        self.latest = number = self.latest + 1
        event = Event(number, at, up, cause, what)
        size = size_of(event)
        self._events[number] = event, size
        self._bytes += size
        # The newest stays, however large it is.
        while self.oldest < number and (
            self._bytes > self._most_bytes or number - self.oldest >= self._most_events
        ):
            self._bytes -= self._events.pop(self.oldest)[1]
            self.oldest += 1
        return number

    def after(self, number: int, most_events: int, most_bytes: int) -> tuple[list[Event], int]:
        """The states that follow a number, one at least if there is one, and their bytes.

        No more than so many, nor than so many bytes. What comes next after `number` must be kept still.
        """
        found: list[Event] = []
        total = 0
        for following in range(number + 1, min(self.latest, number + most_events) + 1):
            event, size = self._events[following]
            if found and total + size > most_bytes:
                break
            found.append(event)
            total += size
        return found, total


def size_of(event: Event) -> int:
    """The bytes that an event has in a message."""
    return len(_encode(event))
