"""MAVLink command protocol: commands repeated until they are answered.

An answer means that a command was accepted, not that it was achieved; the caller watches the state.
https://mavlink.io/en/services/command.html.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

from lfield_mavlink.geodesy import Place
from lfield_mavlink.link.dialect import AUTOPILOT, COMPONENT, dialect

#: Seconds to wait for an answer, and attempts; more attempts while there is contact, since at a loss of 20 %
#: in each direction every third exchange fails.
ANSWER_TIMEOUT, ATTEMPTS, ATTEMPTS_IN_CONTACT = 0.5, 4, 12
#: Seconds to wait after each IN_PROGRESS; and in all.
PROGRESS, MAX_WAIT = 5.0, 60.0


class CommandResult(NamedTuple):
    """The MAV_RESULT of a command, None without an answer, and the number of transmissions."""

    result: int | None
    attempts: int


async def _no_gate(_: int) -> None:
    """Permits every command."""


class Exchange:
    """The pending commands of a station to one vehicle, both by their system ids.

    `send` takes a message, `has_contact` returns whether messages of the vehicle arrive. `gate` is awaited
    before each command, with its number; it raises DeviceError if the command may not be sent. `px4` is set
    when the autopilot is known: for unused parameters PX4 requires NaN, ArduPilot 0.
    """

    def __init__(
        self,
        system: int,
        station: int,
        send: Callable[[Any], None],
        has_contact: Callable[[], bool] = lambda: False,
        gate: Callable[[int], Awaitable[None]] = _no_gate,
    ) -> None:
        self.px4, self._station = False, station
        self._gate = gate
        self._system, self._send, self._has_contact = system, send, has_contact
        self._pending: dict[tuple[int, int], _PendingCommand] = {}
        self._timer: asyncio.Handle | None = None
        self._timer_at = 0.0

    def set_stack(self, *, px4: bool) -> None:
        """Sets whether the autopilot is PX4."""
        self.px4 = px4

    async def command(
        self,
        number: int,
        *values: float | None,
        place: Place | None = None,
        once: bool = False,
        answer_timeout: float = ANSWER_TIMEOUT,
        target: int = AUTOPILOT,
    ) -> CommandResult:
        """Sends a command until it is answered, ATTEMPTS times, or ATTEMPTS_IN_CONTACT times while there is
        contact.

        `values` are its parameters from the first, None for an unused one. With a `place` it is sent as
        COMMAND_INT, which has sufficient precision, with the place as parameters 5 to 7. `once` is for a
        command that must not be executed twice. `answer_timeout` is the time to wait for each answer, in
        seconds. `target` is the addressed component.
        """
        await self._gate(number)
        # Acknowledgements are matched by sender and command number: one command of these may be pending.
        key = (target, number)
        while (previous := self._pending.get(key)) is not None:
            await previous.end()
        loop = asyncio.get_running_loop()
        pending = self._pending[key] = _PendingCommand()
        attempts = 0
        try:
            while attempts < self._max_attempts(once):
                if place is None:
                    message = self._command_long(key, attempts, values)
                else:
                    message = self._command_int(key, values, place)
                attempts += 1
                pending.on_sent(loop.create_future(), loop.time(), answer_timeout)
                self._set_timer(pending)
                self._send(message)
                result = await pending.result
                if result is not None:
                    return CommandResult(result, attempts)
            return CommandResult(None, attempts)
        finally:
            del self._pending[key]
            pending.release_next()

    def _max_attempts(self, once: bool) -> int:
        """Attempts for a command."""
        return 1 if once else ATTEMPTS_IN_CONTACT if self._has_contact() else ATTEMPTS

    def _set_timer(self, pending: _PendingCommand) -> None:
        """Schedules a check at the deadline of this command; an earlier timer is kept.

        Most commands are answered at once and need no timer of their own.
        """
        if self._timer is not None:
            if self._timer_at <= pending.due:
                return
            self._timer.cancel()
        # Stored here: uvloop does not report the due time of a timer with less than half a millisecond left.
        self._timer_at = pending.due
        self._timer = asyncio.get_running_loop().call_at(pending.due, self._expire)

    def _expire(self) -> None:
        """Ends the wait for overdue answers."""
        self._timer = None
        now = asyncio.get_running_loop().time()
        for pending in self._pending.values():
            if pending.due <= now:
                pending.finish(None)
            elif not pending.result.done():
                self._set_timer(pending)

    def on_message(self, message: Any) -> None:
        """Handles an answer; answers to other stations are ignored."""
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_ACK:
            pending = self._pending.get((message.get_srcComponent(), message.command))
            if pending is not None and is_for_us(message, self._station):
                pending.on_answer(message.result, asyncio.get_running_loop().time())

    def _command_long(self, key: tuple[int, int], confirmation: int, values: tuple[float | None, ...]) -> Any:
        padded = self._padded(values, 7)
        return dialect.MAVLink_command_long_message(self._system, *key, confirmation, *padded)

    def _command_int(self, key: tuple[int, int], values: tuple[float | None, ...], place: Place) -> Any:
        target, number = key
        x, y = round(place.latitude * 1e7), round(place.longitude * 1e7)
        return dialect.MAVLink_command_int_message(
            self._system,
            target,
            dialect.MAV_FRAME_GLOBAL,
            number,
            0,
            0,
            *self._padded(values, 4),
            x,
            y,
            place.altitude,
        )

    def _padded(self, values: tuple[float | None, ...], length: int) -> list[float]:
        unused = math.nan if self.px4 else 0.0
        padded = values + (None,) * (length - len(values))
        return [unused if value is None else value for value in padded]


def is_for_us(message: Any, station: int) -> bool:
    """Whether a message is a broadcast or addressed to the station with this system id."""
    system, component = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
    return system in (0, station) and component in (0, COMPONENT)


class _PendingCommand:
    """A command that waits for its answer until `due`; `result` is None on a time-out."""

    result: asyncio.Future[int | None]
    due: float

    def __init__(self) -> None:
        self._waiting: list[asyncio.Future[None]] = []

    def on_sent(self, result: asyncio.Future[int | None], now: float, answer_timeout: float) -> None:
        """Sets the deadline after the command was sent again."""
        self.result, self.due, self._latest = result, now + answer_timeout, now + MAX_WAIT

    def on_answer(self, result: int, now: float) -> None:
        """Handles an answer; IN_PROGRESS only extends the time."""
        if result == dialect.MAV_RESULT_IN_PROGRESS:
            self.due = min(now + PROGRESS, self._latest)
        else:
            self.finish(result)

    def finish(self, result: int | None) -> None:
        """Sets the result; later ones are ignored."""
        if not self.result.done():
            self.result.set_result(result)

    def end(self) -> asyncio.Future[None]:
        """A future that is done when the command is no longer pending."""
        self._waiting.append(asyncio.get_running_loop().create_future())
        return self._waiting[-1]

    def release_next(self) -> None:
        """Starts the next command of the same number."""
        for waiting in self._waiting:
            if not waiting.done():
                waiting.set_result(None)
