"""One open interface of python-can, with a thread that reads and one that writes: the loop never waits."""

from __future__ import annotations

import fcntl
import logging
import os
import queue
import socket
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import can

from lfield.errors import DeviceError
from lfield_can.endpoint import Place

#: Seconds that one look for a frame lasts; also how soon a closed connection is noticed.
WAIT = 0.2
#: A frame that could not leave within so many seconds is dropped: a late command is worse than none.
FRESH = 0.05
#: Seconds between two tries while the send buffer is full.
AGAIN = 0.002
#: Frames that may wait to be sent.
BACKLOG = 256
#: How often an interface is opened whose answers and frames run together.
OPENINGS = 5
#: Seconds that a server may take to answer while an interface is opened.
ANSWER = 2.0
#: So many empty looks within SPIN_TIME seconds, and nobody is there: a client of socketcand whose server has
#: died finds nothing for ever, without waiting and without an error. (The answers of an slcan adapter are
#: empty looks too, a few thousand in a second at most.)
SPINS, SPIN_TIME = 2000, 0.4

#: Bytes of one line of an adapter; a frame of CAN FD takes 140.
LONGEST_LINE = 4096
GONE = "the bus is lost"

# They log every trouble with a traceback; ours is told in sentences by the driver's notes.
for _library in ("can", "canopen", "cantools"):
    logging.getLogger(_library).setLevel(logging.CRITICAL + 1)


@dataclass(frozen=True, slots=True)
class Job:
    """A frame to send until a time; `sent` gets '' or the reason why it was not."""

    message: can.Message
    until: float
    sent: Future[str]


def open_interface(place: Place) -> can.BusABC:
    """Open an endpoint now; blocks for a few seconds at most. Raises DeviceError."""
    try:
        if place.server is not None:
            # The interface itself would try for ten seconds, and never sleep meanwhile.
            socket.create_connection(place.server, ANSWER).close()
        # The interface sets no bound on the server's answers; this one is for the sockets it now makes.
        socket.setdefaulttimeout(ANSWER)
        return _open(dict(place.arguments))
    except Exception as error:  # every interface raises its own kinds, and some none of python-can's
        raise DeviceError("endpoint", f"cannot open {place.text}: {_words(error)}") from None
    finally:
        socket.setdefaulttimeout(None)


def _open(arguments: dict[str, Any]) -> can.BusABC:
    """A client of socketcand takes an answer that comes together with the first frame for a wrong one.

    On a busy bus that happens now and then, and goes well the next time.
    """
    for _ in range(OPENINGS - 1):
        with suppress(_Together):
            return _open_once(arguments)
    return _open_once(arguments)


class _Together(can.CanError):
    """An answer and a frame in one."""


def _open_once(arguments: dict[str, Any]) -> can.BusABC:
    try:
        return can.Bus(ignore_config=True, **arguments)
    except can.CanError as error:
        if "got: '< ok >< frame" in str(error):
            raise _Together(str(error)) from None
        raise


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
    """An open interface; it works until its first failure, then it is closed and another one is opened.

    `on_message` and `on_lost` are called in the reading thread, the latter once.
    """

    def __init__(
        self, place: Place, on_message: Callable[[can.Message], None], on_lost: Callable[[str], None]
    ) -> None:
        self.malformed = 0
        self._on_message, self._on_lost = on_message, on_lost
        self._closing = threading.Event()
        self._jobs: queue.Queue[Job | None] = queue.Queue(BACKLOG)
        self._lock = lock_tty(place.tty) if place.tty else None
        try:
            self._bus = open_interface(place)
        except DeviceError:
            self._unlock()
            raise
        for work, name in ((self._read, "can-read"), (self._write, "can-write")):
            threading.Thread(target=work, name=name, daemon=True).start()

    def send(self, message: can.Message) -> Future[str]:
        """Have a frame sent; from any thread, never waits. The future gives '' or why it was not sent."""
        job = Job(message, time.monotonic() + FRESH, Future())
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

    def close(self) -> None:
        """Give the interface back; blocks for a moment."""
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
        empty, since = 0, 0.0
        while not self._closing.is_set():
            try:
                # Not `recv`: it calls this until its time is over, and so spins where nobody is there.
                message, _ = self._bus._recv_internal(WAIT)
            except (ValueError, IndexError, KeyError):
                self.malformed += 1
                continue
            except Exception as error:  # OSError, CanError, SerialException, TypeError of a closed port
                self._fail(_words(error))
                return
            if message is not None:
                empty = 0
                self._on_message(message)
                continue
            # slcan keeps what has no end of line, however long it gets.
            if len(getattr(self._bus, "_buffer", b"")) > LONGEST_LINE:
                self._fail("what comes in are no frames")
                return
            if empty == 0:
                since = time.monotonic()
            empty += 1
            if empty < SPINS:
                continue
            if time.monotonic() - since < SPIN_TIME:
                self._fail("the other end has hung up")
                return
            empty = 0

    def _fail(self, reason: str) -> None:
        if not self._closing.is_set():
            self._closing.set()
            self._on_lost(reason)

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
