"""The recording of live events in an MCAP file, for `lfield events --mcap`. Its log times never decrease."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lfield.cli.output_files import RecordingFile
from lfield.clock import Clock, SystemClock
from lfield.export.export_input import NO_INFO, MissionInfo, StreamItem, StreamNotice
from lfield.export.mcap_writer import END_WITHOUT_SUMMARY, McapRecording, require_mcap
from lfield.export.message_order import MessageOrder
from lfield.operator.dashboard.event_feed import FeedNotice
from lfield.operator.dashboard.timeline.event_timeline import DatedEvent

#: Seconds between two flushes: so much is lost when the process is killed, and the window of `MessageOrder`.
FLUSH_INTERVAL = 1.0


class EventRecording:
    """Events in the order of arrival, in an MCAP file. Methods raise OutputFileError."""

    def __init__(self, path: Path, info: MissionInfo = NO_INFO, clock: Clock | None = None) -> None:
        """Creates the file. Raises PluginError without the package `mcap`."""
        require_mcap()
        self._clock = clock or SystemClock()
        self._order = MessageOrder(self._clock)
        self._path, self._file = path, RecordingFile(path, END_WITHOUT_SUMMARY)
        self._mcap = McapRecording(info, self._file)
        self._mcap.flush()
        self._newest = 0.0

    def add(self, item: DatedEvent | FeedNotice) -> None:
        """Add the next event, or a notice about a host."""
        if isinstance(item, FeedNotice):
            # Events before it may still be held back.
            self._add(StreamNotice(self._newest or self._clock.time(), item.host, item.text))
        else:
            self._newest = max(self._newest, item.time)
            self._add(item)

    def _add(self, item: StreamItem) -> None:
        for message in self._mcap.messages_of(item):
            self._order.add(message)
        if self._order.is_full:
            self._write()

    def _write(self, *, everything: bool = False) -> None:
        for message, log_time in self._order.drain(everything=everything):
            self._mcap.add_message(message, log_time)

    def flush(self) -> None:
        """Write the events that wait for no other event."""
        self._write()
        self._mcap.flush()

    async def flush_regularly(self) -> None:
        """Flush until cancelled."""
        while True:
            await asyncio.sleep(FLUSH_INTERVAL)
            self.flush()

    def finish(self) -> str:
        """Complete the file; returns what it contains."""
        self._write(everything=True)
        self._mcap.finish()
        self._file.finish()
        recorded = self._mcap
        dropped = f"; {recorded.dropped} messages left out: too many channels" if recorded.dropped else ""
        return (
            f"{self._path}: {recorded.messages} messages in {recorded.channels} channels, "
            f"{recorded.size} bytes{dropped}"
        )

    def close(self) -> None:
        """Close the file."""
        self._file.close()


@contextmanager
def event_recording(path: Path | None, info: MissionInfo) -> Iterator[EventRecording | None]:
    """A recording that is complete at the end of the body, also when that was interrupted; None without a
    path.

    The contents are printed to stderr.
    """
    if path is None:
        yield None
        return
    recording = EventRecording(path, info)
    try:
        try:
            yield recording
        finally:
            # After an error of the file itself this fails again, with the same error.
            print(recording.finish(), file=sys.stderr, flush=True)
    finally:
        recording.close()
