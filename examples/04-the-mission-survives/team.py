"""The simulated devices and the hosts of one deployment as processes, and all that these hosts say."""

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

#: Seconds to wait for a line of the mission.
PATIENCE = 60.0
#: The part of the hosts' output that is shown.
SHOWN = re.compile(r"^(survivor|clearer|failover)|safe state|Traceback|problem")


class Line(NamedTuple):
    """A line of a host, with its time in seconds of the monotonic clock."""

    at: float
    host: str
    text: str


class Failed(Exception):
    """The mission failed: one sentence."""


class Team:
    """A deployment; its lines are marked with `policy`. Nothing is left running after `end`."""

    def __init__(self, policy: str, deployment: Path, hosts: Sequence[str], folder: Path) -> None:
        self._policy, self._deployment, self._folder = policy, deployment, folder
        self._bundle = folder / deployment.with_suffix(".lfm").name
        self._ports = {host: free_port() for host in hosts}
        self._fakes: list[subprocess.Popen[str]] = []
        self._hosts: dict[str, subprocess.Popen[str]] = {}
        # As on several computers, each host authenticates; in the field `lfield keys` creates the keys.
        self._keyring = Keyring(folder / "keys" / policy)
        self._keys = "--keys", str(self._keyring.give(*hosts))
        self.lines: list[Line] = []
        self._said = threading.Condition()

    def launch(self, fakes: Mapping[str, str]) -> None:
        """Starts a simulated device for each endpoint of the devices file, and the hosts with these
        endpoints."""
        self._fakes = [
            popen("sim", *arguments.split(), "--until-stdin-closes") for arguments in fakes.values()
        ]
        bindings = self._deployment.with_suffix(".devices.yaml").read_text()
        for endpoint, fake in zip(fakes, self._fakes, strict=True):
            assert fake.stdout is not None
            bindings = bindings.replace(endpoint, fake.stdout.readline().split()[1])
        devices = self._folder / f"{self._bundle.stem}.devices.yaml"
        # As with `up --sim`: on a busy desk a host may be late for longer than the default of 0.2 s.
        devices.write_text(f"silence: 2.0\n{bindings}")
        arguments = ("build", str(self._deployment), "--devices", str(devices), "--output", str(self._bundle))
        built = subprocess.run([sys.executable, "-m", "lfield", *arguments], capture_output=True, text=True)
        if built.returncode:
            raise Failed(built.stderr)
        # Hosts with keys accept signed bundles only, as by `lfield sign`.
        self._keyring.sign(self._bundle)
        for host in self._ports:
            self.start(host)

    def start(self, host: str) -> None:
        """Starts a host, as systemd does; its journal is in the folder."""
        maps = [f"--map={name}=127.0.0.1:{port}" for name, port in self._ports.items()]
        arguments = (
            "up",
            str(self._bundle),
            "--host",
            host,
            "--state",
            str(self._folder),
            *maps,
            *self._keys,
        )
        process = self._hosts[host] = popen(*arguments)
        threading.Thread(target=self._read, args=(host, process), daemon=True).start()

    def kill(self, host: str, what: str) -> float:
        """Kills a host with SIGKILL, reports it, and returns the time."""
        self._hosts.pop(host).kill()
        self._show("", f"({host} is killed: {what})\n")
        return time.monotonic()

    def wait_for(self, text: str, since: float = 0.0) -> Line:
        """The first line with this text after a time. Raises Failed."""
        end = time.monotonic() + PATIENCE
        with self._said:
            while not (found := [x for x in self.lines if text in x.text and x.at > since]):
                ended = [host for host, process in self._hosts.items() if process.poll() is not None]
                if ended or time.monotonic() > end:
                    why = self._last_of(ended[0]) if ended else f"it did not come within {PATIENCE:.0f} s"
                    raise Failed(f"{self._policy}: no {text!r}: {why}")
                self._said.wait(0.2)
        return found[0]

    def _last_of(self, host: str) -> str:
        last = [x.text for x in self.lines if x.host == host][-3:]
        return " / ".join([f"{host} has ended, and its last words were", *(last or ["none"])])

    def end(self) -> None:
        """Stops the hosts, which bring their devices to rest, then the simulated devices."""
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
            with self._said:
                self.lines.append(Line(time.monotonic(), host, text.rstrip("\n")))
                self._said.notify_all()
            if SHOWN.search(text):
                self._show(host, text)

    def _show(self, host: str, text: str) -> None:
        print(f"{self._policy:6} {host:9} | {text}", end="", flush=True)


def popen(*arguments: str) -> subprocess.Popen[str]:
    """Runs a command of lfield."""
    pipe, merged = subprocess.PIPE, subprocess.STDOUT
    command = [sys.executable, "-m", "lfield", *arguments]
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=merged, text=True)


def free_port() -> int:
    """A free port of loopback below the ephemeral range.

    A host listens there seconds later, and again after it was killed: no other process may get it meanwhile.
    """
    for port in random.SystemRandom().sample(range(20_000, 32_000), 100):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) != 0:
                return port
    raise Failed("a hundred ports between 20000 and 32000 are all taken")
