"""Fixtures for tests of host addresses."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterator

import pytest
from address_book import HOLE, NameTable


@pytest.fixture
def name_table(monkeypatch) -> Iterator[NameTable]:
    table = NameTable(monkeypatch)
    yield table
    table.blocked.set()


@pytest.fixture
def hole() -> Iterator[int]:
    """The port of the listener at HOLE."""
    with socket.socket() as sock:
        sock.bind((HOLE, 0))
        sock.listen(0)
        callers = [socket.socket() for _ in range(3)]
        for caller in callers:
            caller.setblocking(False)
            caller.connect_ex(sock.getsockname())
        yield sock.getsockname()[1]
        for caller in callers:
            caller.close()


@pytest.fixture(params=["asyncio", "uvloop"])
def runner(request) -> Callable[..., object]:
    def run(test):
        if request.param == "asyncio":
            return asyncio.run(test())
        uvloop = pytest.importorskip("uvloop")
        with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
            return runner.run(test())

    return run
