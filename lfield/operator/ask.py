"""Asks hosts for something, as somebody who is no host: their status, or an emergency stop."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

from lfield.errors import AddressError, GreetingError, LfieldError, WireError
from lfield.net.greeting import Greeting
from lfield.net.transport import Link, Transport
from lfield.wire.messages import (
    EmergencyStop,
    EmergencyStopped,
    Hello,
    Message,
    Status,
    StatusRequest,
    Transfer,
)

#: Seconds a host has for its answer; a stop takes as long as the devices take to confirm it.
BOUND, STOP_BOUND = 2.0, 8.0

#: What can be asked.
Request = StatusRequest | EmergencyStop
STATUS = StatusRequest()


class _Question:
    """The handler of one link: greets, asks, keeps the answer."""

    def __init__(self, request: Request) -> None:
        self._request = request
        self.greeting = Greeting(Hello("observer", "observer", 0))
        self.answer: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()

    def on_message(self, link: Link, message: Message) -> None:
        if self.greeting.peer is None:
            self.greeting.receive(message)
            link.send(self._request)
        elif isinstance(message, Status) and not self.answer.done():
            self.answer.set_result(message.data)
        elif isinstance(message, EmergencyStopped) and not self.answer.done():
            self.answer.set_result(dict(message.devices))

    def on_transfer(self, link: Link, header: Transfer, block: memoryview) -> None:
        raise WireError("a coordinator was sent to an observer")

    def on_oversize(self, link: Link, header: Transfer, size: int) -> None:
        raise WireError("a coordinator was sent to an observer")

    def on_closed(self, link: Link, error: LfieldError | None) -> None:
        if not self.answer.done():
            self.answer.set_exception(
                error or GreetingError(f"{link.peer} closed the link without an answer")
            )


async def ask(transport: Transport, address: str, request: Request = STATUS) -> dict[str, Any]:
    """The answer of the host at an address. Raises AddressError, GreetingError, WireError."""
    question = _Question(request)
    bound = BOUND if isinstance(request, StatusRequest) else STOP_BOUND
    link = await transport.connect(address, question)
    try:
        link.send(question.greeting.own)
        async with asyncio.timeout(bound):
            return await question.answer
    except TimeoutError:
        raise AddressError(address, f"no answer within {bound:g} s") from None
    finally:
        question.answer.cancel()
        link.close()


async def ask_all(
    transport: Transport, addresses: Mapping[str, str], request: Request = STATUS
) -> dict[str, dict[str, Any] | LfieldError]:
    """The answer of every host by name, or the error that stood in the way."""

    async def one(address: str) -> dict[str, Any] | LfieldError:
        try:
            return await ask(transport, address, request)
        except LfieldError as error:
            return error

    answers = await asyncio.gather(*(one(address) for address in addresses.values()))
    return dict(zip(addresses, answers, strict=True))
