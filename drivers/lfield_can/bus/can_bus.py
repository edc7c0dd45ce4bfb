"""The bus of a driver: frames in and out on the loop; reopened automatically after a loss."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from lfield.driver import DeviceError, WireLog
from lfield.driver.network import Attempts
from lfield_can import log_messages
from lfield_can.bus.connection import open_connection
from lfield_can.bus.endpoint import parse_endpoint
from lfield_can.bus.error_frames import ACTIVE, DIALECTS, OFF, UNKNOWN, ErrorReport, advice, linux_error
from lfield_can.bus.frames import Frame, Interface, Listener
from lfield_can.bus.socketcand import open_socketcand

#: Seconds to the first attempt to reopen a lost bus, and the longest between two attempts.
FIRST_RETRY, LAST_RETRY = 0.2, 2.0
#: Seconds between two log lines about error frames.
QUIET_TIME = 10.0
#: Seconds after which a reopened bus counts as stable.
STEADY = 2.0


class Bus:
    """One CAN bus. `on_frame` gets every data frame, `note` a sentence for the log; all frames are in
    `wire_log`.
    """

    def __init__(
        self,
        endpoint: str,
        on_frame: Callable[[Frame], None],
        note: Callable[[str], None],
        wire_log: WireLog | None = None,
    ) -> None:
        self.errors = 0
        self._endpoint, self._wire_log = parse_endpoint(endpoint), wire_log
        self._channel, self._on_frame = self._endpoint.channel, on_frame
        self._listener = Listener(self._received, self._on_error, self._lost)
        self._note = note
        self._interface: Interface | None = None
        self._reopening: asyncio.Task[None] | None = None
        self._attempts = Attempts(self._endpoint.text)
        self._opened_at, self._retry_delay = -math.inf, FIRST_RETRY
        self._last_logged = -QUIET_TIME
        self._errors_logged = 0
        self._read_error = DIALECTS.get(str(self._endpoint.arguments.get("interface")), linux_error)
        #: The state of the controller, and the last error on the wire.
        self._state, self._cause = ACTIVE, ""

    async def open(self) -> None:
        """Opens the bus. Raises DeviceError when that is impossible."""
        self._loop = asyncio.get_running_loop()
        open_interface = open_socketcand if self._endpoint.server is not None else open_connection
        self._interface = await open_interface(self._endpoint, self._listener)

    async def close(self) -> None:
        if self._reopening is not None:
            self._reopening.cancel()
        interface, self._interface = self._interface, None
        if interface is not None:
            await interface.close()

    async def send(self, frame: Frame) -> None:
        """Sends a frame; returns when the interface has accepted it. Raises DeviceError."""
        if self._interface is None:
            raise self._error("the bus is lost", timeout=True)
        reason = await self._interface.send(frame)
        if reason:
            hint = "; a frame of CAN FD needs an interface with FD enabled" if frame.fd else ""
            raise self._error(f"a frame could not be sent: {reason}{hint}")
        self._log_frame(frame, is_sent=True)

    def post(self, frame: Frame) -> None:
        """Sends a frame without waiting; it may be dropped, for frames that are repeated."""
        interface = self._interface
        if interface is not None:
            interface.post(frame)
            self._log_frame(frame, is_sent=True)

    @property
    def problem_text(self) -> str:
        """The reason why no device may be received: the state of the bus, and its cause if known; '' for
        none.
        """
        if self._state == ACTIVE:
            return ""
        return f"{self._state}: {self._cause}" if self._cause else self._state

    def _received(self, frame: Frame) -> None:
        if self._state == OFF:
            self._set_state(ACTIVE)
        self._log_frame(frame, is_sent=False)
        self._on_frame(frame)

    def _log_frame(self, frame: Frame, *, is_sent: bool) -> None:
        """Logs a frame: a received one when the loop reads it, one of `post` when it is queued."""
        if self._wire_log is None:
            return
        identifier, data, extended, fd, switch = frame
        self._wire_log.log_can(
            self._channel, identifier, data, extended=extended, fd=fd, switch=switch, is_sent=is_sent
        )

    @property
    def malformed(self) -> int:
        """The number of invalid frames since the bus was last opened."""
        return self._interface.malformed if self._interface is not None else 0

    def _error(self, reason: str, *, timeout: bool = False) -> DeviceError:
        kind = "DeviceTimeoutException" if timeout else "DeviceException"
        return DeviceError("bus", f"{self._endpoint.text}: {reason}", kind=kind)

    def _on_error(self, identifier: int, data: bytes) -> None:
        """Handles an error frame."""
        if self._wire_log is not None:
            self._wire_log.log_can_error(self._channel, identifier, data)
        self.errors += 1
        report = self._read_error(identifier, data)
        if report.has_cause:
            self._cause = report.text + advice(report.text)
        if report.state == OFF or (self._interface is not None and self._interface.is_off):
            self._state = OFF
            self._lost(f"bus off ({self._cause})" if self._cause else "bus off")
        elif report.state not in (UNKNOWN, self._state):
            self._set_state(report.state)
        else:
            self._log_error(report)

    def _set_state(self, state: str) -> None:
        """Reports a new state of the controller."""
        self._state = state
        if state == ACTIVE:
            self._cause = ""
            self._note(log_messages.BUS_ACTIVE.line(bus=self._endpoint.text))
        else:
            reason = self._cause or "too many errors" + advice("violation")
            self._note(log_messages.BUS_STATE.line(bus=self._endpoint.text, state=state, reason=reason))

    def _log_error(self, report: ErrorReport) -> None:
        if self._loop.time() - self._last_logged < QUIET_TIME:
            return
        count = self.errors - self._errors_logged
        self._last_logged, self._errors_logged = self._loop.time(), self.errors
        reason = report.text + advice(report.text)
        self._note(log_messages.ERROR_FRAMES.line(count=count, bus=self._endpoint.text, reason=reason))

    # -- loss and recovery ------------------------------------------------------------------------------

    def _lost(self, reason: str) -> None:
        interface, self._interface = self._interface, None
        if interface is None:
            return
        if self._loop.time() - self._opened_at > STEADY:
            self._attempts.works()
        self._log(self._attempts.lost(reason, self._loop.time()))
        self._reopening = self._loop.create_task(self._reopen(interface))

    async def _reopen(self, failed: Interface) -> None:
        """Closes the failed interface, then retries until one works."""
        await failed.close()
        # An interface that is down can be opened, but fails when it is read: keep increasing the pauses.
        if self._loop.time() - self._opened_at > STEADY:
            self._retry_delay = FIRST_RETRY
        while self._interface is None:
            await asyncio.sleep(self._retry_delay)
            self._retry_delay = min(2.0 * self._retry_delay, LAST_RETRY)
            try:
                await self.open()
            except DeviceError as error:
                self._log(self._attempts.failed(error.reason, self._loop.time()))
        self._opened_at = self._loop.time()
        self._log(self._attempts.opened("", self._loop.time()))

    def _log(self, line: str) -> None:
        if line:
            self._note(line)
