"""Where a page is served: for this computer alone, or on a network under the names of a certificate."""

from __future__ import annotations

import errno
import random
import ssl
from collections.abc import Callable
from dataclasses import dataclass
from ipaddress import ip_address
from typing import TYPE_CHECKING

from lfield.authority.web_ca.web_names import address_in
from lfield.errors import AddressError, KeysError
from lfield.net.connections.listener import PortListener
from lfield.net.connections.resolver import resolve
from lfield.net.connections.socket_errors import describe
from lfield.net.tls import as_file
from lfield.net.transport import join_address, split_address
from lfield.operator.web.accept_limiter import AcceptLimiter

if TYPE_CHECKING:
    from lfield.authority.web_ca.web_keys import WebKeys

LOOPBACK = "127.0.0.1"
#: The ports that browsers leave out.
_USUAL = {"http": 80, "https": 443}

_NOT_HERE = "it is no address of this computer; 'ip address' lists those that it has"
_LINK_LOCAL = "no browser opens a page at a link-local address of IPv6; give another address, or a name"
_UNKNOWN = "unknown host name: give an IP address"


@dataclass(frozen=True, slots=True)
class PageSite:
    """Where a page is served: its port, and the names by which browsers reach it, the first in the link.

    `limiter` takes the calls at the sockets of `listener`.
    """

    port: int
    names: tuple[str, ...]
    scheme: str
    limiter: AcceptLimiter
    listener: PortListener

    @property
    def addresses(self) -> list[str]:
        """What browsers name when they ask for the page, by each of its names."""
        return addresses_of(self.names, self.port, self.scheme)

    def link(self, token: str) -> str:
        """The link that opens the page."""
        return f"{self.scheme}://{self.addresses[0]}/?token={token}"

    def close(self) -> None:
        """Take no more calls."""
        self.listener.close()


def addresses_of(names: tuple[str, ...], port: int, scheme: str) -> list[str]:
    """Names with the port, which browsers leave out where it is the usual one."""
    joined = [join_address(name, port) for name in names]
    return [address.removesuffix(f":{port}") for address in joined] if port == _USUAL[scheme] else joined


async def local_site(port: int, note: Callable[[str], None]) -> PageSite:
    """A site for the browsers of this computer; on any free port for 0. Raises AddressError."""
    return await _opened((LOOPBACK, "localhost"), port, None, note)


async def network_site(name: str, port: int, keys: WebKeys, note: Callable[[str], None]) -> PageSite:
    """A site at an address of this computer, or where a name leads; by https, which these keys are for.

    A name is followed as long as the page is served; `note` takes a line about it. Raises AddressError,
    KeysError.
    """
    tls = _tls(keys)
    await _check(name)
    # A star is no name that a browser sends.
    others = [other for other in keys.names if other != name and not other.startswith("*")]
    return await _opened((name, *others), port, tls, note)


async def _opened(
    names: tuple[str, ...], port: int, tls: ssl.SSLContext | None, note: Callable[[str], None]
) -> PageSite:
    callers = AcceptLimiter(tls, random.SystemRandom())
    listener = PortListener(join_address(names[0], port), callers.serve, note, _why)
    await listener.open()
    real = split_address(listener.address)[1]
    return PageSite(real, names, "http" if tls is None else "https", callers, listener)


async def _check(name: str) -> None:
    """Raises AddressError for what is no place for a page on a network."""
    address = address_in(name)
    if address is not None:
        if address.version == 6 and address.is_link_local:
            raise AddressError(name, _LINK_LOCAL)
        return
    try:
        found = [str(at.address[0]) for at in await resolve(name, 0, passive=True)]
    except (OSError, UnicodeError):
        raise AddressError(name, _UNKNOWN) from None
    if all(ip_address(other.partition("%")[0]).is_loopback for other in found):
        raise AddressError(name, f"it is {found[0]} here, which no other computer reaches; give the address")


def _why(error: OSError | UnicodeError) -> str:
    return _NOT_HERE if getattr(error, "errno", None) == errno.EADDRNOTAVAIL else describe(error)


def _tls(keys: WebKeys) -> ssl.SSLContext:
    """TLS 1.3, which browsers have had since 2020. Raises KeysError for keys that OpenSSL cannot use."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    try:
        with as_file(keys.certificate) as certificate, as_file(keys.key) as key:
            context.load_cert_chain(certificate, key)
    except OSError as error:
        raise KeysError(f"the page's keys cannot be used: {error}; make them again") from None
    return context
