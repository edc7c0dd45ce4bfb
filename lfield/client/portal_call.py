"""A portal call of a person: finds the host of the agent, and repeats the call until it has its result.

Every attempt has the same id, so the host executes the call at most once.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Coroutine, Sequence
from contextlib import suppress
from typing import NamedTuple

import msgspec

from lfield.client.team_connection import TeamConnection
from lfield.errors import (
    AddressError,
    CallOutcomeUnknown,
    HandshakeError,
    LfieldError,
    NoListener,
    PortalCallRefused,
    PortalFailed,
    UsageError,
)
from lfield.operator.observer_link import Request, ask_with_retries, send_request
from lfield.text.suggestions import did_you_mean
from lfield.vm.person_calls.value_codec import UnsendableValue, decode_values, encode_values
from lfield.wire.fields import Label, Name
from lfield.wire.messages import TOO_MANY_OBSERVERS
from lfield.wire.order_messages import ID_SIZE
from lfield.wire.person_calls.portal_call_messages import (
    MAX_ARGUMENTS,
    MAX_LIMIT,
    PortalCallCancel,
    PortalCallRequest,
    PortalCallResult,
)

#: Seconds after the time limit of a call until which its result is asked for, and between two attempts.
EXTRA, RETRY_DELAY = 30.0, 0.2
#: Seconds for which a cancellation is repeated.
CANCEL_TIMEOUT = 10.0


#: The names of an agent and of a portal, as messages have them.
_names = msgspec.msgpack.Decoder(tuple[Name, Label])


class AgentPlace(NamedTuple):
    """The host of an agent, and the incarnation of that host."""

    host: str
    incarnation: int


class PortalCaller:
    """Calls portals of a team; `spawn` runs a task in the background.

    `is_assistant`: the calls are those of an AI assistant.
    """

    def __init__(
        self,
        connection: TeamConnection,
        spawn: Callable[[Coroutine[object, object, None]], None],
        *,
        is_assistant: bool = False,
    ) -> None:
        self._connection, self._spawn, self._is_assistant = connection, spawn, is_assistant
        self._places: dict[str, AgentPlace] = {}

    async def call(self, agent: str, portal: str, arguments: Sequence[object], timeout: float) -> object:
        """The value that a portal returns. Raises PortalCallError, UsageError, AddressError, HandshakeError.

        A cancellation of the task cancels the call.
        """
        if not 0.0 < timeout <= MAX_LIMIT:
            raise UsageError(f"a time limit is above 0 and at most {MAX_LIMIT:g} s, not {timeout!r}")
        try:
            _names.decode(msgspec.msgpack.encode((agent, portal)))
        except (msgspec.ValidationError, UnicodeEncodeError) as error:
            raise PortalCallRefused("a portal", "no-portal", f"its name is not valid: {error}") from None
        try:
            data = encode_values(arguments, MAX_ARGUMENTS)
        except UnsendableValue as error:
            raise PortalCallRefused(f"{agent}.{portal}", "arguments", str(error)) from None
        while True:
            place = self._places.get(agent) or await self._find(agent)
            id, by_assistant = secrets.token_bytes(ID_SIZE), self._is_assistant
            order = PortalCallRequest(id, place.incarnation, agent, portal, data, timeout, by_assistant)
            attempt = _Attempt(self._connection, place.host, order)
            try:
                result = await attempt.result()
            except asyncio.CancelledError:
                if attempt.is_sent:
                    self._spawn(attempt.cancel())
                raise
            if result.outcome == "unknown" and result.kind == "restarted" and attempt.number == 1:
                # The host has restarted since the last call; it has not received this one before.
                del self._places[agent]
                continue
            return _value(f"{agent}.{portal}", result)

    async def _find(self, agent: str) -> AgentPlace:
        """Find an agent by the status of the hosts. Raises PortalCallRefused, or the error of a host."""
        answers = await self._connection.snapshots()
        errors: list[LfieldError] = []
        for host, answer in answers.items():
            if isinstance(answer, LfieldError):
                errors.append(answer)
            elif answer.snapshot is not None:
                for each in answer.snapshot.agents:
                    self._places[each.id] = AgentPlace(host, answer.incarnation)
        if agent in self._places:
            return self._places[agent]
        if errors:
            raise errors[0]
        hint = did_you_mean(agent, sorted(self._places))
        reason = f"no host runs an agent of that name{f'; {hint}' if hint else ''}"
        raise PortalCallRefused(agent, "no-portal", reason)


def _value(portal: str, result: PortalCallResult) -> object:
    """The value of a result, or its error."""
    if result.outcome == "refused":
        raise PortalCallRefused(portal, result.kind, result.message)
    if result.outcome == "unknown":
        raise CallOutcomeUnknown(portal, result.kind, result.message)
    if result.outcome == "thrown":
        raise PortalFailed(portal, result.kind, result.message)
    try:
        (value,) = decode_values(result.value)
    except (UnsendableValue, ValueError) as error:
        raise PortalFailed(portal, "result", f"the result of the host cannot be read: {error}") from None
    return value


class _Attempt:
    """The attempts of one call, which all have the same id."""

    def __init__(self, connection: TeamConnection, host: str, order: PortalCallRequest) -> None:
        self._transport, self._locate, self._crl = connection.transport, connection.locate, connection.crl
        self._host, self._order = host, order
        #: The number of attempts that may have reached the host.
        self.number = 0

    @property
    def is_sent(self) -> bool:
        """Whether the host may have received the call."""
        return self.number > 0

    async def result(self) -> PortalCallResult:
        """The result of the host."""
        now = asyncio.get_running_loop().time
        end = now() + self._order.limit + EXTRA
        portal = f"{self._order.resource}.{self._order.portal}"
        while True:
            try:
                address = await self._locate(self._host)
                self.number += 1
                request = Request(self._order, PortalCallResult, max(0.1, end - now()))
                found = await send_request(self._transport, address, request, self._host, self._crl)
                if found.id == self._order.id:
                    return found
            except NoListener:
                # The host has received no message in this attempt.
                self.number -= 1
                if not self.number:
                    raise
            except HandshakeError as error:
                if TOO_MANY_OBSERVERS not in str(error):
                    # An earlier attempt may have started it, before the rights of the person ended.
                    kind = PortalCallRefused if self.number == 1 else CallOutcomeUnknown
                    raise kind(portal, "not-permitted", str(error)) from None
                self.number -= 1
            except AddressError as error:
                if now() >= end:
                    raise CallOutcomeUnknown(portal, "unreachable", str(error)) from None
            if now() >= end:
                raise CallOutcomeUnknown(portal, "unreachable", f"{self._host} has not answered")
            await asyncio.sleep(RETRY_DELAY)

    async def cancel(self) -> None:
        """Cancel the call on its host; after a time-out its time limit ends it."""
        request = Request(PortalCallCancel(self._order.id), PortalCallResult, CANCEL_TIMEOUT, is_retried=True)
        with suppress(LfieldError):
            address = await self._locate(self._host)
            await ask_with_retries(self._transport, address, request, self._host, self._crl)
