"""An open interface of python-can, with a reader and a writer thread: the loop never blocks."""

from __future__ import annotations

import asyncio
import errno
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
from typing import Any

import can
from msgspec import Struct

from lfield.driver import DeviceError
from lfield.driver.serial.serial_port import permission_reason
from lfield_can.bus.endpoint import Endpoint
from lfield_can.bus.frames import BUS_LOST, Frame, Listener

#: Seconds of one read; also the delay until a closed connection is noticed.
WAIT = 0.2
#: A frame is dropped if the interface has not accepted it within this many seconds: a late command is worse
#: than none. A newer frame follows a posted one (heartbeat, SYNC, repeated setpoint). The sender of any other
#: awaits the result: a busy computer that delays the writer thread must not fail the call.
POST_TIMEOUT, SEND_TIMEOUT = 0.05, 0.5
#: Seconds between two attempts while the send buffer is full.
RETRY_INTERVAL = 0.002
#: Send queue in frames.
BACKLOG = 256
#: Receive queue in frames; the oldest are dropped.
INBOX = 10_000
#: Bytes of one line of an adapter; a frame of CAN FD takes 140.
LONGEST_LINE = 4096

#: PCAN_ERROR_BUSOFF of PCAN-Basic.
PCAN_OFF = 0x10

#: Reasons why an interface of SocketCAN cannot be opened, by the error of the kernel.
_SOCKETCAN_ERRORS = {
    errno.EAFNOSUPPORT: "this kernel has no SocketCAN: load it with 'sudo modprobe can_raw'",
    errno.ENODEV: "there is no such interface: is the adapter connected? 'ip link' lists the interfaces",
}

# These loggers write every problem with a traceback; the driver's notes report it instead.
for _library in ("can", "canopen", "cantools"):
    logging.getLogger(_library).setLevel(logging.CRITICAL + 1)


class Job(Struct, frozen=True):
    """A frame to send before a deadline; `sent` gets '' or the reason for a failure."""

    message: can.Message
    deadline: float
    sent: Future[str]


async def open_connection(endpoint: Endpoint, listener: Listener) -> Connection:
    """Opens an endpoint. Raises DeviceError."""
    return await asyncio.to_thread(Connection, endpoint, listener, asyncio.get_running_loop())


def _open_interface(endpoint: Endpoint) -> can.BusABC:
    """Opens an interface; blocks briefly. Raises DeviceError."""
    arguments: dict[str, Any] = dict(endpoint.arguments)
    try:
        return can.Bus(ignore_config=True, **arguments)
    except Exception as error:  # interfaces raise various exceptions, some not of python-can
        is_socketcan = arguments.get("interface") == "socketcan"
        reason = _SOCKETCAN_ERRORS.get(getattr(error, "errno", 0)) if is_socketcan else None
        raise DeviceError(
            "endpoint", f"cannot open {endpoint.text}: {reason or _error_text(error)}"
        ) from None


def lock_tty(path: str) -> int:
    """Locks a serial port; returns the descriptor that holds the lock. Raises DeviceError."""
    try:
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        is_refused = isinstance(error, PermissionError)
        reason = permission_reason(path) if is_refused else _error_text(error)
        raise DeviceError("endpoint", f"cannot open {path}: {reason}") from None
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

    def __init__(
        self,
        endpoint: Endpoint,
        listener: Listener,
        loop: asyncio.AbstractEventLoop,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self.malformed = 0
        self._monotonic = monotonic
        self._listener, self._loop = listener, loop
        self._inbox: deque[can.Message] = deque(maxlen=INBOX)
        self._wakeup = threading.Event()
        self._closing = threading.Event()
        #: Held while `_closing` is set or a job is queued: after `_closing` is set, no job is queued.
        self._queue_lock = threading.Lock()
        self._jobs: queue.Queue[Job | None] = queue.Queue(BACKLOG)
        self._tty_lock = lock_tty(endpoint.tty) if endpoint.tty else None
        try:
            self._bus = _open_interface(endpoint)
        except DeviceError:
            self._unlock()
            raise
        for target, name in ((self._read, "can-read"), (self._write, "can-write")):
            threading.Thread(target=target, name=name, daemon=True).start()

    async def send(self, frame: Frame) -> str:
        """Sends a frame after all earlier ones; '' when it was sent, or the reason for a failure.

        A frame whose sender is cancelled while it is queued is not sent.
        """
        return await asyncio.wrap_future(self._enqueue(frame, SEND_TIMEOUT))

    def post(self, frame: Frame) -> None:
        """Queues a frame; never waits."""
        self._enqueue(frame, POST_TIMEOUT)

    def _enqueue(self, frame: Frame, timeout: float) -> Future[str]:
        job = Job(_message(frame), self._monotonic() + timeout, Future())
        with self._queue_lock:
            if self._closing.is_set():
                job.sent.set_result(BUS_LOST)
                return job.sent
            try:
                self._jobs.put_nowait(job)
            except queue.Full:
                job.sent.set_result("the send queue is full")
        return job.sent

    @property
    def is_off(self) -> bool:
        """Whether the interface reports bus off: by its state, or a PCAN by its status."""
        try:
            if status := getattr(self._bus, "status", None):
                return bool(status() & PCAN_OFF)
            return bool(self._bus.state is can.BusState.ERROR)
        except Exception:  # many interfaces do not report it
            return False

    async def close(self) -> None:
        """Closes the interface."""
        await asyncio.to_thread(self._shut_down)

    def _shut_down(self) -> None:
        with self._queue_lock:
            self._closing.set()
        with suppress(queue.Full):  # otherwise the writer is awake and checks _closing
            self._jobs.put_nowait(None)
        with suppress(Exception):  # it may be closed already
            self._bus.shutdown()
        self._unlock()

    def _unlock(self) -> None:
        if self._tty_lock is not None:
            os.close(self._tty_lock)
            self._tty_lock = None

    # -- the reading thread -----------------------------------------------------------------------------

    def _read(self) -> None:
        while not self._closing.is_set():
            try:
                # Not `recv`: invalid frames also end the read, and are counted here.
                message, _ = self._bus._recv_internal(WAIT)
            except (ValueError, IndexError, KeyError):
                self.malformed += 1
                continue
            except Exception as error:  # OSError, CanError, SerialException, TypeError of a closed port
                self._fail(_error_text(error))
                return
            if message is not None:
                self._received(message)
            # slcan keeps input without an end of line, of any length.
            elif len(getattr(self._bus, "_buffer", b"")) > LONGEST_LINE:
                self._fail("the received data is not CAN frames")
                return

    def _received(self, message: can.Message) -> None:
        """Wakes the loop once for all frames until it runs."""
        self._inbox.append(message)
        if not self._wakeup.is_set():
            self._wakeup.set()
            self._in_loop(self._drain)

    def _fail(self, reason: str) -> None:
        with self._queue_lock:
            if self._closing.is_set():
                return
            self._closing.set()
        self._in_loop(self._listener.lost, reason)

    def _in_loop(self, callback: Callable[..., None], *arguments: object) -> None:
        with suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(callback, *arguments)

    def _drain(self) -> None:
        """Runs on the loop."""
        # Cleared first: a frame that arrives while this runs wakes the loop again.
        self._wakeup.clear()
        for _ in range(len(self._inbox)):
            message = self._inbox.popleft()
            if message.is_error_frame:
                self._listener.error(message.arbitration_id, bytes(message.data))
            elif not message.is_remote_frame:
                self._listener.frame(_frame(message))

    # -- the writing thread -----------------------------------------------------------------------------

    def _write(self) -> None:
        while not self._closing.is_set() and (job := self._jobs.get()) is not None:
            if job.sent.set_running_or_notify_cancel():  # False when its sender was cancelled
                job.sent.set_result(self._send_job(job))
        # Fail the remaining jobs; later ones find no connection.
        with suppress(queue.Empty):
            while True:
                job = self._jobs.get_nowait()
                if job is not None and job.sent.set_running_or_notify_cancel():
                    job.sent.set_result(BUS_LOST)

    def _send_job(self, job: Job) -> str:
        reason = "it was queued for too long"
        while not self._closing.is_set():
            remaining = job.deadline - self._monotonic()
            if remaining <= 0.0:
                return reason
            try:
                self._bus.send(job.message, timeout=remaining)
                return ""
            except can.CanError as error:
                # Usually a full buffer. The reader detects a failed interface.
                reason = _error_text(error)
                time.sleep(RETRY_INTERVAL)
            except Exception as error:
                self._fail(_error_text(error))
                return _error_text(error)
        return BUS_LOST


def _error_text(error: Exception) -> str:
    """The first line of an exception, as the end of a sentence; some contain a traceback."""
    text = (getattr(error, "strerror", None) or str(error) or repr(error)).strip()
    return text.splitlines()[0][:200]


def _message(frame: Frame) -> can.Message:
    return can.Message(
        arbitration_id=frame.id,
        data=frame.data,
        is_extended_id=frame.extended,
        is_fd=frame.fd,
        bitrate_switch=frame.switch,
    )


def _frame(message: can.Message) -> Frame:
    return Frame(
        message.arbitration_id,
        bytes(message.data),
        message.is_extended_id,
        message.is_fd,
        message.bitrate_switch,
    )
