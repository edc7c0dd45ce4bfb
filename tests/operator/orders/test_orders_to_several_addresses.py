"""Datagrams of an order go to each address of a host, also while the name of another address is resolved."""

from __future__ import annotations

import asyncio
import socket
import threading
from types import SimpleNamespace

import pytest

from lfield.operator.orders.order_datagrams import OrderDatagrams

SEND = SimpleNamespace(host="alpha", datagram=b"stop")


class Orders:
    """The part of an order's protocol that sends: once at the start, and when `again` is called."""

    results: dict[str, object] = {}
    unresponsive: frozenset[str] = frozenset()
    due = None

    def __init__(self) -> None:
        self._effects: list[SimpleNamespace] = []

    def start(self, now: float) -> None:
        self._effects.append(SEND)

    def finish(self, host: str) -> None:
        self._effects.append(SEND)

    def drain_effects(self) -> list[SimpleNamespace]:
        effects, self._effects = self._effects, []
        return effects


class Sockets:
    """Records the receivers."""

    def __init__(self, sent: list[str]) -> None:
        self._sent = sent

    def send(self, data: bytes, to) -> None:
        self._sent.append(to.address[0])

    def close(self) -> None:
        pass


async def until(sent: list[str], count: int) -> None:
    async with asyncio.timeout(30.0):
        while len(sent) < count:
            await asyncio.sleep(0.01)


async def test_each_address_of_a_host_gets_the_order() -> None:
    sent: list[str] = []
    orders = OrderDatagrams(Orders(), {"alpha": "127.0.0.2:1,[::1]:2,127.0.0.3:3"}, lambda _: Sockets(sent))
    orders.start()
    await until(sent, 3)
    assert sent == ["127.0.0.2", "::1", "127.0.0.3"]
    orders.close()


async def test_a_name_server_that_does_not_answer_delays_no_other_address(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    blocked, real = threading.Event(), socket.getaddrinfo

    def found(host, port, *args, flags=0, **more):
        if host != "slow" or flags & socket.AI_NUMERICHOST:
            return real(host, port, *args, flags=flags, **more)
        blocked.wait(30.0)
        return real("127.0.0.9", port, *args, **more)

    monkeypatch.setattr(socket, "getaddrinfo", found)

    sent: list[str] = []
    orders = OrderDatagrams(Orders(), {"alpha": "slow:1,127.0.0.2:1"}, lambda _: Sockets(sent))
    orders.start()
    await until(sent, 1)
    assert sent == ["127.0.0.2"]
    blocked.set()
    # The next repetition is sent to both addresses.
    async with asyncio.timeout(30.0):
        while "127.0.0.9" not in sent:
            orders.finish("alpha")
            await asyncio.sleep(0.01)
    orders.close()


async def test_an_invalid_address_is_left_to_the_link() -> None:
    sent: list[str] = []
    orders = OrderDatagrams(Orders(), {"alpha": "127.0.0.2:x"}, lambda _: Sockets(sent))
    orders.start()
    async with asyncio.timeout(30.0):
        await orders.wait_link_needed("alpha")
    assert sent == []
    orders.close()
