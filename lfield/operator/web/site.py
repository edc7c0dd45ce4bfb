"""Where a page is served: for this computer alone, or on a network under the names of a certificate."""

from __future__ import annotations

import errno
import socket
import ssl
from dataclasses import dataclass
from ipaddress import ip_address
from typing import TYPE_CHECKING

from lfield.errors import AddressError, KeysError
from lfield.net.paths.reasons import refusal
from lfield.net.tls import as_file
from lfield.net.transport import join_address

if TYPE_CHECKING:
    from lfield.authority.pages.page_keys import PageKeys

LOOPBACK = "127.0.0.1"
#: The ports that browsers leave out.
_USUAL = {"http": 80, "https": 443}

_NOT_HERE = "it is no address of this computer; 'ip address' lists those that it has"


@dataclass(frozen=True, slots=True)
class Site:
    """A socket that listens, and the names by which browsers reach it, the first in the link; maybe TLS."""

    opened: socket.socket
    names: tuple[str, ...]
    tls: ssl.SSLContext | None = None

    @property
    def scheme(self) -> str:
        """http or https."""
        return "http" if self.tls is None else "https"

    @property
    def port(self) -> int:
        """The port on which it listens."""
        port: int = self.opened.getsockname()[1]
        return port

    @property
    def addresses(self) -> list[str]:
        """What browsers name when they ask for the page, by each of its names."""
        joined = [join_address(name, self.port) for name in self.names]
        if self.port == _USUAL[self.scheme]:
            return [address.removesuffix(f":{self.port}") for address in joined]
        return joined

    def link(self, token: str) -> str:
        """The link that opens the page."""
        return f"{self.scheme}://{self.addresses[0]}/?token={token}"


def on_this_computer(port: int) -> Site:
    """A site for the browsers of this computer; on any free port for 0. Raises AddressError."""
    return Site(_listening(LOOPBACK, port), (LOOPBACK, "localhost"))


def on_a_network(name: str, port: int, keys: PageKeys) -> Site:
    """A site at an address of this computer, or at that of a name; by https, which these keys are for.

    Raises AddressError, KeysError.
    """
    tls = _tls(keys)
    # A star is no name that a browser sends.
    others = [other for other in keys.names if other != name and not other.startswith("*")]
    return Site(_listening(_address_of(name), port), (name, *others), tls)


def _address_of(name: str) -> str:
    """The address of a name that other computers reach, or the address itself. Raises AddressError."""
    try:
        return str(ip_address(name))
    except ValueError:
        pass
    try:
        rows = socket.getaddrinfo(name, None, type=socket.SOCK_STREAM)
    except OSError:
        raise AddressError(name, "nobody here knows the address of that name; give the address") from None
    found = [str(row[4][0]) for row in rows]
    for address in found:
        if not ip_address(address.partition("%")[0]).is_loopback:
            return address
    raise AddressError(name, f"it is {found[0]} here, which no other computer reaches; give the address")


def _listening(address: str, port: int) -> socket.socket:
    """A socket on which the page is served. Raises AddressError."""
    opened = socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET, socket.SOCK_STREAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        opened.bind((address, port))
        # Whoever opens the link at once is not turned away.
        opened.listen()
    except OSError as error:
        opened.close()
        why = _NOT_HERE if error.errno == errno.EADDRNOTAVAIL else refusal(error)
        raise AddressError(join_address(address, port), why) from None
    return opened


def _tls(keys: PageKeys) -> ssl.SSLContext:
    """TLS 1.3, which browsers have had since 2020. Raises KeysError for keys that OpenSSL cannot use."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    try:
        with as_file(keys.certificate) as certificate, as_file(keys.key) as key:
            context.load_cert_chain(certificate, key)
    except OSError as error:
        raise KeysError(f"the page's keys cannot be used: {error}; make them again") from None
    return context
