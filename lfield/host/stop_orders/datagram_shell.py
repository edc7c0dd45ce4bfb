"""Shell around the datagram core of a host: its sockets, and the thread that checks signatures."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple, cast

from lfield.authority.admission_policy import AdmissionPolicy
from lfield.authority.order_signing.order_signatures import (
    CertificateCache,
    OrderSigner,
    VerifiedCertificate,
    verify_order,
)
from lfield.errors import LfieldError
from lfield.host.core import HostCore
from lfield.host.stop_orders.datagram_limits import Sender
from lfield.host.stop_orders.order_executor import OrderExecutor
from lfield.host.stop_orders.order_receiver import OrderPorts, OrderReceiver, PendingCheck
from lfield.net.datagrams.datagram_port import Address, DatagramPort, network_of
from lfield.net.link_manager import LinkManager
from lfield.net.tcp_transport import TcpTransport
from lfield.net.transport import Transport
from lfield.net.zenoh.host_transport import HostTransport
from lfield.wire.order_messages import RelayedAnswer, RelayedOrder


class OrderCredentials(NamedTuple):
    """The keys with which a host checks orders and signs answers: `authority` is PEM."""

    signer: OrderSigner
    certificates: CertificateCache
    authority: bytes


def order_datagrams(
    keys: OrderCredentials,
    transport: Transport,
    admission: AdmissionPolicy,
    core: HostCore,
    stops: OrderExecutor,
    links: LinkManager,
    fail: Callable[[BaseException], None],
) -> DatagramShell | None:
    """The datagram sockets of a host with keys; None where its transport has no sockets."""
    if isinstance(transport, HostTransport):
        transport = transport.tcp
    if not isinstance(transport, TcpTransport):
        return None

    def receiver(shell: DatagramShell) -> OrderReceiver:
        ports = OrderPorts(
            send=shell.send,
            relay=links.send,
            linked=lambda: links.incarnations.keys(),
            check=shell.check,
            execute=stops.on_order,
            later=shell.later,
            note=links.log_once,
        )
        return OrderReceiver(
            keys.signer, keys.certificates, admission, lambda: core.orders.epochs, links.now, ports
        )

    transport.datagrams = shell = DatagramShell(receiver, keys.authority, fail)
    return shell


class DatagramShell:
    """Passes the datagrams of a host's sockets to the core, and executes its effects.

    A thread checks signatures, one at a time. OpenSSL holds the interpreter lock for 0.13 ms per check, so
    only the rate limits of the core protect the event loop from a flood. `fail` receives exceptions due to
    bugs; `receiver` creates the core from the ports of the shell. Implements
    `net.datagrams.datagram_port.DatagramReader`.
    """

    def __init__(
        self,
        receiver: Callable[[DatagramShell], OrderReceiver],
        authority: bytes,
        fail: Callable[[BaseException], None],
    ) -> None:
        self._authority, self._fail = authority, fail
        self._loop = asyncio.get_running_loop()
        self._thread: ThreadPoolExecutor | None = None
        self._is_closed = False
        self._core = receiver(self)

    def received(self, port: DatagramPort, address: Address, data: bytes) -> bool:
        """See `DatagramReader.received`."""
        sender = Sender(network_of(address), (port, address))
        if not self._core.may_decode(sender):
            return False
        self._core.on_datagram(data, sender)
        return True

    def on_relayed(self, host: str, message: RelayedOrder | RelayedAnswer) -> None:
        """A message relayed by a host over its link; ignored from an observer (host '')."""
        if host:
            self._core.on_relayed(host, message)

    def close(self) -> None:
        """Stop checking signatures."""
        self._is_closed = True
        if self._thread is not None:
            self._thread.shutdown(wait=False, cancel_futures=True)

    def send(self, sender: Sender, data: bytes) -> None:
        """See `OrderPorts.send`."""
        port, address = cast(tuple[DatagramPort, Address], sender.address)
        port.send(address, data)

    def later(self, seconds: float, event: Callable[[], None]) -> None:
        """See `OrderPorts.later`."""
        self._loop.call_later(seconds, event)

    def check(self, checking: PendingCheck) -> None:
        """See `OrderPorts.check`."""
        if self._is_closed:
            return
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, "signatures")
        job = self._loop.run_in_executor(self._thread, _verified, checking, self._authority)
        job.add_done_callback(partial(self._on_checked, checking))

    def _on_checked(
        self, checking: PendingCheck, job: asyncio.Future[VerifiedCertificate | LfieldError]
    ) -> None:
        if job.cancelled():
            return
        try:
            self._core.on_checked(checking, job.result())
        except Exception as bug:
            self._fail(bug)


def _verified(checking: PendingCheck, authority: bytes) -> VerifiedCertificate | LfieldError:
    try:
        return verify_order(checking.signed, checking.known, authority)[1]
    except LfieldError as error:
        return error
