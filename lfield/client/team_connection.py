"""A connection to the hosts of a team: their locations, the keys of a person, and requests to all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct

from lfield.errors import LfieldError
from lfield.net.transport import Transport
from lfield.operator.client import (
    RETRIED_SNAPSHOT,
    OrderOnOpenLink,
    ask_all,
    observer_transport,
    order_sender,
    own_keys,
    presented_crl,
)
from lfield.operator.dashboard.event_stream.host_locator import HostLocator
from lfield.operator.observer_link import PresentedCrl, Request
from lfield.operator.orders.known_hosts import KnownHosts
from lfield.operator.targets import TargetTeam
from lfield.wire.observer_messages import EmergencyStopResult
from lfield.wire.subscription_messages import EventBatch

if TYPE_CHECKING:
    from lfield.authority.key_material import Keys
    from lfield.operator.orders.order_sender import OrderSender

#: The answer of each host, or the error instead.
HostSnapshots = Mapping[str, EventBatch | LfieldError]
OrderResults = Mapping[str, EmergencyStopResult | LfieldError]


class TeamConnection(Struct, frozen=True):
    """The hosts of one team, as one person reaches them.

    `keys`: those of this person, None for none. `crl`: a revocation list for hosts with an older one.
    `sender`: sends orders as signed datagrams.
    """

    transport: Transport
    locate: HostLocator
    keys: Keys | None = None
    crl: PresentedCrl | None = None
    sender: OrderSender | None = None

    async def snapshots(self, request: Request[EventBatch] = RETRIED_SNAPSHOT) -> HostSnapshots:
        """The state of every host."""
        return await ask_all(self.transport, dict(self.locate.addresses), request, self.crl)

    async def order(
        self,
        request: Request[EmergencyStopResult],
        open_links: OrderOnOpenLink | None = None,
        on_answer: Callable[[str, EmergencyStopResult | LfieldError], None] = lambda host, answer: None,
    ) -> OrderResults:
        """Send an order to every host: over new connections, as datagrams, and with
        `open_links` over open ones.

        Each answer is passed to `on_answer` when it comes.
        """
        addresses = dict(self.locate.addresses)
        return await ask_all(self.transport, addresses, request, self.crl, self.sender, open_links, on_answer)


def open_connection(
    target: TargetTeam,
    find: Callable[[], Sequence[TargetTeam]],
    folder: Path | None,
    connect_timeout: float = 2.0,
) -> TeamConnection:
    """The connection to a team; `find` locates its hosts again, `folder` is that of this person's keys.

    `connect_timeout` is in seconds. Raises KeysError for keys that cannot be used.
    """
    keys = own_keys(target.addresses.values(), folder)
    sender = order_sender(keys, KnownHosts.read(keys.authority)) if keys is not None else None
    transport = observer_transport(keys, sender.known if sender is not None else None, connect_timeout)
    return TeamConnection(transport, HostLocator(target, find), keys, presented_crl(keys), sender)
