"""One open interface of python-can, with a thread that reads and one that writes: the loop never waits."""

from __future__ import annotations

import asyncio
import fcntl
import logging
import os
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import can

from lfield.driver import DeviceError
from lfield_can.bus.endpoint import Place
from lfield_can.bus.frames import GONE, Frame, Listener

#: Seconds that one look for a frame lasts; also how soon a closed connection is noticed.
WAIT = 0.2
#: A frame that could not leave within so many seconds is dropped: a late command is worse than none.
FRESH = 0.05
#: Seconds between two tries while the send buffer is full.
AGAIN = 0.002
#: Frames that may wait to be sent.
BACKLOG = 256
#: Frames that may wait for the loop; when it is late by more, the oldest are dropped.
INBOX = 10_000
#: Bytes of one line of an adapter; a frame of CAN FD takes 140.
LONGEST_LINE = 4096

# They log every trouble with a traceback; ours is told in sentences by the driver's notes.
for _library in ("can", "canopen", "cantools"):
    logging.getLogger(_library).setLevel(logging.CRITICAL + 1)


@dataclass(frozen=True, slots=True)
class Job:
    """A frame to send until a time; `sent` gets '' or the reason why it was not."""

    message: can.Message
    until: float
    sent: Future[str]


async def open_connection(place: Place, listener: Listener) -> Connection:
    """Open an endpoint. Raises DeviceError."""
    return await asyncio.to_thread(Connection, place, listener, asyncio.get_running_loop())


def _opened(place: Place) -> can.BusABC:
    """Open an interface now; blocks for a moment. Raises DeviceError."""
    arguments: dict[str, Any] = dict(place.arguments)
    try:
        return can.Bus(ignore_config=True, **arguments)
    except Exception as error:  # every interface raises its own kinds, and some none of python-can's
        raise DeviceError("endpoint", f"cannot open {place.text}: {_words(error)}") from None


def lock_tty(path: str) -> int:
    """Become the only owner of a serial port; the descriptor that holds the lock. Raises DeviceError."""
    try:
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise DeviceError("endpoint", f"cannot open {path}: {_words(error)}") from None
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(fd)
        raise DeviceError(
            "endpoint", f"{path} is in use by another program; a serial port has one owner"
        ) from None
    return fd


class Connection:
    """An open interface of python-can."""

    def __init__(self, place: Place, listener: Listener, loop: asyncio.AbstractEventLoop) -> None:
        self.malformed = 0
        self._listener, self._loop = listener, loop
        self._inbox: deque[can.Message] = deque(maxlen=INBOX)
        self._woken = threading.Event()
        self._closing = threading.Event()
        self._jobs: queue.Queue[Job | None] = queue.Queue(BACKLOG)
        self._lock = lock_tty(place.tty) if place.tty else None
        try:
            self._bus = _opened(place)
        except DeviceError:
            self._unlock()
            raise
        for work, name in ((self._read, "can-read"), (self._write, "can-write")):
            threading.Thread(target=work, name=name, daemon=True).start()

    async def send(self, frame: Frame) -> str:
        """Have a frame sent; '' once it is, or why it was not."""
        return await asyncio.wrap_future(self._queued(frame))

    def post(self, frame: Frame) -> None:
        """Have a frame sent, or not; never waits."""
        self._queued(frame)

    def _queued(self, frame: Frame) -> Future[str]:
        job = Job(_message(frame), time.monotonic() + FRESH, Future())
        if self._closing.is_set():
            job.sent.set_result(GONE)
            return job.sent
        try:
            self._jobs.put_nowait(job)
        except queue.Full:
            job.sent.set_result("too many frames wait to be sent")
        return job.sent

    @property
    def off(self) -> bool:
        """Whether the interface itself says that its controller is off the bus."""
        try:
            return bool(self._bus.state is can.BusState.ERROR)
        except Exception:  # many interfaces cannot tell
            return False

    async def close(self) -> None:
        """Give the interface back."""
        await asyncio.to_thread(self._shut)

    def _shut(self) -> None:
        self._closing.set()
        with suppress(queue.Full):  # then the writer is awake, and looks at _closing
            self._jobs.put_nowait(None)
        with suppress(Exception):  # it may be gone already
            self._bus.shutdown()
        self._unlock()

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    # -- the reading thread -----------------------------------------------------------------------------

    def _read(self) -> None:
        while not self._closing.is_set():
            try:
                # Not `recv`: what makes no sense is an empty look too, and counts here.
                message, _ = self._bus._recv_internal(WAIT)
            except (ValueError, IndexError, KeyError):
                self.malformed += 1
                continue
            except Exception as error:  # OSError, CanError, SerialException, TypeError of a closed port
                self._fail(_words(error))
                return
            if message is not None:
                self._received(message)
            # slcan keeps what has no end of line, however long it gets.
            elif len(getattr(self._bus, "_buffer", b"")) > LONGEST_LINE:
                self._fail("what comes in are no frames")
                return

    def _received(self, message: can.Message) -> None:
        """Wake the loop, once for all that comes until it is awake."""
        self._inbox.append(message)
        if not self._woken.is_set():
            self._woken.set()
            self._in_loop(self._drain)

    def _fail(self, reason: str) -> None:
        if not self._closing.is_set():
            self._closing.set()
            self._in_loop(self._listener.lost, reason)

    def _in_loop(self, callback: Callable[..., None], *arguments: object) -> None:
        with suppress(RuntimeError):  # the loop has ended, and with it whoever would listen
            self._loop.call_soon_threadsafe(callback, *arguments)

    def _drain(self) -> None:
        """On the loop."""
        # Cleared first: a frame that comes while this runs wakes the loop again.
        self._woken.clear()
        for _ in range(len(self._inbox)):
            message = self._inbox.popleft()
            if message.is_error_frame:
                self._listener.error(message.arbitration_id, bytes(message.data))
            elif not message.is_remote_frame:
                self._listener.frame(_frame(message))

    # -- the writing thread -----------------------------------------------------------------------------

    def _write(self) -> None:
        while not self._closing.is_set() and (job := self._jobs.get()) is not None:
            job.sent.set_result(self._sent(job))
        # Whoever still waits is told; later ones find no connection.
        with suppress(queue.Empty):
            while True:
                if (job := self._jobs.get_nowait()) is not None:
                    job.sent.set_result(GONE)

    def _sent(self, job: Job) -> str:
        reason = "it waited for too long"
        while not self._closing.is_set():
            left = job.until - time.monotonic()
            if left <= 0.0:
                return reason
            try:
                self._bus.send(job.message, timeout=left)
                return ""
            except can.CanError as error:
                # Mostly a full buffer. Where the interface is broken, the reader finds out.
                reason = _words(error)
                time.sleep(AGAIN)
            except Exception as error:
                self._fail(_words(error))
                return _words(error)
        return GONE


def _words(error: Exception) -> str:
    """An exception as the end of a sentence; the first line of it, since some carry a traceback."""
    text = (getattr(error, "strerror", None) or str(error) or repr(error)).strip()
    return text.splitlines()[0][:200]


def _message(frame: Frame) -> can.Message:
    return can.Message(
        arbitration_id=frame.id, data=frame.data, is_extended_id=frame.extended, is_fd=frame.fd
    )


def _frame(message: can.Message) -> Frame:
    return Frame(message.arbitration_id, bytes(message.data), message.is_extended_id, message.is_fd)
