"""A participant of the fabric can use a limited share of a process; a fake session passes its packets on."""

import asyncio
import itertools
from collections.abc import Callable

import pytest

from lfield.net.zenoh.config import ZenohConfig
from lfield.net.zenoh.endpoint import MAX_OPENED, MAX_RESETS, MAX_WAITING, ROOT, ZenohEndpoint
from lfield.net.zenoh.packets import Kind, Packet
from lfield.net.zenoh.send_window import MAX_SEGMENT

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")

COUNT = 4000
#: Seconds that a test may need on a busy computer; each second permits as many packets again.
SLOWNESS = 20
OPEN = Packet(Kind.OPEN, 0, 0, 0, b"").encode()
DATA = Packet(Kind.DATA, 0, 0, 0, bytes(100)).encode()


class FakeSession:
    """Records the subscriptions and the published packets."""

    def __init__(self, config, on_open, on_failure) -> None:
        self.subscribed: dict[str, Callable[[str, bytes], None]] = {}
        self.published: list[tuple[str, bytes]] = []
        self._handles = itertools.count()

    def subscribe(self, key, on_packet) -> int:
        self.subscribed[key] = on_packet
        return next(self._handles)

    def declare_token(self, key) -> int:
        return next(self._handles)

    def watch_tokens(self, key, on_end) -> int:
        return next(self._handles)

    def publish(self, key, data) -> None:
        self.published.append((key, data))

    publish_once = publish

    def forget(self, key) -> None:
        """Do nothing."""


@pytest.fixture
def runner(monkeypatch):
    monkeypatch.setattr("lfield.net.zenoh.session.ZenohSession", FakeSession)
    return lambda test: asyncio.run(test())


def endpoint_with_session() -> tuple[ZenohEndpoint, FakeSession]:
    endpoint = ZenohEndpoint(ZenohConfig(("tcp/127.0.0.1:1",)))
    (session,) = (value for value in vars(endpoint).values() if isinstance(value, FakeSession))
    return endpoint, session


async def processed() -> None:
    """Return when the loop has processed the waiting packets."""
    for _ in range(3):
        await asyncio.sleep(0)


async def test_a_flood_of_requests_opens_few_streams():
    endpoint, session = endpoint_with_session()
    pipes = []
    endpoint.listen("alpha", 8181, pipes.append)
    for number in range(COUNT):
        session.subscribed[f"{ROOT}/at/alpha/8181/*/*"](f"{ROOT}/at/alpha/8181/{number:x}/1", OPEN)
        await processed()
    assert MAX_OPENED <= len(pipes) <= SLOWNESS * MAX_OPENED


async def test_packets_of_unknown_streams_get_few_answers():
    _, session = endpoint_with_session()
    (key,) = (key for key in session.subscribed if key.startswith(f"{ROOT}/to/"))
    for number in range(COUNT):
        session.subscribed[key](key.replace("*/*", f"{number:x}/1"), DATA)
        await processed()
    assert MAX_RESETS <= len(session.published) <= SLOWNESS * MAX_RESETS


def test_packets_that_wait_for_the_loop_are_limited_and_long_ones_dropped(runner):
    """The packets arrive in a thread of Zenoh, which is not slowed down."""

    async def flood() -> tuple[int, int]:
        endpoint, session = endpoint_with_session()
        opened = []
        endpoint.listen("alpha", 8181, opened.append)
        receive = session.subscribed[f"{ROOT}/at/alpha/8181/*/*"]
        waiting: list[bytes] = []
        loop = asyncio.get_running_loop()
        loop.call_soon_threadsafe = lambda call, key, data: waiting.append(data)
        for number in range(COUNT):
            receive(f"{ROOT}/at/alpha/8181/{number:x}/1", bytes(MAX_SEGMENT))
        count = len(waiting)
        waiting.clear()
        receive(f"{ROOT}/at/alpha/8181/1/1", bytes(100 * MAX_SEGMENT))
        return count, len(waiting)

    count, long = runner(flood)
    assert 0 < count <= MAX_WAITING // MAX_SEGMENT + 1
    assert long == 0
