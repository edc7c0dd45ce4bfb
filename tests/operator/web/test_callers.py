"""How long strangers are held at the page's socket, and how many; and who stays."""

from __future__ import annotations

import asyncio
import random
import socket
from collections.abc import Awaitable, Callable
from contextlib import suppress

import pytest

from lfield.operator.web.accept_limiter import MAX_CALLERS, AcceptLimiter

#: Seconds for anything that is only a matter of time on a busy machine.
PATIENCE = 60.0
#: How long a stranger is held; no other timer of a test is as long.
HELD = 1234.5


class Echo(asyncio.Protocol):
    """Says what it hears."""

    def connection_made(self, transport) -> None:
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self.transport.write(data)


class Caller:
    """Somebody who has called, and was heard."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self.writer = reader, writer
        self.peer = writer.get_extra_info("sockname")

    async def heard(self) -> bool:
        """Whether the other end is still there."""
        try:
            self.writer.write(b"?")
            return await asyncio.wait_for(self._reader.read(1), PATIENCE) == b"?"
        except OSError:
            return False

    async def gone(self) -> None:
        """Until the other end has hung up."""
        with suppress(ConnectionError):
            assert await asyncio.wait_for(self._reader.read(1), PATIENCE) == b""


def tried(story: Callable[..., Awaitable[None]]) -> None:
    """A story of calls at a socket: `call` is one that was taken, `late` lets the strangers' time be over."""

    async def run() -> None:
        loop, timers = asyncio.get_running_loop(), []
        usual = loop.call_later

        def call_later(seconds, what, *words, **more):
            if seconds != HELD:
                return usual(seconds, what, *words, **more)
            timers.append((what, words))

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
                await story(callers, call, late)
            finally:
                taking.close()
                for caller in made:
                    caller.writer.close()

    asyncio.run(run())


@pytest.fixture(scope="session")
def runner():
    return tried


async def test_a_stranger_is_shown_out_and_who_is_known_stays(callers, call, late, /):
    guest, stranger = await call(), await call()
    callers.on_authenticated(guest.peer)
    late()
    await stranger.gone()
    assert await guest.heard()
    later = await call()
    late()
    await later.gone()


async def test_so_many_strangers_are_held_and_the_next_is_let_in(callers, call, late, /):
    guest = await call()
    callers.on_authenticated(guest.peer)
    strangers = [await call() for _ in range(3 * MAX_CALLERS)]
    still = [stranger for stranger in strangers if await stranger.heard()]
    assert len(still) == MAX_CALLERS
    assert strangers[-1] in still
    assert await guest.heard()


async def test_who_leaves_first_is_missed_by_nobody(callers, call, late, /):
    for _ in range(3):
        caller = await call()
        caller.writer.close()
        callers.on_authenticated(caller.peer)
        callers.on_authenticated(caller.peer)
    late()
    assert await (await call()).heard()
