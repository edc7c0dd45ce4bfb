"""Questions to one vehicle that want an answer: commands and parameters, with retries.

An answer says that a command was taken, never that it was achieved; the caller watches the state for that.
"""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lfield_mavlink.dialect import AUTOPILOT, COMPONENT, SYSTEM, dialect

#: Seconds to wait for an answer, and how often to ask again.
PATIENCE, RETRIES = 0.5, 3
#: Seconds to wait after an IN_PROGRESS, each time; and in all.
PROGRESS, LONGEST = 5.0, 60.0


@dataclass(frozen=True, slots=True)
class Answer:
    """The MAV_RESULT of a command, None when nobody answered, and how often it was sent."""

    result: int | None
    attempts: int


class Exchange:
    """The open questions to one vehicle; `send` takes a message."""

    def __init__(self, system: int, send: Callable[[Any], None]) -> None:
        self._system, self._send = system, send
        # Acknowledgements are matched by command number, so each number has one question open at a time.
        self._locks: defaultdict[int, asyncio.Lock] = defaultdict(asyncio.Lock)
        self._acks: dict[int, asyncio.Queue[int]] = {}
        self._parameters: dict[str, asyncio.Future[float]] = {}

    async def command(self, number: int, *values: float) -> Answer:
        """Send a command until it is answered, RETRIES + 1 times at most."""
        async with self._locks[number]:
            acks = self._acks[number] = asyncio.Queue()
            try:
                for confirmation in range(RETRIES + 1):
                    self._send(self._command_long(number, confirmation, values))
                    result = await _final(acks)
                    if result is not None:
                        return Answer(result, confirmation + 1)
                return Answer(None, RETRIES + 1)
            finally:
                del self._acks[number]

    async def parameter(self, name: str) -> float | None:
        """The value of a parameter; None when nobody answered, as for a name that does not exist."""
        future = self._parameters.setdefault(name, asyncio.get_running_loop().create_future())
        question = dialect.MAVLink_param_request_read_message(self._system, AUTOPILOT, name.encode(), -1)
        try:
            for _ in range(RETRIES + 1):
                self._send(question)
                try:
                    async with asyncio.timeout(PATIENCE):
                        return await asyncio.shield(future)
                except TimeoutError:
                    continue
            return None
        finally:
            self._parameters.pop(name, None)

    def on_message(self, message: Any) -> None:
        """Hand an answer to whoever waits for it; answers to others are left alone."""
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_ACK:
            acks = self._acks.get(message.command)
            if acks is not None and is_for_us(message):
                acks.put_nowait(message.result)
        elif message.get_msgId() == dialect.MAVLINK_MSG_ID_PARAM_VALUE:
            future = self._parameters.get(message.param_id)
            if future is not None and not future.done():
                future.set_result(message.param_value)

    def _command_long(self, number: int, confirmation: int, values: tuple[float, ...]) -> Any:
        padded = (*values, *[0.0] * (7 - len(values)))
        return dialect.MAVLink_command_long_message(self._system, AUTOPILOT, number, confirmation, *padded)


def is_for_us(message: Any) -> bool:
    """Whether a message is for everybody, or for this ground station."""
    system, component = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
    return system in (0, SYSTEM) and component in (0, COMPONENT)


async def _final(acks: asyncio.Queue[int]) -> int | None:
    """The result that ends a command; None when it is time to ask again."""
    patience = PATIENCE
    try:
        async with asyncio.timeout(LONGEST):
            while True:
                async with asyncio.timeout(patience):
                    result = await acks.get()
                if result != dialect.MAV_RESULT_IN_PROGRESS:
                    return result
                patience = PROGRESS
    except TimeoutError:
        return None
