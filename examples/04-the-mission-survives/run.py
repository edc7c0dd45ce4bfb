"""Runs the mission on fakes, and kills the computer that it is on, twice.

    python examples/04-the-mission-survives/run.py

Fakes are processes of their own, as vehicles are: they outlive the computer that drives them. So are hosts,
each with a journal; one is killed with SIGKILL in the middle of a call, and started again as systemd does.
"""

from __future__ import annotations

import queue
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

from lfield import exits

HERE = Path(__file__).parent
#: The fake at each endpoint of the devices file.
FAKES = {
    "udp:127.0.0.1:14550": "mavlink --listen udp:127.0.0.1:0 --set-up land --land 2 --param WPNAV_SPEED=500",
    "udp:127.0.0.1:14560": "mavlink --listen udp:127.0.0.1:0 --kind rover --system 2 --set-up hold",
    "socketcan:can0": "can --listen socketcand:127.0.0.1:0 --device cia402:5,counts=10000",
    "serial:/dev/ttyUSB0:57600": "dynamixel --servo 1:XM540-W270 --servo 2:XM540-W270",
}
#: What the coordinator says before its host is killed, how many seconds before, which host, and at what.
KILLS = (
    ("the scout is at (5, 3)", 0.8, "sky", "the copter flies back, and the coordinator is with it"),
    ("the truck is there", 1.5, "ground", "the hook goes down; this is also the coordinator's home"),
)
#: Seconds after which systemd starts it again, and within which a word of the mission must come.
AGAIN, PATIENCE = 1.0, 60.0
#: What is shown of all that hosts say.
SHOWN = re.compile(r"^survivor|goes on where|safe state|Traceback|set up|problem")


class Demonstration:
    """Fakes, hosts, and what they say. `folder` is for its journals; nothing is left running."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._fakes: list[subprocess.Popen[str]] = []
        self._hosts: dict[str, subprocess.Popen[str]] = {}
        self._lines: queue.Queue[tuple[float, str]] = queue.Queue()
        self._ports = {host: free_port() for host in ("sky", "ground", "bench")}
        self._began = time.monotonic()
        self._summary: list[str] = []

    def run(self) -> list[str]:
        """All of it; returns what was killed, and how it went on. Raises TimeoutError."""
        try:
            self._build()
            for host in self._ports:
                self._start(host)
            for words, seconds, host, what in KILLS:
                self._wait_for(words)
                time.sleep(seconds)
                self._kill(host, what)
            self._wait_for("survivor: complete")
        finally:
            self._end()
        return [*self._summary, f"complete after {time.monotonic() - self._began:.0f} s"]

    def _build(self) -> None:
        """The bundle, with the fakes' endpoints in place of those in the field."""
        self._fakes = [self._popen("sim", *words.split(), "--until-stdin-closes") for words in FAKES.values()]
        bindings = (HERE / "mission.devices.yaml").read_text()
        for endpoint, fake in zip(FAKES, self._fakes, strict=True):
            assert fake.stdout is not None
            bindings = bindings.replace(endpoint, fake.stdout.readline().split()[1])
        devices = self._folder / "mission.devices.yaml"
        devices.write_text(bindings)
        bundle = str(self._folder / "mission.lfm")
        words = ("build", str(HERE / "mission.dL"), "--devices", str(devices), "--output", bundle)
        subprocess.run([sys.executable, "-m", "lfield", *words], check=True, stdout=subprocess.DEVNULL)

    def _start(self, host: str) -> None:
        maps = [f"--map={name}=127.0.0.1:{port}" for name, port in self._ports.items()]
        words = (str(self._folder / "mission.lfm"), "--host", host, "--state", str(self._folder), *maps)
        self._hosts[host] = self._popen("up", *words)
        threading.Thread(target=self._read, args=(host, self._hosts[host]), daemon=True).start()

    def _popen(self, *words: str) -> subprocess.Popen[str]:
        pipe, merged = subprocess.PIPE, subprocess.STDOUT
        command = [sys.executable, "-m", "lfield", *words]
        return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=merged, text=True)

    def _read(self, host: str, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            self._lines.put((time.monotonic(), line))
            if SHOWN.search(line):
                print(f"{host:6} | {line}", end="", flush=True)

    def _wait_for(self, words: str) -> float:
        """When a line with these words came."""
        end = time.monotonic() + PATIENCE
        while True:
            with suppress(queue.Empty):
                when, line = self._lines.get(timeout=0.1)
                if "told at step" in line:
                    self._summary.append(f"told    {line.split(': ', 2)[2].strip()}")
                if words in line:
                    return when
            if time.monotonic() > end:
                raise TimeoutError(f"{words!r} did not come within {PATIENCE:.0f} s")

    def _kill(self, host: str, what: str) -> None:
        at = time.monotonic() - self._began
        self._hosts[host].kill()
        print(f"       | ({host} is killed: {what})", flush=True)
        time.sleep(AGAIN)
        again = time.monotonic()
        self._start(host)
        self._summary.append(f"killed  {host} after {at:.1f} s: {what}")
        seconds = self._wait_for("survivor goes on where it was kept") - again
        self._summary.append(f"back    {seconds:.1f} s after the start of its new process")

    def _end(self) -> None:
        for host in self._hosts.values():
            host.terminate()
        for host in self._hosts.values():
            host.wait()
        for fake in self._fakes:
            assert fake.stdin is not None
            fake.stdin.close()
            fake.wait()


def free_port() -> int:
    """A port of loopback that nobody has."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def main() -> int:
    """The command."""
    with tempfile.TemporaryDirectory(prefix="lfield-survives-") as folder:
        try:
            summary = Demonstration(Path(folder)).run()
        except TimeoutError as error:
            print(f"the mission does not go on: {error}", file=sys.stderr)
            return exits.FAILED
    print("", *summary, sep="\n")
    return exits.DONE


if __name__ == "__main__":
    sys.exit(main())
