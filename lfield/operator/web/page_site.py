"""Address of a page: on loopback, or on a network with https under the names of a certificate."""

from __future__ import annotations

import errno
import random
import ssl
from collections.abc import Callable
from ipaddress import ip_address
from typing import TYPE_CHECKING

from msgspec import Struct

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
#: Default ports, which browsers omit from addresses.
_USUAL = {"http": 80, "https": 443}

_NOT_HERE = "not an address of this computer; 'ip address' lists them"
_LINK_LOCAL = "browsers do not open link-local IPv6 addresses; give another address, or a name"
_UNKNOWN = "unknown host name: give an IP address"


class PageSite(Struct, frozen=True):
    """The port of a page and the names under which browsers reach it; the link has the first.

    `limiter` accepts connections at the sockets of `listener`.
    """

    port: int
    names: tuple[str, ...]
    scheme: str
    limiter: AcceptLimiter
    listener: PortListener

    @property
    def addresses(self) -> list[str]:
        """The Host headers of requests for the page, one for each name."""
        return addresses_of(self.names, self.port, self.scheme)

    def link(self, token: str) -> str:
        """The link that opens the page."""
        return f"{self.scheme}://{self.addresses[0]}/?token={token}"

    def close(self) -> None:
        """Accept no more connections."""
        self.listener.close()


def addresses_of(names: tuple[str, ...], port: int, scheme: str) -> list[str]:
    """Names with the port, without it for the default port of the scheme."""
    joined = [join_address(name, port) for name in names]
    return [address.removesuffix(f":{port}") for address in joined] if port == _USUAL[scheme] else joined


async def local_site(port: int, note: Callable[[str], None]) -> PageSite:
    """A site on loopback; port 0 takes any free one. Raises AddressError."""
    return await _opened((LOOPBACK, "localhost"), port, None, note)


async def network_site(name: str, port: int, keys: WebKeys, note: Callable[[str], None]) -> PageSite:
    """A site with https at an address of this computer, or at those to which a name resolves.

    The name is resolved repeatedly, and `note` gets a line when the address changes. Raises AddressError,
    KeysError.
    """
    tls = _tls(keys)
    await _check(name)
    # Browsers never send a wildcard name.
    others = [other for other in keys.names if other != name and not other.startswith("*")]
    return await _opened((name, *others), port, tls, note)


async def _opened(
    names: tuple[str, ...], port: int, tls: ssl.SSLContext | None, note: Callable[[str], None]
) -> PageSite:
    callers = AcceptLimiter(tls, random.SystemRandom())
    listener = PortListener(join_address(names[0], port), callers.serve, note, _bind_error_reason)
    await listener.open()
    real = split_address(listener.address)[1]
    return PageSite(real, names, "http" if tls is None else "https", callers, listener)


async def _check(name: str) -> None:
    """Raises AddressError for an address that other computers cannot reach."""
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
        raise AddressError(
            name, f"it resolves to {found[0]}, which other computers cannot reach; give the address"
        )


def _bind_error_reason(error: OSError | UnicodeError) -> str:
    return _NOT_HERE if getattr(error, "errno", None) == errno.EADDRNOTAVAIL else describe(error)


def _tls(keys: WebKeys) -> ssl.SSLContext:
    """A TLS 1.3 context. Raises KeysError for keys that OpenSSL cannot use."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    try:
        with as_file(keys.certificate) as certificate, as_file(keys.key) as key:
            context.load_cert_chain(certificate, key)
    except OSError as error:
        raise KeysError(
            f"the keys of the page cannot be used: {error}; create them again with 'lfield keys page'"
        ) from None
    return context
