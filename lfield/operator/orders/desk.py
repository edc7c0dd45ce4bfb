"""What a person gives orders with: keys, and what is known of the hosts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress

from lfield.authority.keys import Keys
from lfield.authority.orders.signing import Certificates, Known, Signer
from lfield.errors import KeysError
from lfield.operator.observing import OrderMessage
from lfield.operator.orders.asking import Asking
from lfield.operator.orders.datagrams import Datagrams
from lfield.operator.orders.known_hosts import KnownHosts
from lfield.operator.orders.post import Heard, Post, Sockets
from lfield.wire.observing import EmergencyStop
from lfield.wire.orders import HOLDS, Epochs


class Desk:
    """Gives orders as datagrams with the keys of a person. Raises KeysError for keys that cannot be used."""

    def __init__(self, keys: Keys, known: KnownHosts, open_post: Callable[[Heard], Post] = Sockets) -> None:
        self.known, self._open_post = known, open_post
        self._signer = Signer(keys)
        self._certificates = Certificates(keys.authority)

    def give(self, message: OrderMessage, addresses: Mapping[str, str]) -> Datagrams:
        """Begin to give an order to the hosts at these addresses; the caller closes it with `taken`.

        An order to end a stop or a pause names no state that was known before: a host tells its own first, as
        in the greeting of a connection.
        """
        found = {host: self.known.of(host) for host in addresses}
        is_hold = message.kind in HOLDS
        asking = Asking(
            message.kind,
            message.id,
            message.reason if isinstance(message, EmergencyStop) else "",
            {host: known.epochs if is_hold else Epochs() for host, known in found.items()},
            self._signer,
            self._certificates,
            {host: known.trip for host, known in found.items() if known.trip is not None},
            {host: self._learned(host, known.certificate) for host, known in found.items()},
        )
        given = Datagrams(asking, addresses, self._open_post)
        given.start()
        return given

    def _learned(self, host: str, certificate: bytes) -> Known | None:
        """The certificate of a host that was learned by a connection, or kept."""
        if certificate:
            with suppress(KeysError):
                self._certificates.learn(certificate)
        return self._certificates.of_host(host)

    def taken(self, given: Datagrams) -> None:
        """Close what `give` has begun, and keep what was learned of the hosts."""
        given.close()
        asking = given.asking
        for host, epochs in asking.epochs.items():
            certificate = asking.certificates.get(host, b"")
            trip = asking.trips.get(host)
            self.known.learn(host, epochs=epochs, trip=trip, certificate=certificate)
        self.known.save()

    def learn(self, host: str, epochs: Epochs) -> None:
        """A host has told its epochs over a connection."""
        self.known.learn(host, epochs=epochs)
        self.known.save()
