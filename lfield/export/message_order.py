"""Orders the messages of a running team by their times: a bounded reorder buffer. Pure.

The events of a team arrive in the order of their causes (`event_timeline`). Two hybrid timestamps can be in
the other order: a step of a hop is reported later than it happened, and a host that was unreachable reports
its events when it is back. Readers of MCAP expect log times that never decrease.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from lfield.clock import Clock
from lfield.export.channels import ChannelMessage
from lfield.hybrid_clock import MAX_AHEAD

#: Seconds for which a message waits for earlier ones.
WINDOW = 1.0
#: The most messages that wait.
MAX_WAITING = 10_000


class _Waiting(NamedTuple):
    """A message in the order of its log time and `number`; `received` is monotonic."""

    time: float
    number: int
    received: float
    message: ChannelMessage


class MessageOrder:
    """Messages in any order in, messages by log time out.

    The log time is the time of the message, with two exceptions. A message that is later than WINDOW gets the
    log time of the one before it. One that is further ahead than hybrid clocks follow, as of a host whose
    clock was never set, gets the present time: otherwise all later ones would get that of the future.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._waiting: list[_Waiting] = []
        self._number, self._last = 0, 0.0
        #: Seconds by which the times of messages are ahead of the monotonic clock here.
        self._offset = 0.0

    @property
    def is_full(self) -> bool:
        """Whether `drain` must follow."""
        return len(self._waiting) > MAX_WAITING

    def add(self, message: ChannelMessage) -> None:
        """Add a message that has arrived."""
        now, time = self._clock.monotonic(), message.time
        # The wall clock here may be wrong as well.
        present = max(self._clock.time(), now + self._offset)
        if time > present + MAX_AHEAD and self._number:
            time = present
        self._offset = max(self._offset, time - now)
        self._number += 1
        self._waiting.append(_Waiting(time, self._number, now, message))

    def drain(self, *, everything: bool = False) -> Iterator[tuple[ChannelMessage, float]]:
        """The messages that need not wait any longer and those before them, each with its log time in seconds
        since 1970."""
        self._waiting.sort()
        due = self._clock.monotonic() - WINDOW
        # A full buffer is halved.
        full = MAX_WAITING // 2 if self.is_full else len(self._waiting)
        last_due = max((n for n, each in enumerate(self._waiting) if each.received <= due), default=-1)
        count = len(self._waiting) if everything else max(last_due + 1, len(self._waiting) - full)
        drained, self._waiting = self._waiting[:count], self._waiting[count:]
        for each in drained:
            self._last = max(self._last, each.time)
            yield each.message, self._last
