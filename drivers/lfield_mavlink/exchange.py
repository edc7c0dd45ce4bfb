"""Questions to one vehicle that want an answer: commands and parameters, with retries.

An answer says that a command was taken, never that it was achieved; the caller watches the state for that.
"""

from __future__ import annotations

import asyncio
import math
import struct
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lfield_mavlink.dialect import AUTOPILOT, COMPONENT, SYSTEM, dialect
from lfield_mavlink.geo import Place

#: Seconds to wait for an answer, and how often to ask again.
PATIENCE, RETRIES = 0.5, 3
#: Seconds to wait after an IN_PROGRESS, each time; and in all.
PROGRESS, LONGEST = 5.0, 60.0

#: How PX4 packs whole numbers into the float of a parameter, by MAV_PARAM_TYPE (the 8 and 16 bit types are
#: widened to 32 bits by sign, so that they fill the four bytes).
_INTEGERS = {1: "<I", 2: "<i", 3: "<I", 4: "<i", 5: "<I", 6: "<i"}


@dataclass(frozen=True, slots=True)
class Answer:
    """The MAV_RESULT of a command, None when nobody answered, and how often it was sent."""

    result: int | None
    attempts: int


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter's value as a number, and its MAV_PARAM_TYPE."""

    value: float
    type: int


class Exchange:
    """The open questions to one vehicle; `send` takes a message.

    `px4` is set when the autopilot is known: PX4 wants NaN for what is not used, ArduPilot 0; and PX4 packs
    whole numbers into parameters byte by byte.
    """

    def __init__(self, system: int, send: Callable[[Any], None]) -> None:
        self.px4 = False
        self._system, self._send = system, send
        # Acknowledgements are matched by command number, so each number has one question open at a time.
        self._locks: defaultdict[int, asyncio.Lock] = defaultdict(asyncio.Lock)
        self._acks: dict[int, asyncio.Queue[int]] = {}
        self._parameters: defaultdict[str, list[asyncio.Future[Parameter]]] = defaultdict(list)

    async def command(
        self, number: int, *values: float | None, place: Place | None = None, once: bool = False
    ) -> Answer:
        """Send a command until it is answered, RETRIES + 1 times at most.

        `values` are its parameters from the first on, None for one that is not used. With a `place` it goes
        out as a COMMAND_INT, which has the precision for it, and the place is parameters 5 to 7. `once` is
        for a command that would act twice if only its answer was lost.
        """
        attempts = 1 if once else RETRIES + 1
        async with self._locks[number]:
            acks = self._acks[number] = asyncio.Queue()
            try:
                for confirmation in range(attempts):
                    if place is None:
                        self._send(self._command_long(number, confirmation, values))
                    else:
                        self._send(self._command_int(number, values, place))
                    result = await _final(acks)
                    if result is not None:
                        return Answer(result, confirmation + 1)
                return Answer(None, attempts)
            finally:
                del self._acks[number]

    async def parameter(self, name: str) -> Parameter | None:
        """A parameter; None when nobody answered, as for a name that does not exist."""
        question = dialect.MAVLink_param_request_read_message(self._system, AUTOPILOT, name.encode(), -1)
        return await self._ask_parameter(name, question)

    async def set_parameter(self, name: str, value: float) -> Parameter | None:
        """Set a parameter that was read before to know its type; what it now is, or None."""
        present = await self.parameter(name)
        if present is None:
            return None
        packed = pack_parameter(value, present.type) if self.px4 else value
        message = dialect.MAVLink_param_set_message(
            self._system, AUTOPILOT, name.encode(), packed, present.type
        )
        return await self._ask_parameter(name, message)

    async def _ask_parameter(self, name: str, question: Any) -> Parameter | None:
        future: asyncio.Future[Parameter] = asyncio.get_running_loop().create_future()
        self._parameters[name].append(future)
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
            self._parameters[name].remove(future)

    def on_message(self, message: Any) -> None:
        """Hand an answer to whoever waits for it; answers to others are left alone."""
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_ACK:
            acks = self._acks.get(message.command)
            if acks is not None and is_for_us(message):
                acks.put_nowait(message.result)
        elif message.get_msgId() == dialect.MAVLINK_MSG_ID_PARAM_VALUE:
            if message.param_id not in self._parameters:
                return
            value = message.param_value
            if self.px4:
                value = unpack_parameter(value, message.param_type)
            for future in self._parameters[message.param_id]:
                if not future.done():
                    future.set_result(Parameter(value, message.param_type))

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
        given = [unused if value is None else value for value in values]
        return given + [unused] * (length - len(given))


def pack_parameter(value: float, kind: int) -> float:
    """A value as PX4 has it in the float of PARAM_SET: whole numbers as their bytes."""
    if kind not in _INTEGERS:
        return value
    packed: float = struct.unpack("<f", struct.pack(_INTEGERS[kind], round(value)))[0]
    return packed


def unpack_parameter(value: float, kind: int) -> float:
    """The number in the float of PX4's PARAM_VALUE."""
    if kind not in _INTEGERS:
        return value
    return float(struct.unpack(_INTEGERS[kind], struct.pack("<f", value))[0])


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
