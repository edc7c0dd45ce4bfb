"""A network inside one process, for tests: nothing happens until `run` is called.

Links carry the same bytes as TCP's, through the same codec. Delivery is in the order of the due times on
the injected clock, then of sending, so a run repeats exactly.
"""

from __future__ import annotations

import heapq
from collections import Counter
from functools import partial
from typing import TYPE_CHECKING

from lfield.errors import AddressError, NoListener
from lfield.net.framed_link import FramedLink
from lfield.net.transport import join_address, split_address
from lfield.simulate.host_fleet import host_at_address

if TYPE_CHECKING:
    from collections.abc import Callable

    from lfield.clock import Clock
    from lfield.errors import LfieldError
    from lfield.net.transport import Link, LinkHandler
    from lfield.wire.coordinator_messages import Transfer
    from lfield.wire.framing import Buffer
    from lfield.wire.messages import Message

_FIRST_FREE_PORT = 40000


class MemoryNetwork:
    """All machines of a simulation and the bytes between them.

    `latency` is in seconds and may be changed at any time. `on_pending` is called when an action is queued,
    so that an event loop can schedule `run`. `sent` counts messages by the names of their types; `max_block`
    is the largest block of a link, in bytes.
    """

    def __init__(
        self,
        clock: Clock,
        *,
        latency: float = 0.0,
        max_block: int = 1 << 20,
        on_pending: Callable[[], None] | None = None,
    ) -> None:
        self.latency = latency
        self.sent: Counter[str] = Counter()
        self._clock = clock
        self._max_block = max_block
        self._on_pending = on_pending
        self._queue: list[tuple[float, int, Callable[[], None]]] = []
        self._queued = 0
        self._listeners: dict[str, MemoryListener] = {}
        self._links: list[MemoryLink] = []
        self._apart: set[frozenset[str]] = set()

    def transport(self, machine: str) -> MemoryTransport:
        """The transport of one machine; `partition` and `cut` use this name."""
        return MemoryTransport(self, machine)

    def step(self) -> bool:
        """Do the next action that is due; return whether there was one."""
        if not self._queue or self._queue[0][0] > self._clock.monotonic():
            return False
        heapq.heappop(self._queue)[2]()
        return True

    def run(self) -> int:
        """Do all actions that are due, and those that they cause; return their number."""
        steps = 0
        while self.step():
            steps += 1
        return steps

    def next_due(self) -> float | None:
        """When the next delivery is due, on the clock's monotonic time; None if none is queued."""
        return self._queue[0][0] if self._queue else None

    def cut(self, one: str, other: str) -> None:
        """Lose every link between two machines, with all bytes in flight."""
        for link in [link for link in self._links if {link.machine, link.other.machine} == {one, other}]:
            link.lose()

    def partition(self, one: str, other: str) -> None:
        """`cut`, and permit no new link until `heal`."""
        self._apart.add(frozenset((one, other)))
        self.cut(one, other)

    def heal(self, one: str, other: str) -> None:
        """Permit new links; lost ones stay lost."""
        self._apart.discard(frozenset((one, other)))

    def listen(self, machine: str, address: str, on_link: Callable[[Link], LinkHandler]) -> MemoryListener:
        """`Transport.listen` for a machine."""
        host, port = split_address(address)
        if port == 0:
            port = _FIRST_FREE_PORT
            while join_address(host, port) in self._listeners:
                port += 1
        address = join_address(host, port)
        if address in self._listeners:
            raise AddressError(address, "the port is in use; choose another port")
        listener = MemoryListener(address, machine, on_link, self._listeners)
        self._listeners[address] = listener
        return listener

    def connect(self, machine: str, address: str, handler: LinkHandler) -> MemoryLink:
        """`Transport.connect` for a machine."""
        address = join_address(*split_address(address))
        listener = self._listeners.get(address)
        if listener is None or frozenset((machine, listener.machine)) in self._apart:
            raise NoListener(address)
        near = MemoryLink(self, machine, address, self._max_block)
        far = MemoryLink(self, listener.machine, machine, self._max_block)
        near.other, far.other = far, near
        near.identity, far.identity = host_at_address(listener.machine), host_at_address(machine)
        near.handler = handler
        far.handler = listener.on_link(far)
        self._links += [near, far]
        return near

    def later(self, due: float, action: Callable[[], None]) -> None:
        """Queue an action for a time on the clock."""
        heapq.heappush(self._queue, (due, self._queued, action))
        self._queued += 1
        if self._on_pending is not None:
            self._on_pending()

    def now(self) -> float:
        """The clock's monotonic time."""
        return self._clock.monotonic()

    def forget(self, link: MemoryLink) -> None:
        """Remove a link that has reported its end."""
        self._links.remove(link)


class MemoryTransport:
    """The transport of one machine in a MemoryNetwork. Its coroutines never suspend."""

    def __init__(self, network: MemoryNetwork, machine: str) -> None:
        self._network, self._machine = network, machine

    async def listen(self, address: str, on_link: Callable[[Link], LinkHandler]) -> MemoryListener:
        """See `Transport.listen`."""
        return self._network.listen(self._machine, address, on_link)

    async def connect(self, address: str, handler: LinkHandler, host: str = "") -> Link:
        """See `Transport.connect`."""
        return self._network.connect(self._machine, address, handler)


class MemoryListener:
    """An open port of a simulated machine."""

    def __init__(
        self,
        address: str,
        machine: str,
        on_link: Callable[[Link], LinkHandler],
        listeners: dict[str, MemoryListener],
    ) -> None:
        self.address, self.machine, self.on_link = address, machine, on_link
        self._listeners = listeners

    def close(self) -> None:
        """Accept no more links."""
        self._listeners.pop(self.address, None)


class MemoryLink(FramedLink):
    """One end of a simulated connection; `other` is the far end."""

    other: MemoryLink

    def __init__(self, network: MemoryNetwork, machine: str, peer: str, max_block: int) -> None:
        super().__init__(peer, max_block)
        self.machine = machine
        self._network = network
        self._done = False
        self._last_due = 0.0

    def send(self, message: Message) -> None:
        """See `Link.send`."""
        super().send(message)
        self._network.sent[type(message).__name__] += 1

    def send_transfer(self, header: Transfer, block: Buffer) -> None:
        """See `Link.send_transfer`."""
        super().send_transfer(header, block)
        self._network.sent["Transfer"] += 1

    def write(self, data: Buffer) -> None:
        """Queue bytes for the other end."""
        self._to_other(partial(self.other.deliver, bytes(data)))

    def close(self) -> None:
        """Close after the delivery of the bytes in flight; both ends report it."""
        if not self.closed:
            self.closed = True
            self._to_other(self.other.end)
            self._network.later(self._network.now(), self.end)

    def abort(self) -> None:
        """See `Link.abort`. This end has no queue: written bytes are in flight."""
        self.close()

    def lose(self) -> None:
        """Break the link at once: nothing more is delivered to this end."""
        if not self.closed:
            self.closed = True
            error = AddressError(self.peer, "the connection was lost")
            self._network.later(self._network.now(), partial(self.end, error))

    def deliver(self, data: bytes) -> None:
        """Bytes from the other end have arrived."""
        if not self.closed:
            self.received(data)

    def end(self, error: LfieldError | None = None) -> None:
        """Report the end of this link, once."""
        if not self._done:
            self._done = True
            self._network.forget(self)
            self.on_eof(error)

    def _to_other(self, action: Callable[[], None]) -> None:
        # A link keeps its order even when the latency was reduced meanwhile.
        self._last_due = max(self._last_due, self._network.now() + self._network.latency)
        self._network.later(self._last_due, action)
