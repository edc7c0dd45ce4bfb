"""A serial port: exclusive, non-blocking, opened again after it was unplugged. Uses pyserial."""

from __future__ import annotations

import asyncio
import errno
import grp
import os
import termios
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from lfield.driver.network.attempts import Attempts
from lfield.errors import DeviceError
from lfield.event_loop import SerialLineEnd, SimulatedLoop
from lfield.text import log_messages

SYNTAX = "serial:PATH:BAUD, for instance serial:/dev/ttyUSB0:57600"
#: Seconds between two attempts to reopen a port.
REOPEN_INTERVAL = 0.25
#: Bytes per read.
READ_SIZE = 4096
#: Highest accepted baud rate.
MAX_BAUD = 12_000_000

#: The USB adapter's latency timer in Linux, in milliseconds.
_LATENCY = "/sys/bus/usb-serial/devices/{}/latency_timer"


class PortEvents(Protocol):
    """Receiver of a port's events."""

    def received(self, data: bytes) -> None:
        """Bytes have arrived."""

    def lost(self, reason: str) -> None:
        """The port is lost; it is reopened automatically when possible."""

    def back(self) -> None:
        """The port is open again."""


def parse_serial_endpoint(endpoint: str) -> tuple[str, int]:
    """Path and baud rate of `serial:PATH:BAUD`. Raises DeviceError with the syntax."""
    kind, _, rest = endpoint.partition(":")
    path, _, baud = rest.rpartition(":")
    if kind != "serial" or not path or not baud.isdecimal() or not 0 < int(baud) <= MAX_BAUD:
        raise DeviceError("endpoint", f"'{endpoint}' is not a serial endpoint; write {SYNTAX}")
    if not path.startswith("/"):
        absolute = f"serial:/dev/{path}:{baud}"
        raise DeviceError("endpoint", f"'{endpoint}': '{path}' is not an absolute path; write {absolute}")
    return path, int(baud)


class SerialPort:
    """A tty with 8 data bits and 1 stop bit, locked against other programs.

    With `note` a USB adapter is set to deliver bytes within a millisecond, for request-response protocols;
    `note` is called if that fails. `latency` is the longest delay of received bytes, in seconds. `tried`
    (default: `note`) gets one line per reason why an unplugged port cannot be reopened.
    """

    def __init__(
        self,
        path: str,
        baud: int,
        events: PortEvents,
        note: Callable[[str], None] | None = None,
        *,
        parity: str = "N",
        tried: Callable[[str], None] | None = None,
    ) -> None:
        self.path, self.baud, self._parity = path, baud, parity
        self._events, self._note = events, note
        self._tried = tried or note or (lambda text: None)
        self._port: SerialLineEnd | None = None
        self._task: asyncio.Task[None] | None = None
        self.latency = 0.0

    @property
    def is_open(self) -> bool:
        return self._port is not None

    def open(self) -> None:
        """Opens and configures the port. Raises DeviceError if the port cannot be opened."""
        make = _pyserial()
        try:
            self._attach(make)
        except (OSError, ValueError, termios.error) as error:
            place = f"serial:{self.path}:{self.baud}"
            reason = self._reason(error)
            if getattr(error, "errno", None) == errno.ENOENT:
                reason += "; is the device connected?"
            raise DeviceError("endpoint", f"cannot open {place}: {reason}") from None

    def _attach(self, make: Any) -> None:
        loop = asyncio.get_running_loop()
        if isinstance(loop, SimulatedLoop):
            self._port = loop.open_serial(self.path, self.baud, self)
            return
        self._port = _Tty(make(self.path, self.baud, timeout=0, exclusive=True, parity=self._parity), self)
        if self._note is not None:
            self._set_low_latency(self._note)

    def _set_low_latency(self, note: Callable[[str], None]) -> None:
        """Sets the adapter's latency timer to 1 ms if it has one and permissions allow; otherwise logs the
        reason.
        """
        file = Path(_LATENCY.format(Path(self.path).resolve().name))
        if not file.exists():
            return
        with suppress(OSError):
            file.write_text("1")
        try:
            milliseconds = int(file.read_text())
        except (OSError, ValueError):  # unplugged, or without this file of its driver
            return
        self.latency = milliseconds / 1000.0
        if milliseconds > 1:
            note(log_messages.SERIAL_LATENCY.line(port=self.path, milliseconds=milliseconds, file=file))

    def received(self, data: bytes) -> None:
        """Bytes have arrived."""
        self._events.received(data)

    def unplugged(self) -> None:
        """The port is lost."""
        self._lose("it was unplugged")

    def failed(self, error: OSError) -> None:
        """Reading has failed."""
        self._lose(self._reason(error))

    def write(self, data: bytes) -> bool:
        """Sends bytes without waiting; returns whether all of them were accepted."""
        if self._port is None:
            return False
        try:
            self._port.write(data)
        except BlockingIOError:
            return False
        except OSError as error:
            self._lose(self._reason(error))
            return False
        return True

    def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
        self._detach()

    def _lose(self, reason: str) -> None:
        self._detach()
        self._task = asyncio.get_running_loop().create_task(self._reattach())
        self._events.lost(f"{self.path} is gone ({reason})")

    async def _reattach(self) -> None:
        make, attempts = _pyserial(), Attempts(f"serial:{self.path}")
        loop = asyncio.get_running_loop()
        while self._port is None:
            await asyncio.sleep(REOPEN_INTERVAL)
            try:
                self._attach(make)
            except (OSError, ValueError, termios.error) as error:
                if line := attempts.failed(self._reason(error), loop.time()):
                    self._tried(line)
        self._events.back()

    def _detach(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def _reason(self, error: Exception) -> str:
        """The reason why a port cannot be used, with the remedy if there is one.

        pyserial reports the reason in the text of its exception only.
        """
        number, text = getattr(error, "errno", None), str(error)
        if "exclusively lock" in text:
            return f"{self.path} is in use by another program; a serial port has one owner"
        if number == errno.EACCES:
            return permission_reason(self.path)
        if number:
            return os.strerror(number)
        return "it is not a serial port" if "configure" in text else text


def permission_reason(path: str) -> str:
    """The reason why a device file may not be opened, and the remedy with the group that owns it."""
    try:
        group = grp.getgrgid(os.stat(path).st_gid).gr_name
    except (OSError, KeyError):
        group = "dialout"
    return f"no permission; 'sudo usermod -aG {group} $USER' adds you to its group {group}; then log in again"


class _Tty:
    """A tty of this computer, read as bytes arrive."""

    def __init__(self, port: Any, user: SerialPort) -> None:
        port.reset_input_buffer()
        self._port, self._user, self._loop = port, user, asyncio.get_running_loop()
        self._loop.add_reader(port.fileno(), self._readable)

    def _readable(self) -> None:
        try:
            # pyserial's own read does not always treat an empty read as an error; a read of the file does.
            data = os.read(self._port.fileno(), READ_SIZE)
        except BlockingIOError:
            return
        except OSError as error:
            self._user.failed(error)
            return
        if data:
            self._user.received(data)
        else:
            self._user.unplugged()

    def write(self, data: bytes) -> None:
        """Sends bytes. Raises OSError; BlockingIOError when not all of them were accepted."""
        if os.write(self._port.fileno(), data) != len(data):
            raise BlockingIOError

    def close(self) -> None:
        self._loop.remove_reader(self._port.fileno())
        with suppress(OSError):
            self._port.close()


def _pyserial() -> Any:
    """Imports pyserial. Raises DeviceError that names the package to install."""
    try:
        from serial import Serial
    except ImportError:
        raise DeviceError("endpoint", "a serial port needs pyserial: pip install 'lfield[serial]'") from None
    return Serial
