"""A connection to a robot over the system's ssh: one master process, and a session of it for each command.

The user's agent, configuration and known_hosts are used. No process has a terminal or an open stdin on which
ssh or sudo could ask for a password. The master ends when this process does: its session on the robot reads a
pipe whose other end is here.
"""

from __future__ import annotations

import asyncio
import io
import os
import shlex
import tarfile
import time
from asyncio.subprocess import PIPE, Process
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile

from lfield.errors import ProvisionError
from lfield.event_loop import run_process, start_child
from lfield.provision.plan import RobotUpload, RootCommand
from lfield.provision.robot_facts import ACCESS_SCRIPT, LoginAccess, parse_access
from lfield.provision.robot_scripts import locked_command
from lfield.provision.ssh_errors import (
    SshDestination,
    command_error,
    connection_error,
    is_unreachable,
    joined_error,
)

#: Seconds until an address counts as unreachable, and until a silent connection counts as lost.
CONNECT_TIMEOUT, ALIVE_INTERVAL, ALIVE_COUNT = 10, 5, 4
#: Seconds for the whole connection, key exchange and login included.
LOGIN_TIMEOUT = 30.0
_READY = b"lfield-provision-ready"
#: Printed before the output of a command: startup files of a login shell may print something too.
_OUTPUT = "lfield-provision-output"
_FAILED = 255
#: None of these may ask a person; all other options are those of the user's configuration.
_OPTIONS = (
    *("BatchMode=yes", f"ConnectTimeout={CONNECT_TIMEOUT}", "ConnectionAttempts=1"),
    *(f"ServerAliveInterval={ALIVE_INTERVAL}", f"ServerAliveCountMax={ALIVE_COUNT}"),
    *("RequestTTY=no", "RemoteCommand=none", "ForwardAgent=no", "ForwardX11=no", "ClearAllForwardings=yes"),
    *("LogLevel=INFO", "ControlPersist=no"),
)


class SshConnection:
    """The connection to host `host`; `socket` is that of its master, in a private folder."""

    def __init__(self, host: str, socket: Path) -> None:
        self.host, self._socket = host, socket
        self._master: Process | None = None
        self.destination = SshDestination("")
        self.access = LoginAccess("", -1, "")

    async def open(self, destinations: Sequence[SshDestination]) -> None:
        """Connect to the first destination that can be reached. Raises ProvisionError, which names all."""
        errors: list[ProvisionError] = []
        for destination in destinations:
            self.destination = destination
            message = await self._start_master()
            if not message:
                return
            errors.append(connection_error(self.host, destination, message))
            if not is_unreachable(message):
                break
        raise joined_error(errors)

    async def _start_master(self) -> str:
        """Start the master; returns the message of ssh if it fails."""
        # On a line of its own, also if the login shell has printed something.
        command = f"echo; echo {_READY.decode()}; exec cat"
        with _ssh_needed():
            self._master = master = await start_child(
                *self._ssh("ControlMaster=yes", command), stdin=PIPE, env=_environment()
            )
        assert master.stdout is not None
        printed = b""
        try:
            async with asyncio.timeout(LOGIN_TIMEOUT):
                while line := await master.stdout.readline():
                    if line.strip() == _READY:
                        return ""
                    printed = line.strip() or printed
                _, errors = await master.communicate()
        except TimeoutError:
            await self.close()
            return (
                f"Connection timed out: no login within {LOGIN_TIMEOUT:.0f} s; its shell may wait for input"
            )
        # The shell of a user who may not log in says so on its standard output.
        return (errors or printed).decode(errors="replace") or "Connection closed"

    def _ssh(self, role: str, command: str) -> list[str]:
        options = [argument for option in (*_OPTIONS, role) for argument in ("-o", option)]
        target = self.destination
        return ["ssh", *options, "-S", str(self._socket), *target.options(), "--", target.address, command]

    async def read_access(self) -> LoginAccess:
        """Determine the user that has logged in, and whether it may become root. Raises ProvisionError."""
        try:
            async with asyncio.timeout(LOGIN_TIMEOUT):
                output = await self.run(f"sh -c {shlex.quote(ACCESS_SCRIPT)}", "access")
        except TimeoutError:
            reason = f"sudo does not answer within {LOGIN_TIMEOUT:.0f} s"
            advice = f"try '{self.destination.command()} sudo -n true'"
            raise ProvisionError(self.host, reason, advice) from None
        try:
            self.access = parse_access(output)
        except ValueError as error:
            reason = f"its shell has answered '{error}'"
            raise ProvisionError(self.host, reason, "correct its addresses in the inventory") from None
        return self.access

    async def run(self, command: str, step: str, data: bytes | None = None) -> str:
        """Run a command line of the login shell; returns its output. Raises ProvisionError if it fails."""
        command = f"echo {_OUTPUT}; {command}"
        # A file, not a pipe: uvloop raises RuntimeError when a pipe is written whose process has ended.
        with TemporaryFile() as file:
            file.write(data or b"")
            file.seek(0)
            with _ssh_needed():
                status, output, errors = await run_process(
                    *self._ssh("ControlMaster=no", command), stdin=file, env=_environment()
                )
        message = errors.decode(errors="replace")
        if status == _FAILED and is_unreachable(message or "Connection closed"):
            raise connection_error(self.host, self.destination, message or "Connection closed")
        if status:
            raise command_error(self.host, step, status, message)
        return command_output(output.decode(errors="replace"))

    async def run_as_root(self, command: str, step: str, data: bytes | None = None) -> str:
        """Run a command line as root. Raises ProvisionError."""
        return await self.run(command if self.access.uid == 0 else f"sudo -n {command}", step, data)

    async def execute(self, command: RootCommand, step: str) -> str:
        """Run a script of root with its files. Raises ProvisionError."""
        return await self.run_as_root(locked_command(command.script), step, archive(command.uploads))

    async def close(self) -> None:
        """Disconnect."""
        if self._master is None:
            return
        if self._master.returncode is None:
            with suppress(ProcessLookupError):
                self._master.terminate()
            await self._master.wait()
        self._master = None


def _environment() -> dict[str, str]:
    return {**os.environ, "SSH_ASKPASS_REQUIRE": "never", "LC_ALL": "C.UTF-8"}


@contextmanager
def _ssh_needed() -> Iterator[None]:
    """Raises ProvisionError if there is no ssh."""
    try:
        yield
    except FileNotFoundError:
        advice = "sudo apt-get install openssh-client"
        raise ProvisionError("", "there is no ssh on this desk", advice) from None


def command_output(output: str) -> str:
    """The output of a command, without text that the login shell has printed before."""
    before, mark, after = output.partition(f"{_OUTPUT}\n")
    return after if mark else before


def archive(uploads: Iterable[RobotUpload]) -> bytes:
    """Files as a tar archive, owned by root."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.GNU_FORMAT) as tar:
        for upload in uploads:
            data = upload.source if isinstance(upload.source, bytes) else upload.source.read_bytes()
            entry = tarfile.TarInfo(upload.name)
            entry.size, entry.mode, entry.mtime = len(data), 0o600, int(time.time())
            tar.addfile(entry, io.BytesIO(data))
    return buffer.getvalue()
