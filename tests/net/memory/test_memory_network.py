"""The in-memory network with the conformance kit, its latency and its partitions."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from memory_network import MemoryNetwork

from lfield.clock import ManualClock
from lfield.errors import AddressError
from lfield.testing.transport_kit import MAX_BLOCK, Pair, Recorder, TransportKit
from lfield.wire.messages import Ping


class MemoryBench:
    """The in-memory network; it works only when it is run."""

    address = "a:0"

    def __init__(self) -> None:
        self.network = MemoryNetwork(ManualClock(), max_block=MAX_BLOCK)
        self.transport = self.network.transport("a")

    def wait(self, work: Coroutine[Any, Any, Any]) -> Any:
        try:
            work.send(None)
        except StopIteration as done:
            return done.value
        raise AssertionError("a coroutine of the in-memory transport suspended")

    def until(self, done: Callable[[], bool]) -> None:
        self.network.run()
        assert done()

    def write(self, link: Any, data: bytes) -> None:
        link.write(data)


class TestMemory(TransportKit):
    @pytest.fixture
    def bench(self) -> MemoryBench:
        return MemoryBench()


@pytest.fixture
def memory() -> MemoryBench:
    return MemoryBench()


def test_a_message_arrives_after_the_latency_in_order(memory: Any) -> None:
    clock = memory.network._clock
    pair = Pair(memory)
    memory.network.latency = 0.5
    pair.link.send(Ping(1))
    memory.network.latency = 0.1
    pair.link.send(Ping(2))
    assert memory.network.next_due() == clock.monotonic() + 0.5
    clock.advance(0.4)
    assert memory.network.run() == 0
    clock.advance(0.1)
    memory.until(lambda: pair.far.messages == [Ping(1), Ping(2)])
    assert memory.network.next_due() is None


def test_a_partition_loses_messages_in_flight_and_prevents_links(memory: Any) -> None:
    pair = Pair(memory)
    other = memory.network.transport("b")
    near = Recorder()
    link = memory.wait(other.connect(pair.listener.address, near))
    link.send(Ping(1))
    memory.network.partition("a", "b")
    memory.until(lambda: len(near.ends) == len(pair.accepted[1].ends) == 1)
    assert "the connection was lost" in str(near.ends[0])
    assert pair.accepted[1].messages == []
    assert pair.near.ends == []
    with pytest.raises(AddressError, match="no program listens"):
        memory.wait(other.connect(pair.listener.address, Recorder()))
    memory.network.heal("a", "b")
    memory.wait(other.connect(pair.listener.address, Recorder()))
