"""Local users that connect to the Unix socket of a host, and the user that runs the host.

Each caller is a separate process. If root runs the tests, the caller runs as its user with the user's groups,
this process runs the host as another user, and the kernel reports the peer credentials to both. Without root
no process can change its user: the answers of the kernel are replaced for the other callers.
"""

from __future__ import annotations

import asyncio
import grp
import os
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
from asyncio.trsock import TransportSocket
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest
from link_attacker import Attacker, ask_at_socket, send_messages

from lfield.net import peer_credentials
from lfield.net.link_manager import LinkManager
from lfield.wire.codec import CONTROL, decode, encode
from lfield.wire.framing import HEADER_SIZE
from lfield.wire.messages import Message

#: Linux: the supplementary groups of the peer process.
_SO_PEERGROUPS = 59
_ROOTS_TESTS = os.geteuid() == peer_credentials.ROOT
#: The line that makes the process change to its user.
_BECOME = b"\n"


class User(msgspec.Struct, frozen=True):
    """A user by number, with a group of the same number, and whether it is in the group of
    `peer_credentials.py`.
    """

    number: int
    member: bool = False

    @property
    def groups(self) -> list[int]:
        """The supplementary groups of the user."""
        return [grp.getgrnam(peer_credentials.GROUP).gr_gid] if self.member else []


ROOT, OWNER = User(peer_credentials.ROOT), User(1000 if _ROOTS_TESTS else os.geteuid())
SERVICE = User(OWNER.number, member=True)
#: By row: the caller, and the user that runs the host. Service and member are in the group, others not.
SOCKET_USERS = {
    "same": (OWNER, OWNER),
    "root": (ROOT, OWNER),
    "root_service": (ROOT, SERVICE),
    "member": (User(OWNER.number + 1, member=True), SERVICE),
    "user": (User(OWNER.number + 2), SERVICE),
}


class UserTask(msgspec.Struct):
    """A task of a user at a socket: send these messages, or send one as a command of lfield."""

    socket: str
    messages: list[bytes]
    asks: bytes = b""


class Outcome(msgspec.Struct):
    """The result: the received messages, and whether the command was answered."""

    received: list[bytes] = []
    answered: bool = False


class SocketRow(msgspec.Struct):
    """The caller, the user that runs the host, and the name of the group on this computer."""

    caller: User
    host: User
    group: str


# --- the process of the tests -------------------------------------------------------------------------------


class Users:
    """All users; each process starts when it is first needed."""

    def __init__(self) -> None:
        self._left = ExitStack()
        self._known: dict[str, SocketUser] = {}

    def __enter__(self) -> Users:
        patch = self._left.enter_context(pytest.MonkeyPatch.context())
        patch.setattr(peer_credentials, "GROUP", _group())
        # The folder admits all users: its rights are not tested here.
        self._folder = Path(self._left.enter_context(tempfile.TemporaryDirectory(prefix="lfield-door-")))
        shutil.chown(self._folder, OWNER.number)
        self._folder.chmod(0o701)
        return self

    def __exit__(self, *_: object) -> None:
        self._left.close()

    @contextmanager
    def at_socket(self, who: str, rehearse: Callable[[SocketUser], None]) -> Iterator[SocketUser]:
        """The user of a row, while this process is the user that runs the host.

        Other users may be unable to read Python's own files: each action is rehearsed before, so that all
        modules are imported before the process changes its user.
        """
        caller, host = SOCKET_USERS[who]
        if who not in self._known:
            process = self._left.enter_context(_process(SocketRow(caller, host, peer_credentials.GROUP)))
            user = self._known[who] = SocketUser(process, f"unix:{self._folder}/door")
            rehearse(user)
            user.change_user()
        with _acting_as(host, caller):
            yield self._known[who]


@dataclass
class SocketUser:
    """A user, and the place of the host's socket."""

    _process: subprocess.Popen[bytes]
    _socket: str

    def change_user(self) -> None:
        """Change from the user of the tests to this user."""
        self._answer(_BECOME)

    async def listen(self, peers: LinkManager) -> None:
        """Open the socket for all users."""
        await peers.open("")
        await peers.open_control_socket(self._socket)
        Path(self._socket.removeprefix("unix:")).chmod(0o666)

    async def send(self, messages: list[bytes]) -> list[Message]:
        """Send messages; returns the received ones."""
        outcome = await self._sent_on(UserTask(self._socket, messages))
        return [decode(frame[HEADER_SIZE - 1], frame[HEADER_SIZE:]) for frame in outcome.received]

    async def asked(self, message: Message) -> bool:
        """Send a message as a command of lfield; returns whether it was answered."""
        return (await self._sent_on(UserTask(self._socket, [], encode(message)))).answered

    async def _sent_on(self, errand: UserTask) -> Outcome:
        return await asyncio.to_thread(self._turn, errand)

    def _turn(self, errand: UserTask) -> Outcome:
        return msgspec.json.decode(self._answer(msgspec.json.encode(errand) + b"\n"), type=Outcome)

    def _answer(self, line: bytes) -> bytes:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(line)
        self._process.stdin.flush()
        return self._process.stdout.readline()


def _group() -> str:
    """A group of this computer that is not the own group of any of these users."""
    used_ids = {peer_credentials.ROOT, *(user.number for row in SOCKET_USERS.values() for user in row)}
    return next(group.gr_name for group in grp.getgrall() if group.gr_gid not in used_ids)


@contextmanager
def _process(cast: SocketRow) -> Iterator[subprocess.Popen[bytes]]:
    """The process of a user, until its input ends."""
    command = [sys.executable, __file__, msgspec.json.encode(cast).decode()]
    folders = [str(Path(__file__).parent), *sys.path]
    environment: Mapping[str, str] = {**os.environ, "PYTHONPATH": os.pathsep.join(folders)}
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment) as process:
        yield process


@contextmanager
def _acting_as(user: User, other: User) -> Iterator[None]:
    """Act as a user within this context, with another user as the peer of every Unix socket."""
    with pytest.MonkeyPatch.context() as patch:
        if not _ROOTS_TESTS:
            replace_peer_credentials(patch, user, other)
            yield
            return
        groups = os.getgroups()
        os.setgroups(user.groups)
        os.setegid(user.number)
        os.seteuid(user.number)
        try:
            yield
        finally:
            os.seteuid(peer_credentials.ROOT)
            os.setegid(peer_credentials.ROOT)
            os.setgroups(groups)


# --- both processes -----------------------------------------------------------------------------------------


def replace_peer_credentials(patch: pytest.MonkeyPatch, user: User, other: User) -> None:
    """Replace the kernel's answers about another user; nothing if both are the user of the tests."""
    if user.number == other.number == os.geteuid() and not user.member and not other.member:
        return
    kernel: Any = TransportSocket.getsockopt
    results = {
        socket.SO_PEERCRED: struct.pack("iII", os.getpid(), other.number, other.number),
        _SO_PEERGROUPS: struct.pack(f"{len(other.groups)}I", *other.groups),
    }

    def getsockopt(made: TransportSocket, level: int, option: int, size: int = 0) -> int | bytes:
        asks = level == socket.SOL_SOCKET and option in results
        return results[option] if asks else kernel(made, level, option, *([size] if size else []))

    patch.setattr(TransportSocket, "getsockopt", getsockopt)
    patch.setattr(os, "geteuid", lambda: user.number)


# --- the process of the caller ------------------------------------------------------------------------------


def main() -> None:
    """Perform tasks, first as the user of the tests, and then permanently as another user."""
    cast = msgspec.json.decode(sys.argv[1], type=SocketRow)
    peer_credentials.GROUP = cast.group
    for line in sys.stdin.buffer:
        outcome = Outcome()
        if line == _BECOME:
            _become(cast)
        else:
            outcome = asyncio.run(_perform(msgspec.json.decode(line, type=UserTask)))
        print(msgspec.json.encode(outcome).decode(), flush=True)


def _become(cast: SocketRow) -> None:
    if not _ROOTS_TESTS:
        replace_peer_credentials(pytest.MonkeyPatch(), cast.caller, cast.host)
        return
    os.setgroups(cast.caller.groups)
    os.setgid(cast.caller.number)
    os.setuid(cast.caller.number)


async def _perform(errand: UserTask) -> Outcome:
    if errand.asks:
        message = decode(CONTROL, errand.asks[HEADER_SIZE:])
        return Outcome(answered=await ask_at_socket(errand.socket, message))
    attacker = Attacker(None)
    await send_messages(attacker, errand.socket, errand.messages)
    return Outcome([encode(message) for message in attacker.received])


if __name__ == "__main__":
    main()
