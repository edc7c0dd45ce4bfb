"""What this machine is called and which addresses are its own."""

from __future__ import annotations

import errno
import socket
from collections.abc import Sequence

from lfield.errors import AddressError, UsageError
from lfield.net.tcp import refusal
from lfield.net.transport import join_address, split_address


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
        for family, _, _, _, found in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
            _bind(family, found)
    except (OSError, UnicodeError) as error:
        if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
            raise AddressError(address, refusal(error)) from None


def _bind(family: int, address: tuple[str | int | bytes, ...]) -> None:
    """Have an address for a moment, as a host would: what is left of the last one's links does not count."""
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        probe.bind(address)


def reserve(address: str) -> tuple[socket.socket, str]:
    """A listening socket, to be inherited by another process, and its address; port 0 takes a free one.

    Raises AddressError.
    """
    host, port = split_address(address)
    try:
        family, _, _, _, found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        reserved = socket.create_server(found[:2], family=family)
    except (OSError, UnicodeError) as error:
        raise AddressError(address, refusal(error)) from None
    reserved.set_inheritable(True)
    return reserved, join_address(*reserved.getsockname()[:2])
