"""Sender of an operator's stop and pause orders: keys, and the cache of known hosts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress

from lfield.authority.key_material import Keys
from lfield.authority.order_signing.order_signatures import CertificateCache, OrderSigner, VerifiedCertificate
from lfield.errors import KeysError
from lfield.operator.observer_link import OrderMessage
from lfield.operator.orders.known_hosts import KnownHosts
from lfield.operator.orders.order_datagrams import OrderDatagrams
from lfield.operator.orders.order_protocol import EarlierContacts, OrderProtocol
from lfield.operator.orders.order_sockets import OnDatagram, OrderSocket, OrderSockets
from lfield.wire.observer_messages import EmergencyStop
from lfield.wire.order_messages import HOLDS, Epochs


class OrderSender:
    """Sends orders as datagrams with the keys of an operator. Raises KeysError for keys that cannot be
    used."""

    def __init__(
        self, keys: Keys, known: KnownHosts, open_sockets: Callable[[OnDatagram], OrderSocket] = OrderSockets
    ) -> None:
        self.known, self._open_sockets = known, open_sockets
        self._signer = OrderSigner(keys)
        self._certificates = CertificateCache(keys.authority)

    def send(self, message: OrderMessage, addresses: Mapping[str, str]) -> OrderDatagrams:
        """Begin to give an order to the hosts at these addresses; the caller closes it with `finish`.

        An order that ends a stop or a pause names no epoch from before: each host reports its own first, as
        in a handshake.
        """
        known_hosts = {host: self.known.host(host) for host in addresses}
        is_hold = message.kind in HOLDS
        asking = OrderProtocol(
            message.kind,
            message.id,
            message.reason if isinstance(message, EmergencyStop) else "",
            {host: known.epochs if is_hold else Epochs() for host, known in known_hosts.items()},
            self._signer,
            self._certificates,
            EarlierContacts(
                {host: known.trip for host, known in known_hosts.items() if known.trip is not None},
                {host: self._certificate_of(host, known.certificate) for host, known in known_hosts.items()},
            ),
        )
        datagrams = OrderDatagrams(asking, addresses, self._open_sockets)
        datagrams.start()
        return datagrams

    def _certificate_of(self, host: str, certificate: bytes) -> VerifiedCertificate | None:
        """The certificate of a host from a connection, or from the cache."""
        if certificate:
            with suppress(KeysError):
                self._certificates.add_der(certificate)
        return self._certificates.of_host(host)

    def finish(self, datagrams: OrderDatagrams) -> None:
        """Close an order of `send`, and store new data about the hosts."""
        datagrams.close()
        asking = datagrams.protocol
        for host, epochs in asking.epochs.items():
            certificate = asking.certificates.get(host, b"")
            trip = asking.trips.get(host)
            self.known.learn(host, epochs=epochs, trip=trip, certificate=certificate)
        self.known.save()

    def learn(self, host: str, epochs: Epochs) -> None:
        """Store the epochs that a host has sent over a link."""
        self.known.learn(host, epochs=epochs)
        self.known.save()
