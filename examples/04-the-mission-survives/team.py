"""Runs the simulated devices and the hosts of one deployment as processes, and collects the hosts' output."""

from __future__ import annotations

import random
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from lfield.testing.keyring import Keyring

#: Seconds: maximum wait for a line of the mission.
LINE_TIMEOUT = 60.0
#: Lines of the hosts' output that are printed.
PRINTED_LINE = re.compile(r"^(survivor|clearer|failover)|safe state|Traceback|problem")


class Line(NamedTuple):
    """A line of a host's output, with its time in seconds of the monotonic clock."""

    at: float
    host: str
    text: str


class Failed(Exception):
    """The mission failed: one sentence."""


class Team:
    """A running deployment; `name` precedes its printed lines. `end` stops all its processes."""

    def __init__(self, name: str, deployment: Path, hosts: Sequence[str], folder: Path) -> None:
        self._name, self._deployment, self._folder = name, deployment, folder
        self._bundle = folder / deployment.with_suffix(".lfm").name
        self._ports = {host: free_port() for host in hosts}
        self._fakes: list[subprocess.Popen[str]] = []
        self._hosts: dict[str, subprocess.Popen[str]] = {}
        # The hosts authenticate each other, as in the field, where `lfield keys` creates the keys.
        self._keyring = Keyring(folder / "keys" / name)
        self._keys = "--keys", str(self._keyring.give(*hosts))
        self.lines: list[Line] = []
        self._line_added = threading.Condition()

    def launch(self, fakes: Mapping[str, str]) -> None:
        """Starts a simulated device for each endpoint, then the hosts with the endpoints of these devices."""
        self._fakes = [
            popen("sim", *arguments.split(), "--until-stdin-closes") for arguments in fakes.values()
        ]
        bindings = self._deployment.with_suffix(".devices.yaml").read_text()
        for endpoint, fake in zip(fakes, self._fakes, strict=True):
            assert fake.stdout is not None
            bindings = bindings.replace(endpoint, fake.stdout.readline().split()[1])
        devices = self._folder / f"{self._bundle.stem}.devices.yaml"
        # As with `up --sim`: on a busy computer a host may be delayed for longer than the default of 0.2 s.
        devices.write_text(f"silence: 2.0\n{bindings}")
        arguments = ("build", str(self._deployment), "--devices", str(devices), "--output", str(self._bundle))
        built = subprocess.run([sys.executable, "-m", "lfield", *arguments], capture_output=True, text=True)
        if built.returncode:
            raise Failed(built.stderr)
        # Hosts with keys accept only signed bundles. In the field, `lfield sign` signs them.
        self._keyring.sign(self._bundle)
        for host in self._ports:
            self.start(host)

    def start(self, host: str) -> None:
        """Starts a host; its journal is in the folder."""
        maps = [f"--map={name}=127.0.0.1:{port}" for name, port in self._ports.items()]
        options = ("--host", host, "--state", str(self._folder), *maps, *self._keys)
        process = self._hosts[host] = popen("up", str(self._bundle), *options)
        threading.Thread(target=self._read, args=(host, process), daemon=True).start()

    def kill(self, host: str, action: str) -> float:
        """Kills a host with SIGKILL during an action of the mission, and returns the time."""
        self._hosts.pop(host).kill()
        self._print("", f"({host} is killed: {action})\n")
        return time.monotonic()

    def wait_for(self, text: str, since: float = 0.0) -> Line:
        """Waits for a line with a text after a time, and returns the first one. Raises Failed."""
        end = time.monotonic() + LINE_TIMEOUT
        with self._line_added:
            while not (found := [line for line in self.lines if text in line.text and line.at > since]):
                ended = [host for host, process in self._hosts.items() if process.poll() is not None]
                if ended or time.monotonic() > end:
                    reason = self._last_lines(ended[0]) if ended else f"none within {LINE_TIMEOUT:.0f} s"
                    raise Failed(f"{self._name}: no line with {text!r}: {reason}")
                self._line_added.wait(0.2)
        return found[0]

    def _last_lines(self, host: str) -> str:
        last = [line.text for line in self.lines if line.host == host][-3:]
        return f"{host} has ended after the lines: {' / '.join(last) or 'none'}"

    def end(self) -> None:
        """Stops the hosts, which bring their devices into safe states, then the simulated devices."""
        for host in self._hosts.values():
            host.terminate()
        for host in self._hosts.values():
            host.wait()
        for fake in self._fakes:
            assert fake.stdin is not None
            fake.stdin.close()
            fake.wait()

    def _read(self, host: str, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for text in process.stdout:
            with self._line_added:
                self.lines.append(Line(time.monotonic(), host, text.rstrip("\n")))
                self._line_added.notify_all()
            if PRINTED_LINE.search(text):
                self._print(host, text)

    def _print(self, host: str, text: str) -> None:
        print(f"{self._name:6} {host:9} | {text}", end="", flush=True)


def popen(*arguments: str) -> subprocess.Popen[str]:
    """Starts a command of lfield with pipes."""
    pipe, merged = subprocess.PIPE, subprocess.STDOUT
    command = [sys.executable, "-m", "lfield", *arguments]
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=merged, text=True)


def free_port() -> int:
    """A free port of loopback outside the kernel's ephemeral range, so no other process gets it by chance.

    A host listens on the port seconds later, and again after a restart.
    """
    for port in random.SystemRandom().sample(range(20_000, 32_000), 100):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) != 0:
                return port
    raise Failed("no free port found between 20000 and 32000")
