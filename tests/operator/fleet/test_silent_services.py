"""Services that answer late or not at all, in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from lfield.authority.identity import ALL_RIGHTS, Identity
from lfield.errors import AddressError
from lfield.operator.fleet.service_link import CONTACT, SILENCE, ServiceLink, ServiceLinks
from lfield.simulate.jumping_loop import run_jumping
from lfield.wire.messages import Hello, Message, Ping, Pong
from lfield.wire.service_messages import CommandResult, MissionCommand, RunInfo

STOP = MissionCommand("stop")
#: Seconds for an order, as those of `lfield stop`.
LONG = 300.0


class RobotLink:
    """A link to a robot that leaves the network at `gone`, and has stopped after `busy` seconds."""

    peer = "bravo"
    identity = Identity("host", "bravo", ALL_RIGHTS)

    def __init__(self, busy: float, gone: float = LONG) -> None:
        self._busy, self._gone = busy, gone
        self.handler: Any = None

    def send(self, message: Message) -> None:
        if asyncio.get_running_loop().time() - 1000.0 < self._gone:
            if isinstance(message, Ping):
                self._answer(0.1, Pong(message.token))
            elif isinstance(message, MissionCommand):
                self._answer(self._busy, CommandResult(RunInfo()))

    def _answer(self, delay: float, message: Message) -> None:
        queue = self.handler
        asyncio.get_running_loop().call_later(delay, lambda: queue.on_message(self, message))

    def accept_role(self, role: str) -> None:
        pass


async def stopped(link: RobotLink) -> float:
    """The time of the robot's answer (s)."""
    handler = ServiceLink("bravo", None)
    link.handler = handler
    handler.greet(link)  # type: ignore[arg-type]
    handler.on_message(link, Hello("host", "bravo", 1))  # type: ignore[arg-type]
    await handler.ask(STOP, CommandResult, LONG)
    return asyncio.get_running_loop().time() - 1000.0


def test_a_long_order_is_waited_for() -> None:
    assert run_jumping(stopped(RobotLink(busy=120.0))) == pytest.approx(120.0)


def test_a_robot_that_leaves_the_network_during_an_order_is_reported() -> None:
    async def scenario() -> float:
        with pytest.raises(AddressError):
            await stopped(RobotLink(busy=120.0, gone=20.0))
        return asyncio.get_running_loop().time() - 1000.0

    assert run_jumping(scenario()) < 20.0 + 3 * SILENCE


class SilentLinks(ServiceLinks):
    """A port that accepts connections, at which each handshake fails."""

    def __init__(self) -> None:
        super().__init__(None, {"bravo": "bravo"}, None)  # type: ignore[arg-type]

    @asynccontextmanager
    async def link(self, host: str) -> AsyncIterator[Any]:
        await asyncio.sleep(SILENCE)
        raise AddressError(host, "no answer within 8 s")
        yield


def test_an_unreachable_robot_is_reported_before_the_time_of_the_order_ends() -> None:
    async def scenario() -> float:
        with pytest.raises(AddressError, match="no answer within 8 s"):
            await SilentLinks().ask("bravo", STOP, CommandResult, LONG, LONG)
        return asyncio.get_running_loop().time() - 1000.0

    assert CONTACT <= run_jumping(scenario()) < CONTACT + 2 * SILENCE
