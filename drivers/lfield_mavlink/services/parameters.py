"""The parameters of an autopilot: read by name, set and seen to be set, listed without gaps.

https://mavlink.io/en/services/parameter.html. Measured: an unknown name is answered with silence by both
ArduPilot and PX4, so "no answer" is how it is told.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from typing import Any

from lfield_mavlink.link.dialect import AUTOPILOT, dialect
from lfield_mavlink.services.parameter_values import (
    NAME_LENGTH,
    Encoding,
    decode,
    encode,
    param_set,
    raw_value,
)
from lfield_mavlink.services.peer import Inbox, Mail, Peer

#: Seconds to wait for an answer, and how often to ask: on a bad radio every third question has no answer, and
#: it is silence that says that there is no such name.
PATIENCE, QUESTIONS = 0.2, 15
#: Seconds of silence after which a list has ended, and how many of its gaps are asked for at a time.
LIST_SILENCE, GAPS = 1.0, 50
#: Rounds of asking for gaps in which nothing comes before a list has failed, and the longest it may take.
ROUNDS, LONGEST = 6, 180.0


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter as the autopilot told it; `kind` is its MAV_PARAM_TYPE."""

    name: str
    value: int | float
    kind: int


class Parameters:
    """The parameters of one vehicle. `encoding` finds out how it sends integers; it is asked once."""

    def __init__(self, peer: Peer, encoding: Callable[[], Awaitable[Encoding]]) -> None:
        self._peer, self._find_encoding = peer, encoding
        self._encoding: Encoding | None = None
        self._finding = asyncio.Lock()
        self._inbox = Inbox(peer, dialect.MAVLINK_MSG_ID_PARAM_VALUE)
        self._writing = asyncio.Lock()

    async def read(self, name: str) -> int | float | None:
        """The value; None when nobody answered within 3 s, as for a name that does not exist.

        Raises DeviceError for what cannot be a name.
        """
        found = await self._read(name)
        return None if found is None else found.value

    async def read_any(self, names: Iterable[str]) -> tuple[str, float | None]:
        """Ask for all names that one parameter has by version; the first that is answered for, and its value.

        ("", None) when none is. Raises DeviceError.
        """

        async def ask(name: str) -> tuple[str, float | None]:
            return name, await self.read(name)

        asking = [asyncio.ensure_future(ask(name)) for name in names]
        try:
            for answer in asyncio.as_completed(asking):
                name, present = await answer
                if present is not None:
                    return name, present
        finally:
            for question in asking:
                question.cancel()
        return "", None

    async def write(self, name: str, value: float) -> None:
        """Set a parameter; returns when the autopilot has told the new value. Raises DeviceError."""
        found = await self._read(name)
        if found is None:
            raise self.unknown(name)
        async with self._writing:
            await self._write(found, value, await self._known_encoding())

    async def read_all(self) -> dict[str, int | float]:
        """Every parameter by its name; what was lost on the way is asked for again. Raises DeviceError."""
        encoding = await self._known_encoding()
        with self._inbox.open() as mail:
            return await self._read_all(mail, encoding)

    def unknown(self, name: str) -> Exception:
        """The exception for a parameter that is not answered for."""
        return self._peer.error(
            f"no answer about a parameter {name} in {PATIENCE * QUESTIONS:g} s; does it have that name?"
        )

    async def _known_encoding(self) -> Encoding:
        async with self._finding:
            if self._encoding is None:
                self._encoding = await self._find_encoding()
            return self._encoding

    async def _read(self, name: str) -> Parameter | None:
        if not (0 < len(name) <= NAME_LENGTH and name.isascii() and name.isprintable()):
            raise self._peer.error(f"'{name}' cannot be a parameter: 1 to {NAME_LENGTH} ASCII characters")
        encoding = await self._known_encoding()
        ask = dialect.MAVLink_param_request_read_message(self._peer.system, AUTOPILOT, name.encode(), -1)
        with self._inbox.open() as mail:
            for _ in range(QUESTIONS):
                self._peer.send(ask)
                message = await mail.find(lambda m: _parameter(m, encoding, name) is not None, PATIENCE)
                if message is not None:
                    return _parameter(message, encoding, name)
        return None

    async def _write(self, old: Parameter, value: float, encoding: Encoding) -> None:
        try:
            raw = encode(value, old.kind, encoding)
        except ValueError as error:
            raise self._peer.error(f"{old.name}: {error}") from None
        wanted = decode(raw, old.kind, encoding)
        told: list[Parameter] = []

        def is_set(message: Any) -> bool:
            # An answer to an earlier question may come late: only the wanted value ends the wait.
            if (now := _parameter(message, encoding, old.name)) is not None:
                told.append(now)
            return now is not None and now.value == wanted

        with self._inbox.open() as mail:
            for _ in range(QUESTIONS):
                self._peer.send(param_set(self._peer.system, old.name, raw, old.kind))
                if await mail.find(is_set, PATIENCE) is not None:
                    return
        if told:
            raise self._peer.error(f"{old.name} could not be set to {value:g}: it is {told[-1].value:g}")
        raise self._peer.error(f"{old.name}: no answer to setting it to {value:g}", timeout=True)

    async def _read_all(self, mail: Mail, encoding: Encoding) -> dict[str, int | float]:
        listed: dict[int, Parameter] = {}
        count = 0
        self._peer.send(dialect.MAVLink_param_request_list_message(self._peer.system, AUTOPILOT))
        idle, now = 0, asyncio.get_running_loop().time
        end = now() + LONGEST
        while idle < ROUNDS and now() < end:
            message = await mail.next(LIST_SILENCE)
            if message is None:
                idle += 1
                self._ask_for_gaps(listed, count)
                continue
            parameter = _parameter(message, encoding)
            # What is sent for another reason than the list has no place in it (index 65535).
            if parameter is not None and message.param_index < message.param_count:
                idle = idle if message.param_index in listed else 0
                listed[message.param_index], count = parameter, message.param_count
            if count and len(listed) >= count:
                return {parameter.name: parameter.value for parameter in listed.values()}
        heard = f"{len(listed)} of {count} parameters" if count else "nothing"
        raise self._peer.error(f"listing the parameters: {heard} came", timeout=True)

    def _ask_for_gaps(self, listed: dict[int, Parameter], count: int) -> None:
        if not count:
            self._peer.send(dialect.MAVLink_param_request_list_message(self._peer.system, AUTOPILOT))
            return
        gaps = [index for index in range(count) if index not in listed]
        for index in gaps[:GAPS]:
            self._peer.send(
                dialect.MAVLink_param_request_read_message(self._peer.system, AUTOPILOT, b"", index)
            )


def _parameter(message: Any, encoding: Encoding, name: str = "") -> Parameter | None:
    """The parameter in a PARAM_VALUE; None when it is another than `name`, or no value."""
    if name and message.param_id != name:
        return None
    value = decode(raw_value(message), message.param_type, encoding)
    return None if value is None else Parameter(message.param_id, value, message.param_type)
