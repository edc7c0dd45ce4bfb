"""A serial port by pyserial, read by the event loop as it becomes readable."""

from __future__ import annotations

import asyncio
import os
import termios
from collections.abc import Callable
from contextlib import suppress

import serial

from lfield.driver import DeviceError

#: Seconds between attempts to open the port again.
AGAIN = 1.0


class SerialLink:
    """A tty, 8N1. One owner: the port is locked, so that no second program mixes its bytes in."""

    def __init__(self, path: str, baud: int, on_data: Callable[[bytes], None]) -> None:
        self._path, self._baud, self._on_data = path, baud, on_data
        self._port: serial.Serial | None = None
        self._task: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Open and configure the port, now."""
        try:
            self._attach()
        except BlockingIOError:
            raise DeviceError(
                "endpoint", f"serial port {self._path} is in use by another program or another binding"
            ) from None
        except (OSError, ValueError, termios.error) as error:
            place = f"serial:{self._path}:{self._baud}"
            raise DeviceError("endpoint", f"cannot open {place}: {_reason(error)}") from None

    def _attach(self) -> None:
        try:
            port = serial.Serial(self._path, self._baud, timeout=0, exclusive=True)
        except serial.SerialException as error:
            # pyserial says why only in its text.
            if "exclusively lock" in str(error):
                raise BlockingIOError from None
            raise
        self._port = port
        asyncio.get_running_loop().add_reader(port.fileno(), self._readable)

    def _readable(self) -> None:
        assert self._port is not None
        try:
            # pyserial's own read takes an empty answer for an error only sometimes; the file does not.
            data = os.read(self._port.fileno(), 4096)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self._on_data(data)
            return
        self._detach()
        self._task = asyncio.get_running_loop().create_task(self._reattach())

    async def _reattach(self) -> None:
        while self._port is None:
            await asyncio.sleep(AGAIN)
            with suppress(OSError, ValueError, termios.error):
                self._attach()

    def _detach(self) -> None:
        if self._port is not None:
            asyncio.get_running_loop().remove_reader(self._port.fileno())
            with suppress(OSError):
                self._port.close()
            self._port = None

    def send(self, data: bytes) -> None:
        """Into the port; when its buffer is full the packet is lost, which MAVLink survives."""
        if self._port is not None:
            with suppress(OSError):
                os.write(self._port.fileno(), data)

    def why_silent(self) -> str:
        """An autopilot's port has a baud rate, and speaks MAVLink if it was set up so."""
        return (
            f"nothing comes from {self._path}; check the cable, the baud rate of {self._baud}, and that the "
            "autopilot speaks MAVLink there (SERIALn_PROTOCOL 2, MAV_n_CONFIG)"
        )

    def close(self) -> None:
        """Give the port back."""
        if self._task is not None:
            self._task.cancel()
        self._detach()


def _reason(error: Exception) -> str:
    """Why a port cannot be opened; pyserial hides the system's word in its own."""
    number = getattr(error, "errno", None)
    if number:
        return os.strerror(number)
    return "it is no serial port" if "configure" in str(error) else str(error)
