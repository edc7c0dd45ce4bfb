"""Frames over a serial port: unsolicited frames, requests and responses."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from lfield.driver.recording import WireLog
from lfield.driver.serial.serial_framing import Framer
from lfield.driver.serial.serial_port import PortEvents, SerialPort, parse_serial_endpoint
from lfield.errors import DeviceError
from lfield.text import log_messages

#: Creates the port: path, baud rate, receiver of its events, and a log function for a slow adapter.
MakePort = Callable[[str, int, PortEvents, Callable[[str], None]], SerialPort]


def _any(frame: bytes) -> bool:
    return True


class SerialLine:
    """A port with its framer, at `serial:PATH:BAUD`.

    `on_frame` gets every frame that is not a response; `note` gets one sentence when the port is lost and
    when it is open again. `wire_log` is the log of the driver. `make_port` is for tests. Raises DeviceError
    for an invalid endpoint.
    """

    def __init__(
        self,
        endpoint: str,
        framer: Framer,
        *,
        on_frame: Callable[[bytes], None] = lambda frame: None,
        note: Callable[[str], None] = lambda text: None,
        wire_log: WireLog | None = None,
        make_port: MakePort = SerialPort,
    ) -> None:
        self._framer, self._on_frame, self._note, self._wire_log = framer, on_frame, note, wire_log
        path, baud = parse_serial_endpoint(endpoint)
        self._port = make_port(path, baud, self, note)
        self._request_lock = asyncio.Lock()
        self._fits: Callable[[bytes], bool] = _any
        self._answer: asyncio.Future[bytes] | None = None
        self._failure = ""

    def open(self) -> None:
        """Opens the port. Raises DeviceError."""
        self._port.open()

    def close(self) -> None:
        """Closes the port; pending requests raise DeviceError."""
        self._failure = "the port is closed"
        self._fail()
        self._port.close()

    def send(self, frame: bytes) -> None:
        """Writes a complete frame with its delimiter or checksum. Raises DeviceError."""
        if self._failure:
            raise self._timeout(self._failure)
        if not self._port.write(frame):
            raise self._timeout(self._failure or f"{self._port.path} does not accept data")
        if self._wire_log is not None:
            self._wire_log.log_bytes(frame, is_sent=True)

    async def ask(
        self, request: bytes, fits: Callable[[bytes], bool] = _any, *, within: float = 0.5, tries: int = 1
    ) -> bytes:
        """Sends a request and returns the first frame that `fits`, at most `within` seconds after each try.

        Requests are serialised. If a late response to the last request could match this request, `fits` must
        distinguish them. Raises DeviceError.
        """
        async with self._request_lock:
            for _ in range(tries):
                answer = await self._request_once(request, fits, within)
                if answer is not None:
                    return answer
        raise self._timeout(f"no answer within {within:g} s{f', {tries} times' if tries > 1 else ''}")

    async def _request_once(
        self, request: bytes, fits: Callable[[bytes], bool], within: float
    ) -> bytes | None:
        # Sent first: if sending loses the port, `send` raises the only error of this request.
        self.send(request)
        answer: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        self._answer = answer
        self._fits = fits
        try:
            async with asyncio.timeout(within):
                return await answer
        except TimeoutError:
            return None
        finally:
            self._answer = None

    def _timeout(self, reason: str) -> DeviceError:
        return DeviceError("port", reason, kind="DeviceTimeoutException")

    # -- events of the port ------------------------------------------------------------------------------

    def received(self, data: bytes) -> None:
        """Bytes have arrived."""
        if self._wire_log is not None:
            self._wire_log.log_bytes(data, is_sent=False)
        for frame in self._framer.feed(data):
            if self._answer is not None and not self._answer.done() and self._fits(frame):
                self._answer.set_result(frame)
            else:
                self._on_frame(frame)

    def lost(self, reason: str) -> None:
        """The port is lost: the pending request fails."""
        self._failure = reason
        self._framer.reset()
        self._fail()
        self._note(log_messages.SERIAL_LOST.line(reason=reason))

    def back(self) -> None:
        """The port is open again."""
        self._failure = ""
        self._note(log_messages.SERIAL_BACK.line(port=self._port.path))

    def _fail(self) -> None:
        if self._answer is not None and not self._answer.done():
            self._answer.set_exception(self._timeout(self._failure))
