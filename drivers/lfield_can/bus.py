"""The bus of a driver: frames in and out on the loop, opened again by itself after it was lost."""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress

import can

from lfield.errors import DeviceError
from lfield_can.connection import Connection
from lfield_can.endpoint import parse_endpoint
from lfield_can.frames import BUS_OFF, Frame, error_words

#: Seconds to the first try to open a lost bus again, and the longest between two tries.
FIRST_RETRY, LAST_RETRY = 0.2, 2.0
#: Frames that may wait for the loop; when it is late by more, the oldest are dropped.
INBOX = 10_000
#: Seconds between two notes about error frames.
QUIET_TIME = 10.0


class Bus:
    """One CAN bus. `on_frame` gets every data frame, `note` a sentence for the log."""

    def __init__(self, endpoint: str, on_frame: Callable[[Frame], None], note: Callable[[str], None]) -> None:
        self.errors = 0
        self._place = parse_endpoint(endpoint)
        self._on_frame, self._note = on_frame, note
        self._connection: Connection | None = None
        self._inbox: deque[can.Message] = deque(maxlen=INBOX)
        self._woken = threading.Event()
        self._reopening: asyncio.Task[None] | None = None
        self._told = -QUIET_TIME
        self._errors_told = 0

    async def open(self) -> None:
        """Open the bus, now. Raises DeviceError when that is impossible here."""
        self._loop = asyncio.get_running_loop()
        self._connection = await asyncio.to_thread(
            Connection, self._place, self._received, self._lost_in_thread
        )

    async def close(self) -> None:
        """Give the bus back."""
        if self._reopening is not None:
            self._reopening.cancel()
        connection, self._connection = self._connection, None
        if connection is not None:
            await asyncio.to_thread(connection.close)

    async def send(self, frame: Frame) -> None:
        """Send a frame, and know that the interface has taken it. Raises DeviceError."""
        if self._connection is None:
            raise self._error("the bus is lost", timeout=True)
        reason = await asyncio.wrap_future(self._connection.send(_message(frame)))
        if reason:
            raise self._error(f"a frame could not be sent: {reason}")

    def post(self, frame: Frame) -> None:
        """Send a frame, or not: for what is repeated anyway, or answered. From any thread; never waits."""
        connection = self._connection
        if connection is not None:
            connection.send(_message(frame))

    @property
    def malformed(self) -> int:
        """How much of what came in was no frame at all, since the bus was last opened."""
        return self._connection.malformed if self._connection is not None else 0

    def _error(self, reason: str, *, timeout: bool = False) -> DeviceError:
        kind = "DeviceTimeoutException" if timeout else "DeviceException"
        return DeviceError("bus", f"{self._place.text}: {reason}", kind=kind)

    # -- what comes in ----------------------------------------------------------------------------------

    def _received(self, message: can.Message) -> None:
        """In the reading thread: wakes the loop once for all that came meanwhile."""
        self._inbox.append(message)
        if not self._woken.is_set():
            self._woken.set()
            self._in_loop(self._drain)

    def _in_loop(self, callback: Callable[..., None], *arguments: object) -> None:
        with suppress(RuntimeError):  # the loop has ended, and with it whoever would listen
            self._loop.call_soon_threadsafe(callback, *arguments)

    def _drain(self) -> None:
        # Cleared first: a frame that comes while this runs wakes the loop again.
        self._woken.clear()
        for _ in range(len(self._inbox)):
            message = self._inbox.popleft()
            if message.is_error_frame:
                self._on_error(message)
            elif not message.is_remote_frame:
                self._on_frame(_frame(message))

    def _on_error(self, message: can.Message) -> None:
        self.errors += 1
        words = error_words(message.arbitration_id, bytes(message.data))
        if message.arbitration_id & BUS_OFF or (self._connection is not None and self._connection.off):
            self._lost(words)
        elif self._loop.time() - self._told >= QUIET_TIME:
            count = self.errors - self._errors_told
            self._told, self._errors_told = self._loop.time(), self.errors
            self._note(f"{count} error frame{'s' if count > 1 else ''} on {self._place.text}: {words}")

    # -- lost and found ---------------------------------------------------------------------------------

    def _lost_in_thread(self, reason: str) -> None:
        self._in_loop(self._lost, reason)

    def _lost(self, reason: str) -> None:
        connection, self._connection = self._connection, None
        if connection is None:
            return
        self._note(f"{self._place.text} is lost: {reason}")
        self._reopening = self._loop.create_task(self._reopen(connection))

    async def _reopen(self, broken: Connection) -> None:
        """Close what is broken, then try until it works."""
        await asyncio.to_thread(broken.close)
        pause = FIRST_RETRY
        while self._connection is None:
            await asyncio.sleep(pause)
            pause = min(2.0 * pause, LAST_RETRY)
            try:
                await self.open()
            except DeviceError:
                continue
        self._note(f"{self._place.text} is open again")


def _message(frame: Frame) -> can.Message:
    return can.Message(
        arbitration_id=frame.id, data=frame.data, is_extended_id=frame.extended, is_fd=frame.fd
    )


def _frame(message: can.Message) -> Frame:
    return Frame(message.arbitration_id, bytes(message.data), message.is_extended_id, message.is_fd)
