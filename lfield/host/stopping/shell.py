"""Around the core of a host's datagrams: its sockets, and the thread that checks signatures."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple, cast

from lfield.authority.admission import Admission
from lfield.authority.orders.signing import Certificates, Known, Signer, verified_order
from lfield.errors import LfieldError
from lfield.host.core import HostCore
from lfield.host.stopping.datagrams import Checking, OrderDatagrams
from lfield.host.stopping.rations import Sender
from lfield.host.stopping.stops import Stops
from lfield.net.datagrams.port import Address, DatagramPort, network_of
from lfield.net.peers import Peers
from lfield.net.tcp import TcpTransport
from lfield.net.transport import Transport
from lfield.wire.orders import RelayedAnswer, RelayedOrder


class OrderKeys(NamedTuple):
    """With what a host answers orders that come as datagrams, and checks them: `authority` is PEM."""

    signer: Signer
    certificates: Certificates
    authority: bytes


def order_datagrams(
    keys: OrderKeys | None,
    transport: Transport,
    admission: Admission,
    core: HostCore,
    stops: Stops,
    peers: Peers,
    fail: Callable[[BaseException], None],
) -> DatagramShell | None:
    """What takes the datagrams of a host that has keys, and a transport with sockets for them."""
    if keys is None or not isinstance(transport, TcpTransport):
        return None
    datagrams = OrderDatagrams(
        keys.signer, keys.certificates, admission, lambda: core.orders.epochs, peers.now
    )
    datagrams.execute, datagrams.note = stops.order, peers.complain
    datagrams.relay, datagrams.linked = peers.send, lambda: peers.incarnations.keys()
    transport.datagrams = shell = DatagramShell(datagrams, keys.authority, fail)
    return shell


class DatagramShell:
    """Gives the datagrams of a host's sockets to the core, and carries out what it wants.

    A thread checks signatures, one after the other. OpenSSL takes 0.13 ms for one and keeps the interpreter
    to itself meanwhile, so it is the core's rations that keep a flood from the event loop. `fail` takes what
    a bug of ours has raised. Implements `net.datagrams.port.Reader`.
    """

    def __init__(self, core: OrderDatagrams, authority: bytes, fail: Callable[[BaseException], None]) -> None:
        self._core, self._authority, self._fail = core, authority, fail
        self._loop = asyncio.get_running_loop()
        self._thread: ThreadPoolExecutor | None = None
        self._is_closed = False
        core.check, core.send = self._check, self._send
        core.later = self._later

    def received(self, port: DatagramPort, address: Address, data: bytes) -> bool:
        """See `Reader.received`."""
        sender = Sender(network_of(address), (port, address))
        if not self._core.may_look(sender):
            return False
        self._core.came(data, sender)
        return True

    def relayed(self, host: str, message: RelayedOrder | RelayedAnswer) -> None:
        """A host has sent this over its link; from an observer (host '') it is nothing."""
        if host:
            self._core.relayed(host, message)

    def close(self) -> None:
        """Check no more signatures."""
        self._is_closed = True
        if self._thread is not None:
            self._thread.shutdown(wait=False, cancel_futures=True)

    def _send(self, sender: Sender, data: bytes) -> None:
        port, address = cast(tuple[DatagramPort, Address], sender.address)
        port.send(address, data)

    def _later(self, seconds: float, event: Callable[[], None]) -> None:
        self._loop.call_later(seconds, event)

    def _check(self, checking: Checking) -> None:
        if self._is_closed:
            return
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, "signatures")
        job = self._loop.run_in_executor(self._thread, _verified, checking, self._authority)
        job.add_done_callback(partial(self._checked, checking))

    def _checked(self, checking: Checking, job: asyncio.Future[Known | LfieldError]) -> None:
        if job.cancelled():
            return
        try:
            self._core.checked(checking, job.result())
        except Exception as bug:
            self._fail(bug)


def _verified(checking: Checking, authority: bytes) -> Known | LfieldError:
    try:
        return verified_order(checking.signed, checking.known, authority)[1]
    except LfieldError as error:
        return error
