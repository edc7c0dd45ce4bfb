"""MAVLink parameter protocol: read by name, verified write, complete list.

https://mavlink.io/en/services/parameter.html. Measured: ArduPilot and PX4 do not answer for an unknown name,
so a time-out means that.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from typing import Any

from msgspec import Struct

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

#: Seconds to wait for an answer, and attempts: on a bad radio every third request has no answer, and silence
#: means an unknown name.
ANSWER_TIMEOUT, ATTEMPTS = 0.2, 15
#: Seconds of silence after which a list has ended, and the number of gaps requested at a time.
LIST_SILENCE, GAPS = 1.0, 50
#: Rounds without an answer before a list has failed, and its longest time in seconds.
ROUNDS, MAX_LIST_TIME = 6, 180.0


class Parameter(Struct, frozen=True):
    """A received parameter; `kind` is its MAV_PARAM_TYPE."""

    name: str
    value: int | float
    kind: int


class Parameters:
    """The parameters of one vehicle. `encoding` determines how it sends integers; called once."""

    def __init__(self, peer: Peer, encoding: Callable[[], Awaitable[Encoding]]) -> None:
        self._peer, self._request_encoding = peer, encoding
        self._encoding: Encoding | None = None
        self._encoding_lock = asyncio.Lock()
        self._inbox = Inbox(peer, dialect.MAVLINK_MSG_ID_PARAM_VALUE)
        self._write_lock = asyncio.Lock()

    async def read(self, name: str) -> int | float | None:
        """The value; None without an answer within 3 s, as for an unknown name.

        Raises DeviceError for an invalid name.
        """
        parameter = await self._read(name)
        return None if parameter is None else parameter.value

    async def read_any(self, names: Iterable[str]) -> tuple[str, float | None]:
        """Requests all names of a parameter by version; the first that is answered, with its value.

        ("", None) if none is. Raises DeviceError.
        """

        async def ask(name: str) -> tuple[str, float | None]:
            return name, await self.read(name)

        requests = [asyncio.ensure_future(ask(name)) for name in names]
        try:
            for answer in asyncio.as_completed(requests):
                name, present = await answer
                if present is not None:
                    return name, present
        finally:
            for request in requests:
                request.cancel()
        return "", None

    async def write(self, name: str, value: float) -> None:
        """Sets a parameter; returns when the autopilot has reported the new value. Raises DeviceError."""
        parameter = await self._read(name)
        if parameter is None:
            raise self.unknown(name)
        async with self._write_lock:
            await self._write(parameter, value, await self._known_encoding())

    async def read_all(self) -> dict[str, int | float]:
        """Every parameter by its name; lost ones are requested again. Raises DeviceError."""
        encoding = await self._known_encoding()
        with self._inbox.open() as mail:
            return await self._read_all(mail, encoding)

    def unknown(self, name: str) -> Exception:
        """The exception for a parameter without an answer."""
        return self._peer.error(
            f"no answer about a parameter {name} in {ANSWER_TIMEOUT * ATTEMPTS:g} s; is the name correct?"
        )

    async def _known_encoding(self) -> Encoding:
        async with self._encoding_lock:
            if self._encoding is None:
                self._encoding = await self._request_encoding()
            return self._encoding

    async def _read(self, name: str) -> Parameter | None:
        if not (0 < len(name) <= NAME_LENGTH and name.isascii() and name.isprintable()):
            raise self._peer.error(f"'{name}' is not a parameter name: 1 to {NAME_LENGTH} ASCII characters")
        encoding = await self._known_encoding()
        ask = dialect.MAVLink_param_request_read_message(self._peer.system, AUTOPILOT, name.encode(), -1)
        with self._inbox.open() as mail:
            for _ in range(ATTEMPTS):
                self._peer.send(ask)
                message = await mail.find(lambda m: _parameter(m, encoding, name) is not None, ANSWER_TIMEOUT)
                if message is not None:
                    return _parameter(message, encoding, name)
        return None

    async def _write(self, previous: Parameter, value: float, encoding: Encoding) -> None:
        try:
            raw = encode(value, previous.kind, encoding)
        except ValueError as error:
            raise self._peer.error(f"{previous.name}: {error}") from None
        expected = decode(raw, previous.kind, encoding)
        answers: list[Parameter] = []

        def is_set(message: Any) -> bool:
            # An answer to an earlier request may come late: only the new value ends the wait.
            if (answer := _parameter(message, encoding, previous.name)) is not None:
                answers.append(answer)
            return answer is not None and answer.value == expected

        with self._inbox.open() as mail:
            for _ in range(ATTEMPTS):
                self._peer.send(param_set(self._peer.system, previous.name, raw, previous.kind))
                if await mail.find(is_set, ANSWER_TIMEOUT) is not None:
                    return
        if answers:
            raise self._peer.error(
                f"{previous.name} could not be set to {value:g}: it is {answers[-1].value:g}"
            )
        raise self._peer.error(f"{previous.name}: no answer to setting it to {value:g}", timeout=True)

    async def _read_all(self, mail: Mail, encoding: Encoding) -> dict[str, int | float]:
        listed: dict[int, Parameter] = {}
        count = 0
        self._peer.send(dialect.MAVLink_param_request_list_message(self._peer.system, AUTOPILOT))
        silent_rounds, now = 0, asyncio.get_running_loop().time
        end = now() + MAX_LIST_TIME
        while silent_rounds < ROUNDS and now() < end:
            message = await mail.next(LIST_SILENCE)
            if message is None:
                silent_rounds += 1
                self._request_gaps(listed, count)
                continue
            parameter = _parameter(message, encoding)
            # Values sent for other reasons have no position in the list (index 65535).
            if parameter is not None and message.param_index < message.param_count:
                silent_rounds = silent_rounds if message.param_index in listed else 0
                listed[message.param_index], count = parameter, message.param_count
            if count and len(listed) >= count:
                return {parameter.name: parameter.value for parameter in listed.values()}
        received = f"{len(listed)} of {count} parameters" if count else "nothing"
        raise self._peer.error(f"listing the parameters: received {received}", timeout=True)

    def _request_gaps(self, listed: dict[int, Parameter], count: int) -> None:
        if not count:
            self._peer.send(dialect.MAVLink_param_request_list_message(self._peer.system, AUTOPILOT))
            return
        gaps = [index for index in range(count) if index not in listed]
        for index in gaps[:GAPS]:
            self._peer.send(
                dialect.MAVLink_param_request_read_message(self._peer.system, AUTOPILOT, b"", index)
            )


def _parameter(message: Any, encoding: Encoding, name: str = "") -> Parameter | None:
    """The parameter in a PARAM_VALUE; None if it is not `name`, or invalid."""
    if name and message.param_id != name:
        return None
    value = decode(raw_value(message), message.param_type, encoding)
    return None if value is None else Parameter(message.param_id, value, message.param_type)
