"""Processes of the mission's host, as the service starts and observes them."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import msgspec

from lfield.errors import InputFileError, OutputFileError
from lfield.host.process.run_result import MAX_RESULT, RunResult
from lfield.service.mission_runner import KILLED, HostEnd, ProcessId

_BOOT = Path("/proc/sys/kernel/random/boot_id")


class LocalProcesses:
    """See `mission_runner.HostProcesses`.

    `bundle_path` gives the file of a bundle; `options` are those of `lfield up`. The host writes its result
    to the file `result`, so that the next service knows how it ended.
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
        command += [f"--host={self._host}", f"--result-fd={result}", *self._options]
        try:
            # Its own session: a Ctrl-C at the service's terminal is for the service, which stops it in order.
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

    def find(self, bundle: bytes) -> ProcessId | None:
        """The process of the host of a bundle that an earlier service has started; None without one."""
        expected = {b"up", os.fsencode(self._bundle_path(bundle)), f"--host={self._host}".encode()}
        for folder in Path("/proc").iterdir():
            with suppress(OSError):
                if folder.name.isdigit() and expected <= {*(folder / "cmdline").read_bytes().split(b"\0")}:
                    pid = int(folder.name)
                    if (started := _started(pid)) is not None:
                        return ProcessId(pid, started)
        return None

    def is_alive(self, process: ProcessId) -> bool:
        """Whether the process still runs."""
        return _started(process.pid) == process.started

    async def ended(self, process: ProcessId) -> HostEnd:
        """The end of a process, when it has ended."""
        await _wait(process)
        child = self._children.pop(process.pid, None)
        status = child.wait() if child is not None else None
        left = self._left_result()
        if status is None:
            status = left.status
        return HostEnd(KILLED if status is None else status, left.reason)

    def terminate(self, process: ProcessId) -> None:
        """Ask it to end in order; again has it not wait for its devices."""
        with suppress(OSError):
            descriptor = os.pidfd_open(process.pid)
            try:
                if self.is_alive(process):
                    signal.pidfd_send_signal(descriptor, signal.SIGTERM)
            finally:
                os.close(descriptor)

    def _left_result(self) -> RunResult:
        with suppress(OSError, msgspec.DecodeError), self._result.open("rb") as file:
            return msgspec.json.decode(file.read(MAX_RESULT), type=RunResult)
        return RunResult()


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
    """When a process was started, in clock ticks after the boot; None if it has ended."""
    try:
        # The name in parentheses may contain spaces and parentheses.
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] in "ZX" else int(fields[19])
