"""The SYNC of a bus: one for all nodes that need it, as long as one does (CiA 301, 7.2.5)."""

from __future__ import annotations

from collections.abc import Callable

from lfield.driver import Clock
from lfield_can.bus.frames import Frame
from lfield_can.timing import Repeating


class Sync:
    """Sent every `period` seconds. Two producers on one bus would have every node answer twice."""

    def __init__(self, clock: Clock, post: Callable[[Frame], None], period: float) -> None:
        self._post, self._period = post, period
        self._wanted: dict[int, int] = {}
        self._repeating = Repeating(clock)

    def want(self, node: int, identifier: int) -> None:
        """A node needs it, by the id of its object 0x1005."""
        idle = not self._wanted
        self._wanted[node] = identifier
        if idle:
            self._repeating.start(self._period, self._send)

    def leave(self, node: int) -> None:
        """It needs it no more, or shall not have it while the bus is quiet."""
        self._wanted.pop(node, None)
        if not self._wanted:
            self._repeating.stop()

    def _send(self) -> None:
        for identifier in set(self._wanted.values()):
            self._post(Frame(identifier))
