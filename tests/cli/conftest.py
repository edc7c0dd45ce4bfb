"""Real `python -m lfield` processes: start, output, and cleanup."""

from __future__ import annotations

import itertools
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import builds_here
import pytest

from lfield.cli.main import main
from lfield.testing.keyring import Keyring

ROOT = Path(__file__).parents[2]
#: Seconds for events that depend on the load of the computer.
TIMEOUT = 60.0
#: The environment variable that marks the processes of a test and their children.
MARK = "LFIELD_TEST_RUN"
#: The flag of an exiting process in /proc/PID/stat (include/linux/sched.h).
PF_EXITING = 0x4


class Process:
    """A running command; its lines are stored as they arrive, by stream."""

    def __init__(self, *arguments: str, mark: str, stdin: bool = False, **options) -> None:
        # Runs of hosts that a test starts are recorded in the folder of the test.
        state = str(options.get("cwd", tempfile.gettempdir()))
        own = {"XDG_STATE_HOME": state, "XDG_CONFIG_HOME": f"{state}/config", MARK: mark}
        environment = {**os.environ, **own, **options.pop("env", {})}
        # Commands are buffered also in an unbuffered test run: Python then loses output that a pipe rejects.
        environment.pop("PYTHONUNBUFFERED", None)
        self.mark = mark
        self._changed = threading.Condition()
        self.out: list[str] = []
        self.err: list[str] = []
        options.setdefault("stdout", subprocess.PIPE)
        options.setdefault("stderr", subprocess.PIPE)
        self.popen = subprocess.Popen(
            [sys.executable, "-m", "lfield", *map(str, arguments)],
            env=environment,
            stdin=subprocess.PIPE if stdin else subprocess.DEVNULL,
            start_new_session=True,
            **options,
        )
        streams = [(self.popen.stdout, self.out), (self.popen.stderr, self.err)]
        self._readers = [
            threading.Thread(target=self._read, args=pair, daemon=True) for pair in streams if pair[0]
        ]
        for reader in self._readers:
            reader.start()

    def _read(self, stream, lines: list[str]) -> None:
        with stream:
            for line in stream:
                with self._changed:
                    lines.append(line.decode(errors="replace").rstrip("\n"))
                    self._changed.notify_all()
        with self._changed:
            self._changed.notify_all()

    @property
    def pid(self) -> int:
        return self.popen.pid

    @property
    def said(self) -> str:
        return "\n".join(["stdout:", *self.out, "stderr:", *self.err])

    def wait_for(self, pattern: str) -> re.Match[str]:
        """Wait for the first line with this pattern on stdout or stderr."""
        found: list[re.Match[str]] = []

        def seen() -> bool:
            found[:] = [m for line in (*self.out, *self.err) if (m := re.search(pattern, line))]
            return bool(found) or not any(reader.is_alive() for reader in self._readers)

        with self._changed:
            self._changed.wait_for(seen, TIMEOUT)
        assert found, f"nothing like {pattern!r} in\n{self.said}"
        return found[0]

    def wait(self) -> int:
        """Wait for the end and read all lines; returns the exit status."""
        try:
            status = self.popen.wait(TIMEOUT)
        except subprocess.TimeoutExpired:
            pytest.fail(f"it does not end; it said\n{self.said}")
        for reader in self._readers:
            reader.join(TIMEOUT)
        assert "Traceback" not in self.said, self.said
        return status

    def signal(self, number: signal.Signals) -> None:
        self.popen.send_signal(number)


def run_of(pid: int, mark: str) -> bool:
    """Return true if a running process belongs to a run of a test."""
    try:
        environment = Path(f"/proc/{pid}/environ").read_bytes()
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z" and f"{MARK}={mark}".encode() in environment.split(b"\0")


def is_exiting(pid: int) -> bool:
    """Return true if a process has lost its environment, but may still hold files and locks."""
    try:
        state, *_, flags = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[:7]
    except OSError:
        return False
    return state != "Z" and bool(int(flags) & PF_EXITING)


def all_processes() -> list[int]:
    return [int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit()]


def processes_of(mark: str) -> list[int]:
    """The pids of all running processes of a run."""
    return [pid for pid in all_processes() if run_of(pid, mark)]


class Ports:
    """TCP ports for this test process only, below the range of the system, in blocks.

    The owner of a block has bound the UDP port with the number of its first port.
    """

    SIZE = 50

    def __init__(self) -> None:
        for first in range(20000, 32000, self.SIZE):
            self._claim = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            try:
                self._claim.bind(("127.0.0.1", first))
            except OSError:
                self._claim.close()
                continue
            # Skip the first port: a host there could not bind the UDP port of the same number.
            self._next = itertools.cycle(range(first + 1, first + self.SIZE))
            return
        raise RuntimeError("all ports for tests are taken")

    def take(self, count: int) -> list[int]:
        """The next ports of the block without a listener."""
        found: list[int] = []
        while len(found) < count:
            port = next(self._next)
            with socket.socket() as probe:
                try:
                    probe.bind(("127.0.0.1", port))
                except OSError:
                    continue
                found.append(port)
        return found

    def close(self) -> None:
        self._claim.close()


class Lfield:
    """Starts commands in a folder, and ends processes that a test left running."""

    def __init__(self, folder: Path, ports: Ports) -> None:
        self.folder = folder
        self.ports = ports
        self.mark = uuid.uuid4().hex
        self.started: list[Process] = []
        #: The folder of the commands' keys: see `Process`.
        self.keys = Keyring(folder / "config" / "lfield" / "keys")

    @property
    def environment(self) -> dict[str, str]:
        """The variables that mark a process and its children as part of this test."""
        return {**os.environ, "XDG_CONFIG_HOME": f"{self.folder}/config", MARK: self.mark}

    def start(self, *arguments: object, **options) -> Process:
        """Start a command without waiting for its end."""
        process = Process(*map(str, arguments), mark=self.mark, cwd=self.folder, **options)
        self.started.append(process)
        return process

    def __call__(self, *arguments: object, status: int | None = None, **options) -> Process:
        """Run a command to its end; asserts the exit status if one is given."""
        process = self.start(*arguments, **options)
        ended = process.wait()
        assert status in (None, ended), f"exit status {ended}\n{process.said}"
        return process

    def status(self, process: Process) -> int:
        return process.popen.returncode

    def write(self, name: str, text: str | bytes) -> Path:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    def mission(self, program: str, deployment: str, devices: str = "", name: str = "mission") -> Path:
        """Write a mission's files; returns the path of the deployment."""
        self.write(f"{name}.L", program)
        if devices:
            self.write(f"{name}.devices.yaml", devices)
        return self.write(f"{name}.dL", deployment)

    def hosts(self, deployment: Path, names: list[str], *options: object, **more) -> dict[str, Process]:
        """Start one process for each host, on its own port, without waiting."""
        arguments = ("up", "--deploy", deployment, *self.maps(names), "--first-start", *options)
        return {name: self.start(*arguments, "--host", name, **more) for name in names}

    def maps(self, names: list[str]) -> list[str]:
        """`--map` options with free ports of this computer for the hosts, which get keys for their links."""
        self.keys.give(*names)
        pairs = zip(names, self.ports.take(len(names)), strict=True)
        return [argument for name, port in pairs for argument in ("--map", f"{name}=127.0.0.1:{port}")]

    def left(self) -> list[int]:
        return processes_of(self.mark)

    def running(self, word: str) -> list[int]:
        """The processes of this test whose command line contains a word; some may have ended since."""
        found = []
        for pid in self.left():
            with suppress(FileNotFoundError, ProcessLookupError):
                words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
                found += [pid] if word.encode() in words else []
        return found

    def child(self, host: str) -> int:
        """The process of a host that `--all` has started."""
        found = self.running(f"--host={host}")
        assert found, f"no process of {host}"
        return found[0]

    def guards(self) -> list[int]:
        """The processes of guards."""
        return self.running("lfield.guard.process")

    def all_ended(self) -> bool:
        """Return true if all processes end within the time limit and their files are closed."""
        end = time.monotonic() + TIMEOUT
        while (self.left() or any(map(is_exiting, all_processes()))) and time.monotonic() < end:
            time.sleep(0.05)
        return not self.left()

    def end(self) -> None:
        for pid in processes_of(self.mark):
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
        for process in self.started:
            process.popen.wait(TIMEOUT)
            if process.popen.stdin:
                process.popen.stdin.close()
            for reader in process._readers:
                reader.join(TIMEOUT)


@dataclass(frozen=True)
class Said:
    """The result of a command that ran in this process."""

    status: int
    out: list[str]
    err: list[str]

    @property
    def said(self) -> str:
        return "\n".join(["stdout:", *self.out, "stderr:", *self.err])


@pytest.fixture(scope="session")
def ports() -> Iterator[Ports]:
    made = Ports()
    yield made
    made.close()


@pytest.fixture
def lfield(tmp_path: Path, ports: Ports) -> Iterator[Lfield]:
    made = Lfield(tmp_path, ports)
    yield made
    made.end()


@pytest.fixture
def here(
    lfield: Lfield, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Callable[..., Said]:
    """`here(*words)`: run a command in this process, in the folder of `lfield`; checks a given status.
    Bundles are built in this process too.
    """
    monkeypatch.chdir(lfield.folder)
    monkeypatch.setenv("XDG_CONFIG_HOME", f"{lfield.folder}/config")
    builds_here.use(monkeypatch)

    def run(*arguments: object, status: int | None = None, env: Mapping[str, str] | None = None) -> Said:
        with pytest.MonkeyPatch.context() as patch:
            for name, value in (env or {}).items():
                patch.setenv(name, value)
            ended = main([str(word) for word in arguments])
        output = capfd.readouterr()
        assert "a bug in lfield" not in output.err
        assert status in (None, ended), f"exit status {ended}\n{output.out}\n{output.err}"
        return Said(ended, output.out.splitlines(), output.err.splitlines())

    return run


@pytest.fixture(scope="module")
def shared_lfield(tmp_path_factory: pytest.TempPathFactory, ports: Ports) -> Iterator[Lfield]:
    """One `Lfield` for all tests of a file, for teams that several tests use."""
    made = Lfield(tmp_path_factory.mktemp("shared"), ports)
    yield made
    made.end()


@pytest.fixture
def alone() -> Iterator[dict[str, str]]:
    """An environment in which commands find only the fakes and teams of this test."""
    # Not pytest's folder: the path of a socket has at most 107 bytes.
    with tempfile.TemporaryDirectory(prefix="lf-") as folder:
        yield {"XDG_RUNTIME_DIR": folder}
