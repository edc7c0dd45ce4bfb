"""Processes of the mission's host on this computer: start, observation by the next service, end."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from service_fakes import OLD

from lfield.errors import InputFileError, OutputFileError
from lfield.service import host_processes
from lfield.service.host_processes import LocalProcesses
from lfield.service.mission_runner import HostEnd, HostProcess, ProcessId

#: Replaces Python with lfield: writes a result, if its bundle has one, and waits.
PROGRAM = f"""#!{sys.executable}
import os, sys, time
descriptor = next(int(word.partition("=")[2]) for word in sys.argv if word.startswith("--result-fd="))
(bundle,) = [word for word in sys.argv if word.endswith(".lfm")]
if os.path.exists(bundle):
    os.write(descriptor, open(bundle, "rb").read())
    sys.exit(3)
print("up", flush=True)
time.sleep(60)
"""


class Folder:
    """Processes of one robot in a folder; `next_service` sees processes started by an earlier service."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.processes = self.next_service()
        self.started: list[ProcessId] = []

    def next_service(self) -> LocalProcesses:
        return LocalProcesses("alpha", self.bundle, [], self.path / "host.result")

    def bundle(self, digest: bytes) -> Path:
        return self.path / f"{digest.hex()}.lfm"

    def start(self, bundle: bytes) -> ProcessId:
        process = self.processes.start(bundle)
        self.started.append(process)
        # The kernel sets the command line shortly after it has started the program. A process that has ended
        # has no command line.
        while not Path(f"/proc/{process.pid}/cmdline").read_bytes() and self.processes.is_alive(process):
            os.sched_yield()
        return process


@pytest.fixture
def runner():
    """Processes need real time."""
    return lambda test: asyncio.run(test())


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Folder]:
    program = tmp_path / "python"
    program.write_text(PROGRAM)
    program.chmod(0o700)
    monkeypatch.setattr(host_processes.sys, "executable", str(program))
    made = Folder(tmp_path)
    yield made
    for process in made.started:
        with suppress(ProcessLookupError):
            if made.processes.is_alive(process):
                os.kill(process.pid, signal.SIGKILL)


async def test_process_is_found_by_host_and_bundle_until_killed(folder: Folder) -> None:
    process = folder.start(OLD)
    assert folder.processes.is_alive(process)
    assert not folder.processes.is_alive(ProcessId(process.pid, process.started + 1))
    later = folder.next_service()
    assert later.find() == HostProcess(OLD, process)
    result = folder.path / "host.result"
    assert LocalProcesses("bravo", folder.bundle, [], result).find() is None
    assert LocalProcesses("alpha", lambda digest: Path("x", digest.hex()), [], result).find() is None
    os.kill(process.pid, signal.SIGKILL)
    assert await folder.processes.ended(process) == HostEnd(-signal.SIGKILL)
    assert later.find() is None
    assert not later.is_alive(process)


async def test_terminate_sends_sigterm(folder: Folder) -> None:
    process = folder.start(OLD)
    folder.next_service().terminate(process)
    assert (await folder.processes.ended(process)).status == -signal.SIGTERM
    folder.processes.terminate(process)


async def test_next_service_reads_the_result_of_a_process(folder: Folder) -> None:
    folder.bundle(OLD).write_bytes(b'{"status":3,"reason":"its arm moves"}')
    process = folder.start(OLD)
    assert await folder.processes.ended(process) == HostEnd(3, "its arm moves")
    assert await folder.next_service().ended(process) == HostEnd(3, "its arm moves")
    # A killed process leaves no result, and the earlier result does not count.
    folder.bundle(OLD).unlink()
    process = folder.start(OLD)
    later = folder.next_service()
    waiting = asyncio.create_task(later.ended(process))
    await asyncio.sleep(0)
    os.kill(process.pid, signal.SIGKILL)
    assert await waiting == HostEnd(-signal.SIGKILL)
    await folder.processes.ended(process)


async def test_result_is_read_also_from_a_deleted_file(folder: Folder) -> None:
    process = folder.start(OLD)
    later = folder.next_service()
    (folder.path / "host.result").unlink()
    assert later.find() == HostProcess(OLD, process)
    descriptor = _result_descriptor(process.pid)
    descriptor.write_bytes(b'{"status":130,"reason":"stopped"}')
    waiting = asyncio.create_task(later.ended(process))
    await asyncio.sleep(0)
    os.kill(process.pid, signal.SIGKILL)
    assert await waiting == HostEnd(130, "stopped")
    await folder.processes.ended(process)


def _result_descriptor(pid: int) -> Path:
    """The result file of a process, which has been deleted."""
    words = Path(f"/proc/{pid}/cmdline").read_text().split("\0")
    (number,) = [argument.partition("=")[2] for argument in words if argument.startswith("--result-fd=")]
    return Path(f"/proc/{pid}/fd/{number}")


def test_failed_process_start_is_an_error(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(host_processes.sys, "executable", str(folder.path / "missing"))
    with pytest.raises(InputFileError):
        folder.processes.start(OLD)
    folder.path.joinpath("host.result").unlink()
    folder.path.joinpath("host.result").mkdir()
    with pytest.raises(OutputFileError):
        folder.processes.start(OLD)
