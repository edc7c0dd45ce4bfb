"""Frames over a serial port: those that come by themselves, and answers for who has asked."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from lfield.driver.serial.framing import Framer
from lfield.driver.serial.port import PortEvents, SerialPort, parse_serial_endpoint
from lfield.errors import DeviceError

#: Makes the port of a line: path, baud rate, who uses it, and what is told of a slow adapter.
MakePort = Callable[[str, int, PortEvents, Callable[[str], None]], SerialPort]


def _any(frame: bytes) -> bool:
    return True


class SerialLine:
    """A port with its framer, at `serial:PATH:BAUD`.

    `on_frame` gets every frame that is no answer; `note` one sentence when the port has gone, and when it is
    back. A test gives `make_port`. Raises DeviceError for an endpoint that is none.
    """

    def __init__(
        self,
        endpoint: str,
        framer: Framer,
        *,
        on_frame: Callable[[bytes], None] = lambda frame: None,
        note: Callable[[str], None] = lambda text: None,
        make_port: MakePort = SerialPort,
    ) -> None:
        self._framer, self._on_frame, self._note = framer, on_frame, note
        path, baud = parse_serial_endpoint(endpoint)
        self._port = make_port(path, baud, self, note)
        self._asking = asyncio.Lock()
        self._fits: Callable[[bytes], bool] = _any
        self._answer: asyncio.Future[bytes] | None = None
        self._gone = ""

    def open(self) -> None:
        """Open the port, now. Raises DeviceError."""
        self._port.open()

    def close(self) -> None:
        """Give the port back; who still waits for an answer gets a DeviceError."""
        self._gone = "the port is closed"
        self._fail()
        self._port.close()

    def send(self, frame: bytes) -> None:
        """Write a frame as it is, with its delimiter or checksum. Raises DeviceError."""
        if self._gone:
            raise self._timeout(self._gone)
        if not self._port.write(frame):
            raise self._timeout(self._gone or f"{self._port.path} does not take what is sent")

    async def ask(
        self, request: bytes, fits: Callable[[bytes], bool] = _any, *, within: float = 0.5, tries: int = 1
    ) -> bytes:
        """Send a request and return the first frame that `fits`, at most `within` seconds after each try.

        One request at a time; others wait their turn. Where a late answer to the last request looks like one
        to this, `fits` must tell them apart. Raises DeviceError.
        """
        async with self._asking:
            for _ in range(tries):
                answer = await self._ask(request, fits, within)
                if answer is not None:
                    return answer
        raise self._timeout(f"no answer within {within:g} s{f', {tries} times' if tries > 1 else ''}")

    async def _ask(self, request: bytes, fits: Callable[[bytes], bool], within: float) -> bytes | None:
        answer: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        self._answer = answer
        self._fits = fits
        try:
            self.send(request)
            async with asyncio.timeout(within):
                return await answer
        except TimeoutError:
            return None
        finally:
            self._answer = None

    def _timeout(self, reason: str) -> DeviceError:
        return DeviceError("port", reason, kind="DeviceTimeoutException")

    # -- what the port tells ----------------------------------------------------------------------------

    def received(self, data: bytes) -> None:
        """Bytes of the port."""
        for frame in self._framer.feed(data):
            if self._answer is not None and not self._answer.done() and self._fits(frame):
                self._answer.set_result(frame)
            else:
                self._on_frame(frame)

    def lost(self, reason: str) -> None:
        """The port has gone: nobody is kept waiting."""
        self._gone = reason
        self._framer.reset()
        self._fail()
        self._note(reason)

    def back(self) -> None:
        """It is open again."""
        self._gone = ""
        self._note(f"{self._port.path} is open again")

    def _fail(self) -> None:
        if self._answer is not None and not self._answer.done():
            self._answer.set_exception(self._timeout(self._gone))
