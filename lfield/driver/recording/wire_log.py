"""The log of one bus: the data that its driver sends and receives while a recording runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from lfield.clock import Clock
from lfield.driver.recording.wire_formats import (
    CANDUMP,
    HEX,
    HEX_HEADER,
    TLOG,
    candump_error,
    candump_line,
    hex_line,
    tlog_entry,
)


class LogRing(Protocol):
    """Files of a log, of which the oldest are deleted (lfield.recording.ring_writer)."""

    @property
    def is_full(self) -> bool:
        """Whether `start_file` should follow."""

    def start_file(self, first: bytes = b"") -> None:
        """Starts the next file."""

    def append(self, data: bytes) -> None:
        """Appends an entry without waiting."""

    def close(self, timeout: float = 2.0) -> None:
        """Writes the pending entries."""


#: Creates the ring of a log with a suffix and the first bytes of each file.
MakeRing = Callable[[str, bytes], LogRing]


class WireLog:
    """The log of one bus; `Driver.wire_log`. No data is logged unless the guard has started the log.

    A driver calls the method of its protocol for all data that it sends and receives. No call waits or
    raises.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._make_ring: MakeRing | None = None
        self._rings: dict[str, LogRing] = {}

    def start(self, make_ring: MakeRing) -> None:
        """Starts the log."""
        self._make_ring = make_ring

    def close(self) -> None:
        """Ends the log; waits for the disk at most one second."""
        self._make_ring = None
        for ring in self._rings.values():
            ring.close(1.0)
        self._rings.clear()

    def log_mavlink(self, packet: bytes) -> None:
        """Logs one MAVLink packet, sent or received, as `.tlog`; messages with keys are omitted."""
        if self._make_ring is not None and (entry := tlog_entry(self._clock.time(), packet)):
            self._append(TLOG, entry)

    def log_can(
        self,
        channel: str,
        identifier: int,
        data: bytes,
        *,
        extended: bool = False,
        fd: bool = False,
        switch: bool = False,
        is_sent: bool = False,
    ) -> None:
        """Logs one CAN frame as `.candump.log`; `channel` has no spaces (`channel_name`)."""
        if self._make_ring is not None:
            now, kind = (
                self._clock.time(),
                {"extended": extended, "fd": fd, "switch": switch, "is_sent": is_sent},
            )
            self._append(CANDUMP, candump_line(now, channel, identifier, data, **kind))

    def log_can_error(self, channel: str, identifier: int, data: bytes) -> None:
        """Logs one error frame of a CAN interface."""
        if self._make_ring is not None:
            self._append(CANDUMP, candump_error(self._clock.time(), channel, identifier, data))

    def log_bytes(self, data: bytes, *, is_sent: bool) -> None:
        """Logs some bytes of a serial line as `.hex.log`."""
        if self._make_ring is not None:
            self._append(HEX, hex_line(self._clock.time(), data, is_sent=is_sent), HEX_HEADER)

    def _append(self, suffix: str, entry: bytes, header: bytes = b"") -> None:
        ring = self._rings.get(suffix)
        if ring is None:
            assert self._make_ring is not None
            ring = self._rings[suffix] = self._make_ring(suffix, header)
            ring.start_file()
        elif ring.is_full:
            ring.start_file()
        ring.append(entry)
