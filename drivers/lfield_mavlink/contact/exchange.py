"""Commands to one vehicle, repeated until they are answered.

An answer says that a command was taken, never that it was achieved; the caller watches the state for that.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

from lfield_mavlink.geo import Place
from lfield_mavlink.link.dialect import AUTOPILOT, COMPONENT, dialect

#: Seconds to wait for an answer, and how often to ask. One that is heard meanwhile is asked longer: at a loss
#: of 20 % each way every third question has no answer.
PATIENCE, ATTEMPTS, PERSISTENT = 0.5, 4, 12
#: Seconds to wait after an IN_PROGRESS, each time; and in all.
PROGRESS, LONGEST = 5.0, 60.0


class Answer(NamedTuple):
    """The MAV_RESULT of a command, None when nobody answered, and how often it was sent."""

    result: int | None
    attempts: int


async def _no_gate(_: int) -> None:
    """Every command may go out."""


class Exchange:
    """The open questions of a station to one vehicle, both by their system ids.

    `send` takes a message, `heard` says whether the vehicle is heard. `gate` is awaited before each command,
    with its number; it raises DeviceError when it may not go out.
    `px4` is set when the autopilot is known: PX4 wants NaN for what is not used, ArduPilot 0.
    """

    def __init__(
        self,
        system: int,
        station: int,
        send: Callable[[Any], None],
        heard: Callable[[], bool] = lambda: False,
        gate: Callable[[int], Awaitable[None]] = _no_gate,
    ) -> None:
        self.px4, self._station = False, station
        self._gate = gate
        self._system, self._send, self._heard = system, send, heard
        self._questions: dict[int, _Question] = {}
        self._timer: asyncio.Handle | None = None
        self._timer_at = 0.0

    async def command(
        self,
        number: int,
        *values: float | None,
        place: Place | None = None,
        once: bool = False,
        patience: float = PATIENCE,
    ) -> Answer:
        """Send a command until it is answered, ATTEMPTS times, and PERSISTENT times while it is heard.

        `values` are its parameters from the first on, None for one that is not used. With a `place` it goes
        out as a COMMAND_INT, which has the precision for it, and the place is parameters 5 to 7. `once` is
        for a command that would act twice if only its answer was lost. `patience` is how many seconds an
        answer is waited for each time.
        """
        await self._gate(number)
        # Acknowledgements are matched by command number, so each number has one question open at a time.
        while (earlier := self._questions.get(number)) is not None:
            await earlier.end()
        loop = asyncio.get_running_loop()
        question = self._questions[number] = _Question()
        attempts = 0
        try:
            while attempts < self._most(once):
                if place is None:
                    message = self._command_long(number, attempts, values)
                else:
                    message = self._command_int(number, values, place)
                attempts += 1
                question.ask(loop.create_future(), loop.time(), patience)
                self._set_timer(question)
                self._send(message)
                result = await question.result
                if result is not None:
                    return Answer(result, attempts)
            return Answer(None, attempts)
        finally:
            del self._questions[number]
            question.over()

    def _most(self, once: bool) -> int:
        """How often a command is sent."""
        return 1 if once else PERSISTENT if self._heard() else ATTEMPTS

    def _set_timer(self, question: _Question) -> None:
        """Look at the questions again when this one is due; a timer that is early enough is left alone.

        So most commands, which are answered at once, come and go without a timer of their own.
        """
        if self._timer is not None:
            if self._timer_at <= question.due:
                return
            self._timer.cancel()
        # Kept here: uvloop's handle of a timer that is due within half a millisecond cannot say when.
        self._timer_at = question.due
        self._timer = asyncio.get_running_loop().call_at(question.due, self._give_up)

    def _give_up(self) -> None:
        """Nobody waits any more for an answer that is overdue."""
        self._timer = None
        now = asyncio.get_running_loop().time()
        for question in self._questions.values():
            if question.due <= now:
                question.finish(None)
            elif not question.result.done():
                self._set_timer(question)

    def on_message(self, message: Any) -> None:
        """Hand an answer to whoever waits for it; answers to others are left alone."""
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_ACK:
            question = self._questions.get(message.command)
            if question is not None and is_for_us(message, self._station):
                question.answer(message.result, asyncio.get_running_loop().time())

    def _command_long(self, number: int, confirmation: int, values: tuple[float | None, ...]) -> Any:
        padded = self._padded(values, 7)
        return dialect.MAVLink_command_long_message(self._system, AUTOPILOT, number, confirmation, *padded)

    def _command_int(self, number: int, values: tuple[float | None, ...], place: Place) -> Any:
        x, y = round(place.latitude * 1e7), round(place.longitude * 1e7)
        return dialect.MAVLink_command_int_message(
            self._system,
            AUTOPILOT,
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
    """Whether a message is for everybody, or for the ground station with this system id."""
    system, component = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
    return system in (0, station) and component in (0, COMPONENT)


class _Question:
    """A command that waits for its answer, until it is `due`; `result` is None when it came too late."""

    result: asyncio.Future[int | None]
    due: float

    def __init__(self) -> None:
        self._waiting: list[asyncio.Future[None]] = []

    def ask(self, result: asyncio.Future[int | None], now: float, patience: float) -> None:
        """It is sent, once more."""
        self.result, self.due, self._latest = result, now + patience, now + LONGEST

    def answer(self, result: int, now: float) -> None:
        """An answer has come; IN_PROGRESS only gives it more time."""
        if result == dialect.MAV_RESULT_IN_PROGRESS:
            self.due = min(now + PROGRESS, self._latest)
        else:
            self.finish(result)

    def finish(self, result: int | None) -> None:
        """The first result is the one that counts."""
        if not self.result.done():
            self.result.set_result(result)

    def end(self) -> asyncio.Future[None]:
        """Done when nobody asks it any more."""
        self._waiting.append(asyncio.get_running_loop().create_future())
        return self._waiting[-1]

    def over(self) -> None:
        """Let those go on who have a question of the same number, the first come first."""
        for waiting in self._waiting:
            if not waiting.done():
                waiting.set_result(None)
