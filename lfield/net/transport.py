"""What a transport is: listen, connect, and links that carry messages and blocks.

`tcp` is the real one and `memory` the one for tests and simulation; `lfield.testing.transport_kit` holds
what both must do. Addresses are "host:port" strings; IPv6 hosts stand in brackets.

All calls and callbacks happen on one thread. Callbacks never happen inside `send`, `send_transfer` or
`close`, so a caller need not expect its own state to change under it.
"""

from __future__ import annotations

from ipaddress import ip_address
from typing import TYPE_CHECKING, Protocol

from lfield.errors import AddressError

if TYPE_CHECKING:
    from collections.abc import Callable

    from lfield.authority.identity import Identity
    from lfield.errors import LfieldError, OverBudget
    from lfield.net.health.traffic import Counts
    from lfield.wire.coordinators import Transfer
    from lfield.wire.framing import Buffer
    from lfield.wire.messages import Message, Role

#: What the address of a Unix socket begins with; the path follows.
UNIX = "unix:"
#: The port of a host whose address gives none (chapter IV, figure 4.9).
DEFAULT_PORT = 8181


class LinkHandler(Protocol):
    """Whoever owns a link and hears what comes out of it.

    A handler may raise WireError or GreetingError: the link is then closed with that error.
    """

    def on_message(self, link: Link, message: Message) -> None:
        """A message arrived."""

    def on_transfer(self, link: Link, header: Transfer, block: memoryview) -> None:
        """A coordinator arrived. `block` is not copied and never changes; keep it only if you mean to."""

    def on_oversize(self, link: Link, header: Transfer, size: int) -> None:
        """A coordinator with a block over the limit came by; its `size` bytes were thrown away."""

    def on_excess(self, link: Link, error: OverBudget) -> None:
        """The member at the other end is over its budget of processing time: its messages are taken more
        slowly. Where `error.closes`, the link is closed, and `on_closed` follows when it is gone."""

    def on_closed(self, link: Link, error: LfieldError | None) -> None:
        """The link is gone; called once, last. `error` is None after a plain close by either side."""


class Link(Protocol):
    """An ordered, reliable stream of messages to one peer, until it closes."""

    @property
    def peer(self) -> str:
        """The address of the other end, for sentences."""

    @property
    def who(self) -> Identity:
        """Who is there, as proven. Whoever calls knows it when the link is made; whoever is called may take
        the other for a stranger until the first message has come."""

    @property
    def is_answered(self) -> bool:
        """Whether a handshake has begun that the other end began."""

    def send(self, message: Message) -> None:
        """Queue a message. Raises AddressError on a closed link."""

    def send_transfer(self, header: Transfer, block: Buffer) -> None:
        """Queue a coordinator. The block must not change before the link is done with it, which is when
        an answer to the transfer has come or the link is closed. Raises AddressError on a closed link."""

    def greeted(self, role: Role) -> None:
        """The peer's greeting is taken: from now on it may send what its role may.

        Until then only a greeting or a refusal passes, and anything else closes the link.
        """

    def expect(self, round_trip: float) -> None:
        """Answers take so many seconds: what is lost is sent again accordingly."""

    def counts(self) -> Counts | None:
        """What the kernel has counted of its connection; None where it tells nothing."""

    def close(self) -> None:
        """Send what is queued, if the peer takes it soon, then close. Closing twice is allowed."""

    def abort(self) -> None:
        """Close at once; what is queued is lost. It may be closed already."""


class Listener(Protocol):
    """An open port."""

    @property
    def address(self) -> str:
        """Where it listens, with the real port if 0 was asked for."""

    def close(self) -> None:
        """Take no more links. Those that exist stay."""


class Transport(Protocol):
    """A way to reach other hosts."""

    async def listen(self, address: str, on_link: Callable[[Link], LinkHandler]) -> Listener:
        """Listen there; `on_link` names the handler of each new link, and may send on it at once.

        Raises AddressError. Exactly the address is bound: it is for the caller to insist on loopback.
        """

    async def connect(self, address: str, handler: LinkHandler) -> Link:
        """A link to whoever listens there; `handler` may hear from it before this returns.

        Raises AddressError, and GreetingError where one of the two does not take the other's certificate.
        """


def split_address(address: str) -> tuple[str, int]:
    """Host and port of "host", "host:port", "[v6]" or "[v6]:port". Raises AddressError."""
    if address.startswith("["):
        host, bracket, rest = address[1:].partition("]")
        if not bracket or (rest and not rest.startswith(":")):
            raise AddressError(address, "an IPv6 address is written [ADDR] or [ADDR]:PORT")
        port = rest[1:]
    else:
        host, _, port = address.partition(":")
    if not host:
        raise AddressError(address, "it names no host; write HOST or HOST:PORT")
    if not port and not address.endswith(":"):
        return host, DEFAULT_PORT
    if not (port.isascii() and port.isdigit() and int(port) <= 65535):
        raise AddressError(address, f"'{port}' is not a port; write a number from 0 to 65535")
    return host, int(port)


def join_address(host: str, port: int) -> str:
    """The inverse of `split_address`."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def is_lasting(host: str) -> bool:
    """Whether a host is written as an address that stays what it is; a zone is the name of an interface,
    which may go and come back with another number."""
    try:
        return getattr(ip_address(host), "scope_id", None) is None
    except ValueError:
        return False


def is_number(address: str) -> bool:
    """Whether it is one of an interface, and no name that has to be looked up."""
    try:
        ip_address(split_address(address)[0])
    except (AddressError, ValueError):
        return False
    return True
