"""Computers on a network that are network namespaces of this one: two hosts, and a switch between them."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

#: Seconds until a test fails; a busy computer may be slow.
TIMEOUT = 60.0
PEER = Path(__file__).with_name("peer.py")


def command(*arguments: str) -> None:
    subprocess.run(arguments, check=True, capture_output=True)


def can_be_made() -> bool:
    """Whether this process may make network namespaces with interfaces."""
    if os.geteuid() or shutil.which("ip") is None:
        return False
    name = f"lf-{uuid.uuid4().hex[:8]}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True).returncode == 0
    try:
        adding = ["ip", "-n", name, "link", "add", "name", "eth0", "type", "veth", "peer", "name", "eth1"]
        return made and subprocess.run(adding, capture_output=True).returncode == 0
    finally:
        if made:
            subprocess.run(["ip", "netns", "del", name], capture_output=True)


class Process:
    """A `peer.py` on one of the computers; its lines with their times."""

    def __init__(self, words: list[str], stderr: int | None = None) -> None:
        self._popen = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=stderr, text=True
        )
        self.lines: list[str] = []
        self._changed = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._popen.stdout is not None
        for line in self._popen.stdout:
            with self._changed:
                self.lines.append(self._timed(line.rstrip("\n")))
                self._changed.notify_all()

    def _timed(self, line: str) -> str:
        return line

    def wait_for(self, pattern: str, since: int = 0) -> float:
        """The time of the first line after the first `since` that matches, on the monotonic clock."""

        def found() -> str | None:
            return next((line for line in self.lines[since:] if re.search(pattern, line)), None)

        with self._changed:
            self._changed.wait_for(found, TIMEOUT)
            line = found()
        assert line, "\n".join([f"no line matches {pattern!r}:", *self.lines])
        return float(line.split()[0])

    def kill(self) -> None:
        self._popen.send_signal(signal.SIGKILL)
        self._popen.wait(TIMEOUT)

    def end(self) -> None:
        if self._popen.poll() is None:
            self.kill()
        assert self._popen.stdin is not None
        self._popen.stdin.close()
        self._reader.join(TIMEOUT)
        assert self._popen.stdout is not None
        self._popen.stdout.close()


class Network:
    """Two computers, `a` and `b`, at a switch. Interfaces are called `eth0`; they have no address yet."""

    def __init__(self, keys: Path) -> None:
        self._tag, self._keys = uuid.uuid4().hex[:6], keys
        self._processes: list[Process] = []
        self.switch = self._named("s")
        for name in (self.switch, *map(self._named, "ab")):
            command("ip", "netns", "add", name)
            self._ip(name, "link", "set", "dev", "lo", "up")
        self._ip(self.switch, "link", "add", "name", "switch0", "type", "bridge")
        self._ip(self.switch, "link", "set", "dev", "switch0", "up")
        for host in "ab":
            self.plug_in(host)
            folder = self._etc(host)
            folder.mkdir(parents=True)
            (folder / "hosts").write_text("127.0.0.1 localhost\n", encoding="ascii")
            # Other names are not resolved: no server answers at this address.
            (folder / "resolv.conf").write_text("nameserver 127.0.0.1\n", encoding="ascii")

    def _named(self, host: str) -> str:
        return f"lf-{self._tag}-{host}"

    def _etc(self, host: str) -> Path:
        return Path("/etc/netns") / self._named(host)

    def _ip(self, namespace: str, *arguments: str) -> None:
        command("ip", "-n", namespace, *arguments)

    def plug_in(self, host: str) -> None:
        """Give a computer an interface at the switch."""
        there = ["type", "veth", "peer", "name", f"p{host}", "netns", self.switch]
        self._ip(self._named(host), "link", "add", "name", "eth0", *there)
        self._ip(self.switch, "link", "set", "dev", f"p{host}", "master", "switch0", "up")
        self._ip(self._named(host), "link", "set", "dev", "eth0", "up")

    def pull_out(self, host: str) -> None:
        """Remove the interface with its addresses."""
        self._ip(self._named(host), "link", "del", "dev", "eth0")

    def address(self, host: str, *addresses: str) -> None:
        """Give a computer these addresses, and no other."""
        self._ip(self._named(host), "addr", "flush", "dev", "eth0", "scope", "global")
        for address in addresses:
            extra = ["nodad"] if ":" in address else []
            self._ip(self._named(host), "addr", "add", address, "dev", "eth0", *extra)

    def silence(self) -> None:
        """Drop all packets without an error."""
        self._ip(self.switch, "link", "set", "dev", "pb", "nomaster")

    def heal(self) -> None:
        """Deliver packets again."""
        self._ip(self.switch, "link", "set", "dev", "pb", "master", "switch0")

    def name(self, host: str, *lines: str) -> None:
        """Set the host names of a computer: `ADDRESS NAME`."""
        text = "\n".join(["127.0.0.1 localhost", *lines, ""])
        # The file is mounted: it is overwritten, not replaced.
        with (self._etc(host) / "hosts").open("r+", encoding="ascii") as file:
            file.write(text)
            file.truncate()

    def start(self, host: str, *places: str) -> Process:
        """Start the links of a host; `places` are NAME=ADDRESS."""
        arguments = [sys.executable, str(PEER), host, str(self._keys), *places]
        return self.run(host, *arguments)

    def run(self, host: str, *arguments: str) -> Process:
        """Run a program on a computer."""
        process = Process(["ip", "netns", "exec", self._named(host), *arguments])
        self._processes.append(process)
        return process

    def close(self) -> None:
        for process in self._processes:
            process.end()
        for host in "sab":
            subprocess.run(["ip", "netns", "del", self._named(host)], capture_output=True)
            shutil.rmtree(self._etc(host), ignore_errors=True)


@pytest.fixture(scope="session")
def namespaces() -> bool:
    return can_be_made()


def network(keys: Path) -> Iterator[Network]:
    made = Network(keys)
    try:
        yield made
    finally:
        made.close()
