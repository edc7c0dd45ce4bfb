"""Simulators of real autopilots: already running, or started from a build and ended by their pids.

ArduPilot's options: https://ardupilot.org/dev/docs/using-sitl-for-ardupilot-testing.html, its ports:
https://ardupilot.org/dev/docs/sitl-serial-mapping.html; PX4's: https://docs.px4.io/main/en/simulation/
"""

from __future__ import annotations

import errno
import os
import shlex
import shutil
import signal
import socket
import subprocess
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

#: Parameters of ArduPilot beside its defaults, so that it can be armed and has a gripper.
PARAMETERS = Path(__file__).parents[2] / "sim-adapters" / "real"
#: Seconds for a simulator to end by itself before it is killed.
END_TIMEOUT = 5.0
#: Reasons why a build cannot be started, in addition to the system's message.
REASONS: Mapping[int, str] = {
    errno.ENOENT: "give the path of a simulator's build, or an endpoint",
    errno.EACCES: "it is no program, or has no execution right: chmod +x",
    errno.ENOEXEC: "it is built for another kind of computer",
    errno.EADDRINUSE: "end what runs there, or give its endpoint in place of a path",
}
#: Lines of a simulator's output that are shown after a failure.
LAST_LINES = 15


@dataclass(frozen=True)
class Kind:
    """A kind of simulator: its variable of `make test-sitl`, its autopilot and its vehicle."""

    name: str
    variable: str
    px4: bool
    vehicle: str = "copter"
    model: str = "+"


KINDS = (
    Kind("arducopter", "ARDUCOPTER", px4=False),
    Kind("ardurover", "ARDUROVER", px4=False, vehicle="rover", model="rover"),
    Kind("px4", "PX4", px4=True, model="sihsim_quadx"),
)


@dataclass
class Simulator:
    """One simulated vehicle, with an endpoint for lfield and a second endpoint for the watcher.

    `setting` is the value of the variable: the path of a build and optional command-line options, or
    `ENDPOINT[,SECOND]` of a running one. `instance` counts from 0; the system id is one more.
    """

    kind: Kind
    setting: str
    instance: int = 0
    _process: subprocess.Popen[bytes] | None = field(default=None, init=False)
    _folder: Path | None = field(default=None, init=False)

    @property
    def system(self) -> int:
        """The MAVLink system id of the vehicle."""
        return self.instance + 1

    @property
    def is_running_elsewhere(self) -> bool:
        """Whether the simulator was started outside these tests."""
        return self.setting.startswith(("tcp:", "udp:", "udpin:"))

    @property
    def endpoint(self) -> str:
        """The endpoint for a binding."""
        if self.is_running_elsewhere:
            return self.setting.partition(",")[0]
        if self.kind.px4:
            return f"udpin:127.0.0.1:{14540 + self.instance}"
        return f"tcp:127.0.0.1:{5760 + 10 * self.instance}"

    @property
    def second_endpoint(self) -> str:
        """The endpoint of another link to the vehicle, for the watcher."""
        if self.is_running_elsewhere:
            return self.setting.partition(",")[2] or self.endpoint
        if self.kind.px4:
            # PX4's link for ground stations: all instances send to one port; each has this local port.
            return f"udp:127.0.0.1:{18570 + self.instance}"
        return f"tcp:127.0.0.1:{5762 + 10 * self.instance}"

    @property
    def ports(self) -> tuple[tuple[socket.SocketKind, int], ...]:
        """The ports of the simulator, and the port at which lfield listens for it."""
        if self.kind.px4:
            return tuple((socket.SOCK_DGRAM, port + self.instance) for port in (14540, 14580, 18570))
        return tuple((socket.SOCK_STREAM, port + 10 * self.instance) for port in (5760, 5762))

    def start(self, folder: Path) -> None:
        """Starts the build in its own folder, with empty storage. Raises OSError."""
        if self.is_running_elsewhere:
            return
        for kind, port in self.ports:
            if is_port_in_use(kind, port):
                raise OSError(errno.EADDRINUSE, f"port {port} of 127.0.0.1 is in use")
        folder.mkdir(parents=True)
        self._folder = folder
        words, environment = px4(self, folder) if self.kind.px4 else ardupilot(self)
        with (folder / "output.txt").open("wb") as output:
            self._process = subprocess.Popen(
                words,
                cwd=folder,
                env={**os.environ, **environment},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def end(self) -> None:
        """Ends the process, unless the simulator was started elsewhere."""
        if self._process is None:
            return
        self._signal(signal.SIGTERM)
        try:
            self._process.wait(END_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._signal(signal.SIGKILL)
            self._process.wait()

    def _signal(self, number: signal.Signals) -> None:
        """Sends a signal to the process group, since PX4 is started by a shell."""
        assert self._process is not None
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, number)

    @property
    def failure(self) -> str:
        """The reason why the simulator does not run, '' if it runs."""
        status = None if self._process is None else self._process.poll()
        if status is None:
            return ""
        last = self.last_output.rpartition("\n")[2] or "nothing"
        return f"{self.kind.name} has ended with {status}; last output: {last}\n{self.last_output}"

    @property
    def last_output(self) -> str:
        """The last lines of the output."""
        if self._folder is None:
            return "(it was started elsewhere)"
        lines = (self._folder / "output.txt").read_text(errors="replace").splitlines()
        return "\n".join(lines[-LAST_LINES:])


def is_port_in_use(kind: socket.SocketKind, port: int) -> bool:
    """Whether a process listens at a port of this computer."""
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind is socket.SOCK_STREAM:
            # Connections of a simulator that has just ended do not count.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            return error.errno == errno.EADDRINUSE
    return False


def start_error(setting: str, error: OSError) -> str:
    """The reason why a build could not be started."""
    reason = REASONS.get(error.errno or 0, "")
    if error.errno == errno.ENOENT and Path(split(setting)[0]).exists():
        reason = "the file is there, but not the loader that it was built for: it is for another system"
    return f"'{setting}' cannot be started: {error.strerror}" + (f"; {reason}" if reason else "")


def split(setting: str) -> list[str]:
    """The path of a build (relative, in a home folder, or a name on the PATH) and its options."""
    binary, *options = shlex.split(setting)
    path = Path(binary).expanduser()
    found = None if path.exists() else shutil.which(binary)
    return [found or str(path.absolute()), *options]


def ardupilot(simulator: Simulator) -> tuple[list[str], Mapping[str, str]]:
    """The command that starts an ArduPilot build, and its additional environment variables."""
    binary, *options = split(simulator.setting)
    parameters = [PARAMETERS / f"{simulator.kind.name}.parm"]
    # A source tree beside the build has the default parameters of ArduPilot's own tests.
    stock = Path(binary).resolve().parents[3:4]
    others = [tree / "Tools/autotest/default_params" / f"{simulator.kind.vehicle}.parm" for tree in stock]
    parameters = [*(file for file in others if file.is_file()), *parameters]
    arguments = (
        f"--model {simulator.kind.model} --speedup 1 --wipe --instance {simulator.instance} "
        f"--sysid {simulator.system} --serial0 tcp:0"
    )
    return [binary, *arguments.split(), "--defaults", ",".join(map(str, parameters)), *options], {}


def px4(simulator: Simulator, folder: Path) -> tuple[list[str], Mapping[str, str]]:
    """The command and environment of a PX4 build; its start-up files are beside the binary's folder."""
    binary, *options = split(simulator.setting)
    files = Path(binary).resolve().parent.parent / "etc"
    words = [binary, *options, "-i", str(simulator.instance), "-d", "-w", str(folder)]
    return [*words, str(files)] if files.is_dir() else words, {"PX4_SIM_MODEL": simulator.kind.model}
