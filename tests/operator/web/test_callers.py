"""Limits of unauthenticated connections to the page's socket; authenticated ones stay."""

from __future__ import annotations

import asyncio
import random
import socket
from collections.abc import Awaitable, Callable
from contextlib import suppress

import pytest

from lfield.operator.web.accept_limiter import MAX_CALLERS, AcceptLimiter

# : Seconds for anything that depends on the load of the machine.
TIMEOUT = 60.0
# : The time limit of an unauthenticated connection; no other timer of a test is as long.
HELD = 1234.5


class Echo(asyncio.Protocol):
    """Sends back what it receives."""

    def connection_made(self, transport) -> None:
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self.transport.write(data)


class Caller:
    """A client that was accepted and has received an answer."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self.writer = reader, writer
        self.peer = writer.get_extra_info("sockname")

    async def heard(self) -> bool:
        """Return true if the other end is still connected."""
        try:
            self.writer.write(b"?")
            return await asyncio.wait_for(self._reader.read(1), TIMEOUT) == b"?"
        except OSError:
            return False

    async def gone(self) -> None:
        """Wait until the other end has closed the connection."""
        with suppress(ConnectionError):
            assert await asyncio.wait_for(self._reader.read(1), TIMEOUT) == b""


def tried(scenario: Callable[..., Awaitable[None]]) -> None:
    """Run a test with connections to a socket.

    `call` opens an accepted connection, `late` expires the limit of unauthenticated ones.
    """

    async def run() -> None:
        loop, timers = asyncio.get_running_loop(), []
        usual = loop.call_later

        def call_later(seconds, what, *arguments, **more):
            if seconds != HELD:
                return usual(seconds, what, *arguments, **more)
            timers.append((what, arguments))

        def late() -> None:
            for what, words in timers:
                what(*words)

        with socket.create_server(("127.0.0.1", 0)) as opened:
            callers = AcceptLimiter(None, random.Random(1), HELD)
            callers.start(Echo)
            name = opened.getsockname()
            taking = await callers.serve(opened)
            made: list[Caller] = []

            async def call() -> Caller:
                made.append(Caller(*await asyncio.open_connection(*name)))
                assert await made[-1].heard()
                return made[-1]

            loop.call_later = call_later
            try:
                await scenario(callers, call, late)
            finally:
                taking.close()
                for caller in made:
                    caller.writer.close()

    asyncio.run(run())


@pytest.fixture(scope="session")
def runner():
    return tried


async def test_unauthenticated_connections_are_closed_and_authenticated_stay(callers, call, late, /):
    guest, stranger = await call(), await call()
    callers.on_authenticated(guest.peer)
    late()
    await stranger.gone()
    assert await guest.heard()
    later = await call()
    late()
    await later.gone()


async def test_unauthenticated_connections_are_limited_and_the_oldest_is_closed(callers, call, late, /):
    guest = await call()
    callers.on_authenticated(guest.peer)
    strangers = [await call() for _ in range(3 * MAX_CALLERS)]
    still = [stranger for stranger in strangers if await stranger.heard()]
    assert len(still) == MAX_CALLERS
    assert strangers[-1] in still
    assert await guest.heard()


async def test_a_closed_connection_leaves_no_state(callers, call, late, /):
    for _ in range(3):
        caller = await call()
        caller.writer.close()
        callers.on_authenticated(caller.peer)
        callers.on_authenticated(caller.peer)
    late()
    assert await (await call()).heard()
