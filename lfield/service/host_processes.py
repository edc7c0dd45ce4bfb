"""Processes of the mission's host, as the service starts and observes them."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import BinaryIO

import msgspec

from lfield.errors import InputFileError, OutputFileError
from lfield.host.process.run_result import MAX_RESULT, RunResult
from lfield.service.mission_runner import KILLED, HostEnd, HostProcess, ProcessId

_BOOT = Path("/proc/sys/kernel/random/boot_id")
#: The option of `lfield up` with the descriptor of the file for its result.
RESULT_OPTION = "--result-fd"


class LocalProcesses:
    """See `mission_runner.HostProcesses`.

    `bundle_path` returns the file of a bundle; `options` are those of `lfield up`. The host writes its result
    to the file `result`, so that the next service knows its end.
    """

    def __init__(
        self, host: str, bundle_path: Callable[[bytes], Path], options: Sequence[str], result: Path
    ) -> None:
        self._host, self._bundle_path, self._options, self._result = host, bundle_path, options, result
        self._children: dict[int, subprocess.Popen[bytes]] = {}

    @property
    def boot(self) -> str:
        """The id of this boot of the computer."""
        return _BOOT.read_text().strip()

    def start(self, bundle: bytes) -> ProcessId:
        """Start the host of a bundle. Raises OutputFileError, InputFileError."""
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
        try:
            result = os.open(self._result, flags, 0o600)
        except OSError as error:
            raise OutputFileError(str(self._result), error.strerror or str(error)) from None
        command = [sys.executable, "-P", "-m", "lfield", "up", str(self._bundle_path(bundle))]
        command += [f"--host={self._host}", f"{RESULT_OPTION}={result}", *self._options]
        try:
            # Its own session: a Ctrl-C at the service's terminal is for the service, which stops the host in
            # order.
            child = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                pass_fds=(result,),
                start_new_session=True,
            )
        except OSError as error:
            raise InputFileError(sys.executable, error.strerror or str(error)) from None
        finally:
            os.close(result)
        self._children[child.pid] = child
        return ProcessId(child.pid, _started(child.pid) or 0)

    def find(self) -> HostProcess | None:
        """The host that an earlier service has started, also one that is not recorded; None without one.

        The process is identified by its command line: of this user, with the name of the host and a bundle of
        this service.
        """
        found = [host for host in map(self._host_in, _processes()) if host is not None]
        # A process that the host forks has the same command line for a moment.
        return min(found, key=lambda each: each.process.started, default=None)

    def _host_in(self, pid: int) -> HostProcess | None:
        """The host that runs as a process, if it is one of this service."""
        arguments = _command_line(pid)
        if {"up", f"--host={self._host}"} <= {*arguments} and (started := _started(pid)) is not None:
            for argument in arguments:
                if (digest := self._digest_of(argument)) is not None:
                    return HostProcess(digest, ProcessId(pid, started))
        return None

    def _digest_of(self, argument: str) -> bytes | None:
        """The digest of a bundle of this service; None for any other argument."""
        with suppress(ValueError):
            digest = bytes.fromhex(Path(argument).stem)
            return digest if self._bundle_path(digest) == Path(argument) else None
        return None

    def is_alive(self, process: ProcessId) -> bool:
        """Whether the process still runs."""
        return _started(process.pid) == process.started

    async def ended(self, process: ProcessId) -> HostEnd:
        """The end of a process, when it has ended."""
        with ExitStack() as stack:
            file = self._open_result(process)
            if file is not None:
                stack.enter_context(file)
            await _wait(process)
            result = _read_result(file)
        child = self._children.pop(process.pid, None)
        status = child.wait() if child is not None else None
        if status is None or (status < 0 and result.status is not None):
            # A signal after the end has not changed it.
            status = result.status
        return HostEnd(KILLED if status is None else status, result.reason)

    def terminate(self, process: ProcessId) -> None:
        """Request the process to end in order; a second request ends its wait for its devices."""
        with suppress(OSError):
            descriptor = os.pidfd_open(process.pid)
            try:
                if self.is_alive(process):
                    signal.pidfd_send_signal(descriptor, signal.SIGTERM)
            finally:
                os.close(descriptor)

    def _open_result(self, process: ProcessId) -> BinaryIO | None:
        """The file of the result; that of a running process by its descriptor: the name may be deleted."""
        paths = [self._result]
        if self.is_alive(process):
            options = [argument.partition("=") for argument in _command_line(process.pid)]
            paths[:0] = [
                Path(f"/proc/{process.pid}/fd/{number}")
                for name, _, number in options
                if name == RESULT_OPTION
            ]
        for path in paths:
            with suppress(OSError):
                return path.open("rb")
        return None


def _read_result(file: BinaryIO | None) -> RunResult:
    with suppress(OSError, msgspec.DecodeError):
        if file is not None:
            return msgspec.json.decode(file.read(MAX_RESULT), type=RunResult)
    return RunResult()


def _command_line(pid: int) -> list[str]:
    """The arguments of the command line of a process, none if it has ended."""
    with suppress(OSError):
        return os.fsdecode(Path(f"/proc/{pid}/cmdline").read_bytes()).split("\0")
    return []


def _processes() -> list[int]:
    """The processes of this user."""
    user, found = os.geteuid(), []
    for folder in Path("/proc").iterdir():
        with suppress(OSError):
            if folder.name.isdigit() and folder.stat().st_uid == user:
                found.append(int(folder.name))
    return found


async def _wait(process: ProcessId) -> None:
    """Return when a process has ended."""
    try:
        descriptor = os.pidfd_open(process.pid)
    except ProcessLookupError:
        return
    loop, done = asyncio.get_running_loop(), asyncio.Event()
    try:
        if _started(process.pid) != process.started:
            return
        loop.add_reader(descriptor, done.set)
        await done.wait()
    finally:
        loop.remove_reader(descriptor)
        os.close(descriptor)


def _started(pid: int) -> int | None:
    """The time when a process was started, in clock ticks after the boot; None if it has ended."""
    try:
        # The name in parentheses may contain spaces and parentheses.
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] in "ZX" else int(fields[19])
