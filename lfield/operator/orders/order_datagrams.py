"""Sends one order to hosts of a team as datagrams: the shell of `OrderProtocol` with timer, sockets, name
look-ups."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

from lfield.errors import AddressError, HandshakeError, LfieldError
from lfield.net.connections.resolver import AddressLookups, ResolvedAddress, SocketAddress
from lfield.net.transport import is_zenoh, split_addresses
from lfield.operator.orders.order_protocol import OrderProtocol
from lfield.operator.orders.order_sockets import OnDatagram, OrderSocket, OrderSockets
from lfield.wire.observer_messages import EmergencyStopResult
from lfield.wire.order_messages import OrderConfirmed, OrderDenied, devices_of

#: The maximum number of addresses that get datagrams, for each stated address of a host.
MAX_ADDRESSES = 2


class OrderDatagrams:
    """Sends an order to hosts at `addresses`, by name, in the running loop, until it is closed."""

    def __init__(
        self,
        protocol: OrderProtocol,
        addresses: Mapping[str, str],
        open_sockets: Callable[[OnDatagram], OrderSocket] = OrderSockets,
    ) -> None:
        self.protocol, self._addresses = protocol, addresses
        self._loop = asyncio.get_running_loop()
        self._sockets = open_sockets(self._on_datagram)
        self._timer: asyncio.TimerHandle | None = None
        #: The address of each host, and datagrams that wait for a look-up.
        self._found: dict[str, list[ResolvedAddress]] = {}
        self._waiting: dict[str, bytes] = {}
        self._answers = {host: self._loop.create_future() for host in addresses}
        self._needs_link = {host: asyncio.Event() for host in addresses}
        #: The reasons why an order that has ended at a host cannot be confirmed by datagrams alone.
        self._partial: dict[str, LfieldError] = {}
        self._lookups = [self._loop.create_task(self._look_up(host)) for host in addresses]

    def start(self) -> None:
        """Send the order."""
        self.protocol.start(self._loop.time())
        self._step()

    async def answer(self, host: str) -> EmergencyStopResult:
        """The confirmation of a host. Raises HandshakeError if it refuses."""
        return await asyncio.shield(self._answers[host])

    async def wait_link_needed(self, host: str) -> None:
        """Return when a host does not answer, or its answer does not fit datagrams."""
        await self._needs_link[host].wait()

    def partial(self, host: str) -> LfieldError | None:
        """The partial answer of a host that only a link can complete, if any."""
        return self._partial.get(host)

    def finish(self, host: str) -> None:
        """Stop sending to a host."""
        self.protocol.finish(host)
        self._step()

    def close(self) -> None:
        """Stop sending to all hosts."""
        self._sockets.close()
        for task in self._lookups:
            task.cancel()
        for answer in self._answers.values():
            # An error that no task has retrieved is not a fault.
            if not answer.cancel() and not answer.cancelled():
                answer.exception()
        if self._timer is not None:
            self._timer.cancel()

    # --- events ---------------------------------------------------------------------------------------

    def _on_datagram(self, data: bytes, sender: SocketAddress) -> None:
        self.protocol.on_datagram(data, self._loop.time())
        self._step()

    def _tick(self) -> None:
        self._timer = None
        self.protocol.tick(self._loop.time())
        self._step()

    async def _look_up(self, host: str) -> None:
        # A fabric does not carry our datagrams.
        each = [address for address in split_addresses(self._addresses[host]) if not is_zenoh(address)]
        try:
            lookups = AddressLookups(each)
        except AddressError:
            # The link attempt reports the problem of the address.
            self._needs_link[host].set()
            return
        try:
            await lookups.settle()
            self._found[host] = lookups.found[: MAX_ADDRESSES * len(each)]
            if (data := self._waiting.pop(host, None)) is not None:
                self._send(host, data)
            if lookups.pending:
                # The next repetition is sent to these too.
                await asyncio.wait(lookups.pending)
                self._found[host] = lookups.found[: MAX_ADDRESSES * len(each)]
        except (OSError, UnicodeError):
            # Likewise.
            self._needs_link[host].set()
        finally:
            lookups.cancel()

    # --- effects --------------------------------------------------------------------------------------

    def _step(self) -> None:
        for send in self.protocol.drain_effects():
            self._send(send.host, send.datagram)
        for host, result in self.protocol.results.items():
            if not self._answers[host].done() and host not in self._partial:
                self._on_ended(host, result)
        for host in self.protocol.unresponsive:
            self._needs_link[host].set()
        self._plan()

    def _send(self, host: str, data: bytes) -> None:
        if host not in self._found:
            self._waiting[host] = data
            return
        for at in self._found[host]:
            self._sockets.send(data, at)

    def _on_ended(self, host: str, result: OrderConfirmed | OrderDenied) -> None:
        match result:
            case OrderConfirmed(more=0):
                stopped = EmergencyStopResult(devices_of(result), result.trouble, result.id, result.epochs)
                self._answers[host].set_result(stopped)
                return
            case OrderDenied():
                self._answers[host].set_exception(HandshakeError(f"{host} refused: {result.reason}"))
                return
            case OrderConfirmed():
                reason = f"it has executed the order, and does not say how {result.more} of its devices are"
                self._partial[host] = AddressError(self._addresses[host], reason)
                self._needs_link[host].set()

    def _plan(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        due = self.protocol.due
        self._timer = None if due is None else self._loop.call_at(due, self._tick)
