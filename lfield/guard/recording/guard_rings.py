"""The files of a recording that one guard writes: its records, and the log of its wire.

Threads write both; the loop of the guard never waits for them. A disk that is full, too slow or missing ends
each of them with one log line; the guard and its driver are not affected.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from lfield.clock import Clock
from lfield.driver.recording import WireLog
from lfield.guard.messages import OpenDevices
from lfield.guard.recording.guard_recorder import GuardRecorder
from lfield.recording.folders import SUFFIX
from lfield.recording.ring_writer import RingWriter
from lfield.recording.segments import MAGIC
from lfield.text import log_messages

#: The stems of the records and of the log of the wire.
RECORDS, WIRE = "guard", "wire"
#: The share of the records in the limit of a guard; the log of its wire, which grows faster, has the rest.
RECORDS_SHARE = 0.25

#: Writes a line about a device into the log of the host.
WriteNote = Callable[[str, str], None]


def open_recorder(message: OpenDevices, clock: Clock, note: WriteNote) -> GuardRecorder | None:
    """The recorder that a message of the host requires; None without a folder."""
    if not message.recording.folder:
        return None
    folder, limit = Path(message.recording.folder), int(message.recording.limit * RECORDS_SHARE)
    on_failure = failure_reporter(message, RECORDS + SUFFIX, note)
    return GuardRecorder(message, clock, RingWriter(folder, RECORDS, SUFFIX, limit, on_failure, MAGIC))


def start_wire_log(log: WireLog, message: OpenDevices, note: WriteNote) -> None:
    """Starts the log of a driver, if a message of the host requires a recording."""
    if not message.recording.folder:
        return
    folder, limit = Path(message.recording.folder), int(message.recording.limit * (1.0 - RECORDS_SHARE))

    def make_ring(suffix: str, header: bytes) -> RingWriter:
        on_failure = failure_reporter(message, WIRE + suffix, note)
        return RingWriter(folder, WIRE, suffix, limit, on_failure, header)

    log.start(make_ring)


def failure_reporter(message: OpenDevices, files: str, note: WriteNote) -> Callable[[str], None]:
    """A function for any thread that logs why the files of a ring have ended."""
    loop, device = asyncio.get_running_loop(), message.devices[0].name
    folder = Path(message.recording.folder).name

    def report(reason: str) -> None:
        with suppress(RuntimeError):  # the loop has ended
            line = log_messages.RECORDING_ENDED.line(files=f"{folder}/{files}", reason=reason)
            loop.call_soon_threadsafe(note, device, line)

    return report
