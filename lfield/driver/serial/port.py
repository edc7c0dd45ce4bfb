"""A serial port: opened for us alone, read as bytes arrive, opened again after an unplug. By pyserial."""

from __future__ import annotations

import asyncio
import os
import termios
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from lfield.driver.network.attempts import Attempts
from lfield.errors import DeviceError
from lfield.loop import SerialEnd, Simulated

SYNTAX = "serial:PATH:BAUD, for instance serial:/dev/ttyUSB0:57600"
#: Seconds between two attempts to open a port that was unplugged.
AGAIN = 0.25
#: Bytes that are read at once.
READ = 4096
#: The fastest baud rate that an endpoint may ask for.
FASTEST = 12_000_000

#: Where Linux keeps how long a USB adapter holds bytes back, in milliseconds.
_LATENCY = "/sys/bus/usb-serial/devices/{}/latency_timer"


class PortEvents(Protocol):
    """Who uses a port."""

    def received(self, data: bytes) -> None:
        """Bytes have arrived."""

    def lost(self, reason: str) -> None:
        """The port has gone; it comes back by itself when it can."""

    def back(self) -> None:
        """It is open again."""


def parse_serial_endpoint(endpoint: str) -> tuple[str, int]:
    """Path and baud rate of `serial:PATH:BAUD`. Raises DeviceError with a sentence on how to write one."""
    kind, _, rest = endpoint.partition(":")
    path, _, baud = rest.rpartition(":")
    if kind != "serial" or not path or not baud.isdecimal() or not 0 < int(baud) <= FASTEST:
        raise DeviceError("endpoint", f"'{endpoint}' is not an endpoint; write {SYNTAX}")
    return path, int(baud)


class SerialPort:
    """A tty, 8 bits and 1 stop bit. It is locked, so that no second program mixes its bytes in.

    `note` wants a USB adapter to pass bytes on within a millisecond, for requests that wait for answers: it
    is told when the adapter does not. `latency` is how long bytes may be held back then, in seconds. `tried`
    (or else `note`) gets a line when a port that was unplugged cannot be opened again, for each reason one.
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
        self._port: SerialEnd | None = None
        self._task: asyncio.Task[None] | None = None
        self.latency = 0.0

    @property
    def is_open(self) -> bool:
        """Whether it is there now."""
        return self._port is not None

    def open(self) -> None:
        """Open and configure the port, now. Raises DeviceError when that is impossible here."""
        make = _pyserial()
        try:
            self._attach(make)
        except (OSError, ValueError, termios.error) as error:
            place = f"serial:{self.path}:{self.baud}"
            raise DeviceError("endpoint", f"cannot open {place}: {self._reason(error)}") from None

    def _attach(self, make: Any) -> None:
        loop = asyncio.get_running_loop()
        if isinstance(loop, Simulated):
            self._port = loop.open_serial(self.path, self.baud, self)
            return
        self._port = _Tty(make(self.path, self.baud, timeout=0, exclusive=True, parity=self._parity), self)
        if self._note is not None:
            self._pass_on(self._note)

    def _pass_on(self, note: Callable[[str], None]) -> None:
        """Have the adapter pass bytes on within a millisecond, where it is one and lets us; else tell."""
        file = Path(_LATENCY.format(Path(self.path).resolve().name))
        if not file.exists():
            return
        with suppress(OSError):
            file.write_text("1")
        milliseconds = int(file.read_text())
        self.latency = milliseconds / 1000.0
        if milliseconds > 1:
            note(
                f"{self.path} holds every answer back for {milliseconds} ms: write 1 into {file} "
                "(as root, or by a udev rule) for a faster bus"
            )

    def received(self, data: bytes) -> None:
        """Bytes have arrived."""
        self._events.received(data)

    def unplugged(self) -> None:
        """The port has gone."""
        self._lose("it was unplugged")

    def failed(self, error: OSError) -> None:
        """It cannot be read any more."""
        self._lose(self._reason(error))

    def write(self, data: bytes) -> bool:
        """Send bytes, at once; whether all of them were taken. Never waits."""
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
        """Give the port back."""
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
            await asyncio.sleep(AGAIN)
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
        """Why a port cannot be used, with the cure where there is one; pyserial says it in its text only."""
        number, text = getattr(error, "errno", None), str(error)
        if "exclusively lock" in text:
            return f"{self.path} is in use by another program; a serial port has one owner"
        if number == 13:
            return "no permission; add yourself to the group of the port (often dialout)"
        if number:
            return os.strerror(number)
        return "it is no serial port" if "configure" in text else text


class _Tty:
    """A tty of this computer, read as bytes arrive."""

    def __init__(self, port: Any, user: SerialPort) -> None:
        port.reset_input_buffer()
        self._port, self._user, self._loop = port, user, asyncio.get_running_loop()
        self._loop.add_reader(port.fileno(), self._readable)

    def _readable(self) -> None:
        try:
            # pyserial's own read takes an empty answer for an error only sometimes; the file does not.
            data = os.read(self._port.fileno(), READ)
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
        """Send bytes. Raises OSError, a BlockingIOError when not all of them were taken."""
        if os.write(self._port.fileno(), data) != len(data):
            raise BlockingIOError

    def close(self) -> None:
        """Give it back."""
        self._loop.remove_reader(self._port.fileno())
        with suppress(OSError):
            self._port.close()


def _pyserial() -> Any:
    """What makes a port. Raises DeviceError that says what to install."""
    try:
        from serial import Serial
    except ImportError:
        raise DeviceError("endpoint", "a serial port needs pyserial: pip install 'lfield[serial]'") from None
    return Serial
