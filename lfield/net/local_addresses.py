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
    matches = named or [
        host for host in hosts if any(map(_is_own_address, split_addresses(addresses.get(host, host))))
    ]
    if len(matches) == 1:
        return matches[0]
    subject = "several hosts" if matches else "no host"
    raise UsageError(
        f"{subject} of the deployment ({', '.join(hosts)}) is this machine ({socket.gethostname()}); "
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
    for part in split_addresses(address):
        try:
            for endpoint in _resolved(part):
                bound_socket(endpoint, endpoint.address[1]).close()
        except (OSError, UnicodeError) as error:
            if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
                raise AddressError(part, describe(error)) from None


def _resolved(address: str) -> Iterator[ResolvedAddress]:
    for each in split_addresses(address):
        yield from resolve_blocking(*split_address(each))


def open_listening_socket(address: str) -> tuple[socket.socket, str]:
    """A listening socket for another process, and its address; port 0 chooses a free port.

    Of several addresses, the first of this computer. Raises AddressError.
    """
    first_error: OSError | UnicodeError | None = None
    try:
        for endpoint in _resolved(address):
            try:
                listening = bound_socket(endpoint, endpoint.address[1])
            except OSError as error:
                first_error = first_error or error
                continue
            listening.setblocking(True)
            listening.listen()
            listening.set_inheritable(True)
            return listening, socket_address(listening.getsockname())
    except (OSError, UnicodeError) as error:
        first_error = error
    raise AddressError(address, describe(first_error or OSError(errno.EADDRNOTAVAIL, ""))) from None
