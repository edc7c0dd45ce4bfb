"""The transport interface: listen, connect, and links for messages and blocks.

`tcp_transport` is the real transport, `memory` the transport for tests and simulation;
`lfield.testing.transport_kit` tests both. Addresses are "host:port"; IPv6 hosts are in brackets.
"zenoh:name:port" is a name in a Zenoh fabric (`lfield.net.zenoh`). Several addresses of one host are written
"host:port,host:port", in order of preference.

All calls and callbacks happen on one thread. No callback runs inside `send`, `send_transfer` or `close`.
"""

from __future__ import annotations

import re
from ipaddress import ip_address
from typing import TYPE_CHECKING, Protocol

from lfield.errors import AddressError

if TYPE_CHECKING:
    from collections.abc import Callable

    from lfield.authority.identity import Identity
    from lfield.errors import CpuBudgetExceeded, LfieldError
    from lfield.net.coding.traffic_kinds import TrafficBytes
    from lfield.net.health.traffic import Delivery, TcpCounts
    from lfield.wire.coordinator_messages import Transfer
    from lfield.wire.framing import Buffer
    from lfield.wire.messages import Message, Role

#: Prefix of the address of a Unix socket, before its path.
UNIX = "unix:"
#: Prefix of an address in a Zenoh fabric, before its name; the prefix is part of the host.
ZENOH = "zenoh:"
_ZENOH_NAME = re.compile(r"[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*", re.ASCII)
#: Default port of a host (chapter IV, figure 4.9).
DEFAULT_PORT = 8181


class LinkHandler(Protocol):
    """The owner of a link, which receives its messages.

    A handler may raise WireError or HandshakeError: the link is then closed with that error.
    """

    def on_message(self, link: Link, message: Message) -> None:
        """A message arrived."""

    def on_transfer(self, link: Link, header: Transfer, block: memoryview) -> None:
        """A coordinator arrived. `block` is not copied and never changes."""

    def on_oversize(self, link: Link, header: Transfer, size: int) -> None:
        """A coordinator with an oversized block arrived; its `size` bytes were discarded."""

    def on_excess(self, link: Link, error: CpuBudgetExceeded) -> None:
        """The member at the other end exceeds its CPU budget: its messages are slowed down. If
        `error.closes`, the link is closed, and `on_closed` follows."""

    def on_closed(self, link: Link, error: LfieldError | None) -> None:
        """The link is closed; called once, last. `error` is None after a regular close by either side."""


class Link(Protocol):
    """An ordered, reliable stream of messages to one peer, until it closes."""

    @property
    def peer(self) -> str:
        """The address of the peer, for messages."""

    @property
    def identity(self) -> Identity:
        """The authenticated peer. The dialling side knows it when the link is made; the accepting side may
        see an unauthenticated peer until the first message."""

    @property
    def is_answered(self) -> bool:
        """Whether the peer has started a handshake."""

    @property
    def work(self) -> int:
        """The number of transfers and messages sent and received, without heartbeats and background
        reports."""

    @property
    def traffic(self) -> TrafficBytes:
        """The bytes sent and received, by kind."""

    def send(self, message: Message) -> None:
        """Queue a message. Raises AddressError on a closed link."""

    def send_transfer(self, header: Transfer, block: Buffer) -> None:
        """Queue a coordinator. The block must not change until an answer arrives or the link is closed.
        Raises AddressError on a closed link."""

    def accept_role(self, role: Role) -> None:
        """Accept the Hello of the peer: from now on the peer may send the messages that its role permits.

        Before that, any message except a Hello or a refusal closes the link.
        """

    def count_in(self, traffic: TrafficBytes) -> None:
        """From now on, also count bytes in `traffic`, together with those of other links."""

    def set_round_trip(self, round_trip: float) -> None:
        """Set the measured round trip in seconds, which determines retransmission time-outs."""

    def on_idle(self) -> None:
        """The link has been idle since the last call: acknowledgements may be delayed."""

    def counts(self) -> TcpCounts | None:
        """The kernel's counters of the connection; None if unavailable."""

    def delivery(self) -> Delivery | None:
        """The data that the kernel of this side has delivered; None if unavailable."""

    def set_handler(self, handler: LinkHandler) -> None:
        """Pass later messages, and the end of the link, to another handler."""

    def close(self) -> None:
        """Send queued data, if the peer accepts it soon, then close. Closing twice is allowed."""

    def abort(self) -> None:
        """Close at once and discard queued data. A closed link is ignored."""


class Listener(Protocol):
    """An open port."""

    @property
    def address(self) -> str:
        """The listening address, with the actual port if 0 was requested."""

    def close(self) -> None:
        """Stop accepting links. Existing links remain open."""


class Transport(Protocol):
    """A way to reach other hosts."""

    async def listen(self, address: str, on_link: Callable[[Link], LinkHandler]) -> Listener:
        """Listen; `on_link` returns the handler of each new link, and may send on it at once.

        Binds exactly this address; the caller restricts it to loopback. Of several addresses, it binds the
        addresses of this computer. Raises AddressError.
        """

    async def connect(self, address: str, handler: LinkHandler, host: str = "") -> Link:
        """Connect to a listener; `handler` may be called before `connect` returns.

        Of several addresses, an address at which a host other than `host` answers is skipped. Raises
        AddressError, and HandshakeError if a certificate is rejected by either side.
        """


def split_address(address: str) -> tuple[str, int]:
    """Host and port of "host", "host:port", "[v6]" or "[v6]:port", and "zenoh:name" with or without a port.

    Raises AddressError.
    """
    if is_zenoh(address):
        name, port_number = split_address(address.removeprefix(ZENOH))
        if not _ZENOH_NAME.fullmatch(name):
            raise AddressError(address, "a name in Zenoh has letters, digits, '-', '_' and '.'")
        return ZENOH + name, port_number
    if address.startswith("["):
        host, bracket, suffix = address[1:].partition("]")
        if not bracket or (suffix and not suffix.startswith(":")):
            raise AddressError(address, "an IPv6 address is written [ADDR] or [ADDR]:PORT")
        port = suffix[1:]
    else:
        host, _, port = address.partition(":")
    if not host:
        raise AddressError(address, "it names no host; write HOST or HOST:PORT")
    if not port and not address.endswith(":"):
        return host, DEFAULT_PORT
    if not (port.isascii() and port.isdigit() and int(port) <= 65535):
        raise AddressError(address, f"'{port}' is not a port; write a number from 0 to 65535")
    return host, int(port)


def split_addresses(address: str) -> tuple[str, ...]:
    """The addresses of a host, each for `split_address`, in order of preference."""
    return tuple(address.split(","))


def join_address(host: str, port: int) -> str:
    """The inverse of `split_address`."""
    return f"[{host}]:{port}" if ":" in host and not is_zenoh(host) else f"{host}:{port}"


def is_zenoh(address: str) -> bool:
    """Whether an address, or the host of an address, is in a Zenoh fabric; "zenoh:8181" is a host of this
    name.
    """
    return address.startswith(ZENOH) and not address.removeprefix(ZENOH).isdigit()


def has_zenoh(address: str) -> bool:
    """Whether one of the addresses of a host is in a Zenoh fabric."""
    return any(map(is_zenoh, split_addresses(address)))


def is_lasting(host: str) -> bool:
    """Whether a host is a fixed address; the interface of a zone may reappear with another number."""
    try:
        return getattr(ip_address(host), "scope_id", None) is None
    except ValueError:
        return False


def is_this_computer(address: str) -> bool:
    """Whether the peer at an IP address with a port is on this computer."""
    try:
        return ip_address(split_address(address)[0]).is_loopback
    except (AddressError, ValueError):
        return False


def is_number(address: str) -> bool:
    """Whether `address` contains only IP addresses, which need no lookup."""
    try:
        for each in split_addresses(address):
            ip_address(split_address(each)[0])
    except (AddressError, ValueError):
        return False
    return True
