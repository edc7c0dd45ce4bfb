"""The serial port of a bus: opened for us alone, read as bytes arrive, opened again after an unplug."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Protocol

import serial

from lfield.driver import DeviceError

SYNTAX = "serial:PATH:BAUD, for instance serial:/dev/ttyUSB0:1000000"
#: Seconds between two attempts to open a port that was unplugged.
AGAIN = 0.25

#: Where Linux keeps how long a USB adapter holds bytes back, in milliseconds.
_LATENCY = "/sys/bus/usb-serial/devices/{}/latency_timer"


class Port(Protocol):
    """What a bus needs of its port. `latency` is how long bytes may be held back on the way, in seconds."""

    baud: int
    latency: float

    def open(self) -> None:
        """Open it. Raises DeviceError when that is impossible here and now."""

    def write(self, data: bytes) -> bool:
        """Send a packet, at once; whether that worked."""

    def close(self) -> None:
        """Give it back."""


class PortEvents(Protocol):
    """Who uses a port."""

    def received(self, data: bytes) -> None:
        """Bytes have arrived."""

    def lost(self, reason: str) -> None:
        """The port has gone; it comes back by itself when it can."""

    def back(self) -> None:
        """It is open again."""


MakePort = Callable[[PortEvents], Port]


def parse_endpoint(endpoint: str) -> tuple[str, int]:
    """Path and baud rate of an endpoint. Raises DeviceError with a sentence on how to write one."""
    kind, _, rest = endpoint.partition(":")
    path, _, baud = rest.rpartition(":")
    if kind != "serial" or not path or not baud.isdecimal() or not 0 < int(baud) <= 12_000_000:
        raise DeviceError("endpoint", f"'{endpoint}' is not an endpoint; write {SYNTAX}")
    return path, int(baud)


class SerialPort:
    """A tty: pyserial sets it up, the loop reads it. One owner: it is locked for others."""

    def __init__(self, endpoint: str, events: PortEvents, note: Callable[[str], None]) -> None:
        self._path, self.baud = parse_endpoint(endpoint)
        self._events, self._note = events, note
        self._serial: serial.Serial | None = None
        self._task: asyncio.Task[None] | None = None
        self.latency = 0.0

    def open(self) -> None:
        """Open and configure the port, now."""
        try:
            self._attach()
        except (OSError, ValueError) as error:
            raise DeviceError("endpoint", f"cannot open {self._path}: {_reason(error)}") from None

    def _attach(self) -> None:
        port = serial.Serial(self._path, self.baud, timeout=0, exclusive=True)
        port.reset_input_buffer()
        self._serial = port
        self._set_latency()
        asyncio.get_running_loop().add_reader(port.fileno(), self._readable)

    def _set_latency(self) -> None:
        """Have the adapter pass bytes on within a millisecond, where it is one and lets us; else tell."""
        file = Path(_LATENCY.format(Path(self._path).resolve().name))
        if not file.exists():
            return
        with suppress(OSError):
            file.write_text("1")
        milliseconds = int(file.read_text())
        self.latency = milliseconds / 1000.0
        if milliseconds > 1:
            self._note(
                f"{self._path} holds every answer back for {milliseconds} ms: write 1 into {file} "
                "(as root, or by a udev rule) for a faster bus"
            )

    def _readable(self) -> None:
        assert self._serial is not None
        try:
            data = os.read(self._serial.fileno(), 4096)
        except BlockingIOError:
            return
        except OSError as error:
            self._lose(_reason(error))
            return
        if data:
            self._events.received(data)
        else:
            self._lose("it was unplugged")

    def write(self, data: bytes) -> bool:
        """Send a packet; a port that takes none of it, or only a part, is as good as gone."""
        if self._serial is None:
            return False
        try:
            return os.write(self._serial.fileno(), data) == len(data)
        except BlockingIOError:
            return False
        except OSError as error:
            self._lose(_reason(error))
            return False

    def _lose(self, reason: str) -> None:
        self._detach()
        self._task = asyncio.get_running_loop().create_task(self._reattach())
        self._events.lost(f"{self._path} is gone ({reason})")

    async def _reattach(self) -> None:
        while self._serial is None:
            await asyncio.sleep(AGAIN)
            with suppress(OSError, ValueError):
                self._attach()
        self._events.back()

    def _detach(self) -> None:
        if self._serial is not None:
            asyncio.get_running_loop().remove_reader(self._serial.fileno())
            with suppress(OSError):
                self._serial.close()
            self._serial = None

    def close(self) -> None:
        """Give the port back."""
        if self._task is not None:
            self._task.cancel()
        self._detach()


def _reason(error: Exception) -> str:
    """Why a port cannot be used, in words and with the cure where there is one."""
    text = str(error)
    if "lock" in text:
        return "another program has it open"
    if isinstance(error, OSError) and error.errno == 13:
        return "no permission; add yourself to the group of the port (often dialout)"
    return os.strerror(error.errno) if isinstance(error, OSError) and error.errno else text
