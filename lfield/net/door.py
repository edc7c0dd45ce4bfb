"""Who calls at a Unix socket of this computer: the kernel says it, and nobody can say otherwise.

The user who runs the host, and root, may all. Members of the group `lfield` may look, and make everything
safe; they are those that a service's folder lets in. Anybody else may nothing.
"""

from __future__ import annotations

import grp
import os
import pwd
import socket
import struct
from collections.abc import Collection
from contextlib import suppress

from lfield.authority.identity import ALL, NONE, STRANGER, Identity, Right

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
    """The process at the other end of a Unix socket."""
    try:
        _, user, group = _CREDENTIALS.unpack(
            made.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        )
    except OSError:
        return STRANGER
    return local(user, {group, *_other_groups(made)}, os.geteuid(), _number_of_group())


def local(user: int, groups: Collection[int], own: int, members: int | None) -> Identity:
    """A user of this computer, by number and groups; `own` runs this host, `members` is the group lfield."""
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


def oneself(owner: int) -> Identity:
    """This process, as the door of a host takes it that the user `owner` runs."""
    return local(os.geteuid(), {os.getegid(), *os.getgroups()}, owner, _number_of_group())


def _name_of(user: int) -> str:
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return str(user)
