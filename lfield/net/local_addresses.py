"""The names and addresses of this computer."""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator, Mapping, Sequence

from lfield.errors import AddressError, UsageError
from lfield.net.connections.listener import bound_socket
from lfield.net.connections.resolver import ResolvedAddress, resolve_blocking
from lfield.net.connections.socket_errors import describe
from lfield.net.peer_credentials import socket_address
from lfield.net.transport import split_address, split_addresses


def own_host(hosts: Sequence[str], addresses: Mapping[str, str]) -> str:
    """The host of a deployment that is this computer, by name or address. Raises UsageError.

    The address of a host without an entry in `addresses` is its name.
    """
    names = {
        socket.gethostname().lower(),
        socket.getfqdn().lower(),
        socket.gethostname().lower().split(".")[0],
    }
    named = [host for host in hosts if host.lower() in names]
    found = named or [
        host for host in hosts if any(map(_is_own_address, split_addresses(addresses.get(host, host))))
    ]
    if len(found) == 1:
        return found[0]
    which = "several hosts" if found else "no host"
    raise UsageError(
        f"{which} of the deployment ({', '.join(hosts)}) is this machine ({socket.gethostname()}); "
        "name one with --host, or run all of them here with --all"
    )


def _is_own_address(address: str) -> bool:
    """Whether the host of `address` resolves to an address of this computer."""
    try:
        candidates = socket.getaddrinfo(split_address(address)[0], 0, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError, AddressError):
        return False
    for family, kind, protocol, _, resolved in candidates:
        try:
            with socket.socket(family, kind, protocol) as probe:
                probe.bind(resolved)
                return True
        except OSError:
            continue
    return False


def require_port_free(address: str) -> None:
    """Check that a port is free. Raises AddressError.

    Other errors of an address are reported when a host listens there.
    """
    for each in split_addresses(address):
        try:
            for at in _resolved(each):
                bound_socket(at, at.address[1]).close()
        except (OSError, UnicodeError) as error:
            if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
                raise AddressError(each, describe(error)) from None


def _resolved(address: str) -> Iterator[ResolvedAddress]:
    for each in split_addresses(address):
        yield from resolve_blocking(*split_address(each))


def open_listening_socket(address: str) -> tuple[socket.socket, str]:
    """A listening socket for another process, and its address; port 0 chooses a free port.

    Of several addresses, the first of this computer. Raises AddressError.
    """
    refused: OSError | UnicodeError | None = None
    try:
        for at in _resolved(address):
            try:
                reserved = bound_socket(at, at.address[1])
            except OSError as error:
                refused = refused or error
                continue
            reserved.setblocking(True)
            reserved.listen()
            reserved.set_inheritable(True)
            return reserved, socket_address(reserved.getsockname())
    except (OSError, UnicodeError) as error:
        refused = error
    raise AddressError(address, describe(refused or OSError(errno.EADDRNOTAVAIL, ""))) from None
