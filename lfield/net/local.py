"""What this machine is called and which addresses are its own."""

from __future__ import annotations

import errno
import socket
from collections.abc import Sequence

from lfield.errors import AddressError, UsageError
from lfield.net.door import socket_address
from lfield.net.paths.listener import bound
from lfield.net.paths.names import numbers_of
from lfield.net.paths.reasons import refusal
from lfield.net.transport import split_address


def own_host(hosts: Sequence[str]) -> str:
    """The host of a deployment that this machine is, by name or address. Raises UsageError."""
    names = {
        socket.gethostname().lower(),
        socket.getfqdn().lower(),
        socket.gethostname().lower().split(".")[0],
    }
    named = [host for host in hosts if host.lower() in names]
    found = named or [host for host in hosts if _is_own_address(host)]
    if len(found) == 1:
        return found[0]
    which = "several hosts" if found else "no host"
    raise UsageError(
        f"{which} of the deployment ({', '.join(hosts)}) is this machine ({socket.gethostname()}); "
        "name one with --host, or run all of them here with --all"
    )


def _is_own_address(host: str) -> bool:
    """Whether the name leads to an address that a socket of this machine can be bound to."""
    try:
        candidates = socket.getaddrinfo(split_address(host)[0], 0, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError, AddressError):
        return False
    for family, kind, protocol, _, address in candidates:
        try:
            with socket.socket(family, kind, protocol) as probe:
                probe.bind(address)
                return True
        except OSError:
            continue
    return False


def insist_on_free(address: str) -> None:
    """See that nobody listens there. Raises AddressError.

    What else may be wrong with an address is told when a host listens there.
    """
    host, port = split_address(address)
    try:
        for at in numbers_of(host, port):
            bound(at, port).close()
    except (OSError, UnicodeError) as error:
        if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
            raise AddressError(address, refusal(error)) from None


def reserve(address: str) -> tuple[socket.socket, str]:
    """A listening socket, to be inherited by another process, and its address; port 0 takes a free one.

    Of a name the first address that is one of this computer. Raises AddressError.
    """
    host, port = split_address(address)
    refused: OSError | UnicodeError | None = None
    try:
        for at in numbers_of(host, port):
            try:
                reserved = bound(at, port)
            except OSError as error:
                refused = refused or error
                continue
            reserved.setblocking(True)
            reserved.listen()
            reserved.set_inheritable(True)
            return reserved, socket_address(reserved.getsockname())
    except (OSError, UnicodeError) as error:
        refused = error
    raise AddressError(address, refusal(refused or OSError(errno.EADDRNOTAVAIL, ""))) from None
