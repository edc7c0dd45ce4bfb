"""One order to hosts of a team as datagrams: the shell of `Asking`, with its timer, sockets and look-ups."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

from lfield.errors import AddressError, GreetingError, LfieldError
from lfield.net.paths.names import Found, SocketAddress, looked_up
from lfield.net.transport import split_address
from lfield.operator.orders.asking import Asking
from lfield.operator.orders.post import Heard, Post, Sockets
from lfield.wire.observing import EmergencyStopped
from lfield.wire.orders import Confirmed, Denied, devices_of

#: A name may lead to so many addresses that get datagrams, as long as none has answered.
MOST_ADDRESSES = 2


class Datagrams:
    """Gives an order to hosts at `addresses`, by name, in the running loop, until it is closed."""

    def __init__(
        self,
        asking: Asking,
        addresses: Mapping[str, str],
        open_post: Callable[[Heard], Post] = Sockets,
    ) -> None:
        self.asking, self._addresses = asking, addresses
        self._loop = asyncio.get_running_loop()
        self._post = open_post(self._heard)
        self._timer: asyncio.TimerHandle | None = None
        #: Where each host is, and the datagrams of hosts that are still looked up.
        self._found: dict[str, list[Found]] = {}
        self._waiting: dict[str, bytes] = {}
        self._answers = {host: self._loop.create_future() for host in addresses}
        self._needs_link = {host: asyncio.Event() for host in addresses}
        #: Why an order that has ended at a host is not confirmed by datagrams alone.
        self._partial: dict[str, LfieldError] = {}
        self._lookups = [self._loop.create_task(self._look_up(host)) for host in addresses]

    def start(self) -> None:
        """Send the order."""
        self.asking.start(self._loop.time())
        self._turn()

    async def answer(self, host: str) -> EmergencyStopped:
        """What a host has confirmed. Raises GreetingError where it refuses."""
        return await asyncio.shield(self._answers[host])

    async def needs_link(self, host: str) -> None:
        """Return when a host does not answer, or cannot say all of its answer in datagrams."""
        await self._needs_link[host].wait()

    def partial(self, host: str) -> LfieldError | None:
        """What a host has answered that only a link could complete, if anything."""
        return self._partial.get(host)

    def ended(self, host: str) -> None:
        """A host is asked no more."""
        self.asking.ended(host)
        self._turn()

    def close(self) -> None:
        """Ask no host any more."""
        self._post.close()
        for task in self._lookups:
            task.cancel()
        for answer in self._answers.values():
            # An answer that nobody has waited for is no fault.
            if not answer.cancel() and not answer.cancelled():
                answer.exception()
        if self._timer is not None:
            self._timer.cancel()

    # --- events ---------------------------------------------------------------------------------------

    def _heard(self, data: bytes, sender: SocketAddress) -> None:
        self.asking.heard(data, self._loop.time())
        self._turn()

    def _tick(self) -> None:
        self._timer = None
        self.asking.tick(self._loop.time())
        self._turn()

    async def _look_up(self, host: str) -> None:
        try:
            found = await looked_up(*split_address(self._addresses[host]))
        except (OSError, UnicodeError, AddressError):
            # The connection says what is wrong with it.
            self._needs_link[host].set()
            return
        self._found[host] = found[:MOST_ADDRESSES]
        if (data := self._waiting.pop(host, None)) is not None:
            self._send(host, data)

    # --- what follows ---------------------------------------------------------------------------------

    def _turn(self) -> None:
        for send in self.asking.take():
            self._send(send.host, send.datagram)
        for host, result in self.asking.results.items():
            if not self._answers[host].done() and host not in self._partial:
                self._ended(host, result)
        for host in self.asking.silent:
            self._needs_link[host].set()
        self._plan()

    def _send(self, host: str, data: bytes) -> None:
        if host not in self._found:
            self._waiting[host] = data
            return
        for at in self._found[host]:
            self._post.send(data, at)

    def _ended(self, host: str, result: Confirmed | Denied) -> None:
        match result:
            case Confirmed(more=0):
                stopped = EmergencyStopped(devices_of(result), result.trouble, result.id, result.epochs)
                self._answers[host].set_result(stopped)
                return
            case Denied():
                self._answers[host].set_exception(GreetingError(f"{host} refused: {result.why}"))
                return
            case Confirmed():
                why = f"it has executed the order, and does not say how {result.more} of its devices are"
                self._partial[host] = AddressError(self._addresses[host], why)
                self._needs_link[host].set()

    def _plan(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        due = self.asking.due
        self._timer = None if due is None else self._loop.call_at(due, self._tick)
