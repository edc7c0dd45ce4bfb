"""Peer credentials of Unix sockets (SO_PEERCRED): authentication of local processes by the kernel.

The user who runs the host, and root, have all permissions. Members of the group `lfield` may observe and
stop: they can enter the folder of a service's run, and of a run started by root or a member. Other users have
no permission.

A client accepts answers only from its own user, root, and members of the group `lfield`, since an answer may
claim that all hosts are stopped. Root accepts answers from all users: it lists the hosts of every user, and
has checked the owner of the folder.
"""

from __future__ import annotations

import grp
import os
import pwd
import socket
import struct
from collections.abc import Callable, Collection
from contextlib import suppress

from lfield.authority.identity import ALL_RIGHTS, ANONYMOUS, NO_RIGHTS, Identity, Right
from lfield.net.transport import UNIX, join_address

#: Name of a peer of a Unix socket in messages: it has no address.
LOCAL_CALLER = "a command on this computer"
#: Group whose members may observe and stop other users' hosts on this computer.
GROUP = "lfield"
ROOT = 0
GROUP_RIGHTS = frozenset({Right.OBSERVE, Right.STOP})

#: The fields of SO_PEERCRED: process, user, group.
_CREDENTIALS = struct.Struct("iII")
#: Linux: supplementary groups of the peer; Python has no name for it.
_SO_PEERGROUPS = 59
#: Python's limit for getsockopt: for a user in more than 256 groups, only the primary group counts.
_GROUPS = 1024


def identity_of_caller(unix_socket: socket.socket) -> Identity:
    """The process that connected to a Unix socket of this one."""
    return _peer_identity(unix_socket, caller_identity)


def identity_of_listener(unix_socket: socket.socket) -> Identity:
    """The process that listens at a Unix socket to which this one connected. The identity has all permissions
    in `may` if it is trusted.
    """
    return _peer_identity(unix_socket, listener_identity)


def _peer_identity(unix_socket: socket.socket, identity_of: Callable[..., Identity]) -> Identity:
    try:
        _, user, group = _CREDENTIALS.unpack(
            unix_socket.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        )
    except OSError:
        return ANONYMOUS
    return identity_of(user, {group, *_peer_groups(unix_socket)}, os.geteuid(), _group_id())


def listener_identity(user: int, groups: Collection[int], own: int, members: int | None) -> Identity:
    """The identity of a user who runs a host; `own` is the calling user, `members` the group lfield."""
    believed = own == ROOT or user in (own, ROOT) or (members is not None and members in groups)
    return Identity("local", _name_of(user), ALL_RIGHTS if believed else NO_RIGHTS)


def caller_identity(user: int, groups: Collection[int], own: int, members: int | None) -> Identity:
    """The identity of a calling user; the user `own` runs this host, `members` is the group lfield."""
    if user in (own, ROOT):
        may = ALL_RIGHTS
    elif members is not None and members in groups:
        may = GROUP_RIGHTS
    else:
        may = NO_RIGHTS
    return Identity("local", _name_of(user), may)


def _peer_groups(unix_socket: socket.socket) -> list[int]:
    try:
        data = unix_socket.getsockopt(socket.SOL_SOCKET, _SO_PEERGROUPS, _GROUPS)
    except OSError:
        return []
    return [number for (number,) in struct.iter_unpack("I", data[: len(data) // 4 * 4])]


def _group_id() -> int | None:
    with suppress(KeyError):
        return grp.getgrnam(GROUP).gr_gid
    return None


def shared_group_id() -> int | None:
    """The id of the group `lfield`, if this process may give files to it (root or a member)."""
    group = _group_id()
    return group if os.geteuid() == ROOT or group in (os.getegid(), *os.getgroups()) else None


def own_process_identity(owner: int) -> Identity:
    """The identity of this process at the control socket of a host run by the user `owner`."""
    return caller_identity(os.geteuid(), {os.getegid(), *os.getgroups()}, owner, _group_id())


def _name_of(user: int) -> str:
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return str(user)


def socket_address(name: str | tuple[str, int] | tuple[str, int, int, int]) -> str:
    """A socket address as transports write it: IPv6 in brackets, with its zone if any."""
    if isinstance(name, str):
        return f"{UNIX}{name}" if name else LOCAL_CALLER
    host, port, zone = name[0], name[1], name[3] if len(name) == 4 else 0
    if host.startswith("::ffff:") and "." in host:
        # An IPv4 peer of a socket for both families.
        host = host.removeprefix("::ffff:")
    if zone and "%" not in host:
        try:
            host = f"{host}%{socket.if_indextoname(zone)}"
        except OSError:
            host = f"{host}%{zone}"
    return join_address(host, port)
