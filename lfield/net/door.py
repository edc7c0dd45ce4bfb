"""Who is at the other end of a Unix socket of this computer: the kernel says it, and nobody else can.

The user who runs the host, and root, may all. Members of the group `lfield` may look, and make everything
safe; they are those that the folder of a service's run lets in, and that of a run that root or a member has
begun. Anybody else may nothing.

Whoever calls has to know whom it believes, for an answer may say that all is stopped: its own user, root, and
who is in the group `lfield`, as services are. Root believes everybody: it looks for the hosts of all users,
and has seen whose folder the socket is in.
"""

from __future__ import annotations

import grp
import os
import pwd
import socket
import struct
from collections.abc import Callable, Collection
from contextlib import suppress

from lfield.authority.identity import ALL, NONE, STRANGER, Identity, Right
from lfield.net.transport import UNIX, join_address

#: Whoever called at a Unix socket, in sentences: it has no address.
CALLER = "a command on this computer"
#: Whose members may observe and stop the hosts of others on this computer.
GROUP = "lfield"
ROOT = 0
MEMBERS = frozenset({Right.OBSERVE, Right.STOP})

#: What SO_PEERCRED gives: a process, its user and its group.
_CREDENTIALS = struct.Struct("iII")
#: Linux: the other groups of the process at the other end; Python has no name for it.
_SO_PEERGROUPS = 59
#: Python asks for no more bytes at once: whoever is in over 256 groups counts by the first of them alone.
_GROUPS = 1024


def caller_at(made: socket.socket) -> Identity:
    """The process that has called at a Unix socket of this one."""
    return _other_end(made, local)


def host_at(made: socket.socket) -> Identity:
    """The process that listens at a Unix socket that this one calls. It `may` all when it is believed."""
    return _other_end(made, listening)


def _other_end(made: socket.socket, judged: Callable[..., Identity]) -> Identity:
    try:
        _, user, group = _CREDENTIALS.unpack(
            made.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        )
    except OSError:
        return STRANGER
    return judged(user, {group, *_other_groups(made)}, os.geteuid(), _number_of_group())


def listening(user: int, groups: Collection[int], own: int, members: int | None) -> Identity:
    """A user who runs a host, by number and groups; `own` has called, `members` is the group lfield."""
    believed = own == ROOT or user in (own, ROOT) or (members is not None and members in groups)
    return Identity("local", _name_of(user), ALL if believed else NONE)


def local(user: int, groups: Collection[int], own: int, members: int | None) -> Identity:
    """A user who has called, by number and groups; `own` runs this host, `members` is the group lfield."""
    if user in (own, ROOT):
        may = ALL
    elif members is not None and members in groups:
        may = MEMBERS
    else:
        may = NONE
    return Identity("local", _name_of(user), may)


def _other_groups(made: socket.socket) -> list[int]:
    try:
        data = made.getsockopt(socket.SOL_SOCKET, _SO_PEERGROUPS, _GROUPS)
    except OSError:
        return []
    return [number for (number,) in struct.iter_unpack("I", data[: len(data) // 4 * 4])]


def _number_of_group() -> int | None:
    with suppress(KeyError):
        return grp.getgrnam(GROUP).gr_gid
    return None


def sharing() -> int | None:
    """The number of the group `lfield`, where this process may give files to it: as root, or as a member."""
    group = _number_of_group()
    return group if os.geteuid() == ROOT or group in (os.getegid(), *os.getgroups()) else None


def oneself(owner: int) -> Identity:
    """This process, as the door of a host takes it that the user `owner` runs."""
    return local(os.geteuid(), {os.getegid(), *os.getgroups()}, owner, _number_of_group())


def _name_of(user: int) -> str:
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return str(user)


def socket_address(name: str | tuple[str, int] | tuple[str, int, int, int]) -> str:
    """The address of a socket, as transports have them: IPv6 in brackets, with its zone if it has one."""
    if isinstance(name, str):
        return f"{UNIX}{name}" if name else CALLER
    host, port, zone = name[0], name[1], name[3] if len(name) == 4 else 0
    if host.startswith("::ffff:") and "." in host:
        # Of a socket for both families.
        host = host.removeprefix("::ffff:")
    if zone and "%" not in host:
        try:
            host = f"{host}%{socket.if_indextoname(zone)}"
        except OSError:
            host = f"{host}%{zone}"
    return join_address(host, port)
