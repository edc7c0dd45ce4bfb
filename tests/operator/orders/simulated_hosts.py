"""Hosts and a network of datagrams and connections in virtual time, for the desk's side of orders."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable
from functools import cache
from typing import Any

from order_host import OrderHost

from lfield.authority.certificate_authority import CertificateAuthority, new_authority
from lfield.authority.identity import ALL_RIGHTS, Right
from lfield.authority.key_material import Keys
from lfield.authority.order_signing.order_signatures import OrderSigner
from lfield.errors import AddressError, NoListener
from lfield.host.stop_orders.datagram_limits import Sender
from lfield.net.connections.resolver import ResolvedAddress
from lfield.operator.orders.known_hosts import KnownHosts
from lfield.operator.orders.order_sender import OrderSender
from lfield.wire.messages import Hello, Message
from lfield.wire.observer_messages import EmergencyStop, Pause
from lfield.wire.order_messages import RelayedAnswer, RelayedOrder

#: Seconds in which a host makes its devices safe, and round trips of a new connection.
EXECUTES, HANDSHAKE = 0.02, 3.0


@cache
def authority() -> CertificateAuthority:
    now = time.time()
    return new_authority(now, now + 86400.0)


@cache
def keys(holder: Any, name: str, may: frozenset[Right] = frozenset()) -> Keys:
    now = time.time()
    issued = authority().issue(holder, name, may=may, at=now, ends=now + 86400.0)
    return Keys(holder, authority().certificate, issued.certificate, issued.key)


class Network:
    """Datagrams and messages of connections take `trip`/2 seconds; datagrams are lost with a probability.
    Host number n is at 10.0.0.n. `udp` and `tcp` decide if the operator reaches a host that way; a `refused`
    connection fails at once.
    """

    def __init__(self, count: int = 1, *, trip: float = 0.1, loss: float = 0.0, seed: int = 1) -> None:
        self.trip, self.loss, self.rng = trip, loss, random.Random(seed)
        self.udp: Callable[[str], bool] = lambda host: True
        self.tcp: Callable[[str], bool] = lambda host: True
        self.refused: Callable[[str], bool] = lambda host: False
        self.twice = False
        self.hosts = {f"h{n}": Host(self, f"h{n}") for n in range(1, count + 1)}
        self.addresses = {name: f"10.0.0.{name[1:]}:6000" for name in self.hosts}
        # : Datagrams of the operator as (time, host, bytes), and the connections that it started, as (time,
        # host).
        self.sent: list[tuple[float, str, bytes]] = []
        self.dialled: list[tuple[float, str]] = []
        self.on_datagram: Callable[[bytes, Any], None] = lambda data, sender: None

    @property
    def now(self) -> float:
        return asyncio.get_running_loop().time()

    def later(self, seconds: float, event: Callable[..., None], *given: object) -> None:
        asyncio.get_running_loop().call_later(seconds, event, *given)

    def carry(self, event: Callable[..., None], *given: object) -> None:
        for _ in range(2 if self.twice else 1):
            if self.rng.random() >= self.loss:
                self.later(self.trip / 2.0, event, *given)

    def sender(self, known: KnownHosts | None = None, may: frozenset[Right] = ALL_RIGHTS) -> OrderSender:
        own = keys("person", "anna", may)
        return OrderSender(own, known or KnownHosts(own.authority), self._open)

    def _open(self, on_datagram: Callable[[bytes, Any], None]) -> Network:
        self.on_datagram = on_datagram
        return self

    def send(self, data: bytes, to: ResolvedAddress) -> None:
        host = f"h{to.address[0].rpartition('.')[2]}"
        self.sent.append((self.now, host, data))
        if self.udp(host):
            self.carry(self.hosts[host].came, data)

    def close(self) -> None:
        self.on_datagram = lambda data, sender: None

    def answered(self, host: str, data: bytes) -> None:
        if self.udp(host):
            self.carry(lambda: self.on_datagram(data, (f"10.0.0.{host[1:]}", 6000)))

    async def connect(self, address: str, handler: Any, host="") -> Connection:
        host = f"h{address.partition(':')[0].rpartition('.')[2]}"
        self.dialled.append((self.now, host))
        if self.refused(host):
            await asyncio.sleep(self.trip)
            raise NoListener(address)
        if not self.tcp(host):
            await asyncio.sleep(2.0)
            raise AddressError(address, "no answer within 2 s")
        await asyncio.sleep(HANDSHAKE * self.trip)
        return Connection(self, self.hosts[host], handler)

    async def listen(self, address: str, on_link: object) -> Any:
        raise NotImplementedError


class Connection:
    """The operator's end of a connection with a host. It loses nothing."""

    def __init__(self, network: Network, host: Host, handler: Any) -> None:
        self.peer, self.closed = host.name, False
        self._network, self._host, self._handler = network, host, handler
        self.identity = OrderSigner(keys("host", host.name)).identity

    def send(self, message: Message) -> None:
        self._network.later(self._network.trip / 2.0, self._came, message)

    def _came(self, message: Message) -> None:
        if isinstance(message, Hello):
            self._back(Hello("host", self._host.name, 7, epochs=self._host.orders.epochs))
        elif isinstance(message, EmergencyStop | Pause):
            self._host.execute(message, "anna", self._back)

    def _back(self, message: Message) -> None:
        self._network.later(self._network.trip / 2.0, self._hand_over, message)

    def _hand_over(self, message: Message) -> None:
        if not self.closed:
            self._handler.on_message(self, message)

    def accept_role(self, role: str) -> None:
        pass

    def close(self) -> None:
        self.closed = True

    abort = close


class Host(OrderHost):
    """A host of the network. It has links with all other hosts."""

    def __init__(self, network: Network, name: str) -> None:
        self.network, self.name = network, name
        super().__init__(keys("host", name), time.time(), network.rng, f"{name}.fc", EXECUTES)

    def now(self) -> float:
        return self.network.now

    def later(self, seconds: float, event: Callable[[], None]) -> None:
        self.network.later(seconds, event)

    def linked(self) -> list[str]:
        return [name for name in self.network.hosts if name != self.name]

    def send(self, sender: Sender, data: bytes) -> None:
        self.network.answered(self.name, data)

    def relay(self, host: str, message: RelayedOrder | RelayedAnswer) -> None:
        other = self.network.hosts[host]
        self.later(self.network.trip / 2.0, lambda: other.datagrams.on_relayed(self.name, message))
