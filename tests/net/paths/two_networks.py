"""Two computers with two networks between them, as network namespaces, and hosts on them that hop."""

from __future__ import annotations

import itertools
import re
import subprocess
import sys
import time
import uuid
from pathlib import Path

from namespaces import TIMEOUT, Process, command

from lfield.testing.keyring import Keyring

PORT = 7001
NETWORKS, HOSTS = ("one", "two"), ("alpha", "bravo")
#: The walker hops between the posts; each number is stamped once.
PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal stamp(int number) emit int { write("stamped " + i2s(number) + "\\n"); return number + 1; }
}
coordinator Walker {
    init(string[] arg) {
        Post here = findPost("one");
        Post there = findPost("two");
        int number = 0;
        while (true) {
            number = there.stamp(number);
            number = here.stamp(number);
            sleep(0.02);
        }
    }
}
"""
TEAM = "//Post:one@alpha\n//Post:two@bravo\n//Walker:walker@alpha\n"


def address(host: str, network: str) -> str:
    return f"10.9.{1 + NETWORKS.index(network)}.{1 + HOSTS.index(host)}"


class Host(Process):
    """A host as a process; its lines with their times."""

    def __init__(self, words: list[str]) -> None:
        super().__init__(words, subprocess.STDOUT)

    def _timed(self, line: str) -> str:
        return f"{time.monotonic():.6f} {line}"

    def _count(self, until: float) -> int:
        return sum(float(line.split()[0]) < until for line in list(self.lines))

    def wait_for(self, pattern: str, since: float = 0.0) -> float:
        """The time of the first line after `since` that matches."""
        return super().wait_for(pattern, self._count(since))

    def text(self, since: float = 0.0) -> str:
        """The printed lines after `since`, without the stamps."""
        return "\n".join(line for line in self.lines[self._count(since) :] if "stamped" not in line)

    def stamps(self) -> list[tuple[float, int]]:
        """The numbers that were stamped here, with their times."""
        found = (re.match(r"(\S+) .*stamped (\d+)", line) for line in list(self.lines))
        return [(float(match[1]), int(match[2])) for match in found if match]


class TwoNetworks:
    """The computers of `alpha` and `bravo`, with an interface in each of two networks."""

    def __init__(self, folder: Path) -> None:
        self._tag, self._folder = uuid.uuid4().hex[:6], folder
        self.hosts: dict[str, Host] = {}
        for host in HOSTS:
            command("ip", "netns", "add", self._named(host))
            self._run(host, "ip", "link", "set", "dev", "lo", "up")
        for network in NETWORKS:
            peer = ["type", "veth", "peer", "name", network, "netns", self._named("bravo")]
            self._run("alpha", "ip", "link", "add", "name", network, *peer)
            for host in HOSTS:
                self.up(host, network)
        Keyring(folder / "keys").give(*HOSTS)
        (folder / "mission.L").write_text(PROGRAM)
        (folder / "mission.dL").write_text(TEAM)

    def _named(self, host: str) -> str:
        return f"lf-{self._tag}-{host}"

    def _run(self, host: str, *arguments: str) -> None:
        command("ip", "netns", "exec", self._named(host), *arguments)

    def up(self, host: str, network: str) -> None:
        """Switch an interface on."""
        self._run(host, "ip", "addr", "flush", "dev", network)
        self._run(host, "ip", "addr", "add", f"{address(host, network)}/24", "dev", network)
        self._run(host, "ip", "link", "set", "dev", network, "up")

    def down(self, host: str, network: str) -> None:
        """Switch an interface off: this end loses its route, the other end its carrier."""
        self._run(host, "ip", "link", "set", "dev", network, "down")

    def drop(self, host: str, network: str) -> None:
        """Drop all packets that arrive at an interface."""
        chain = f"type filter hook input priority 0; iifname {network} drop"
        self._run(host, "nft", f"table inet lost {{ chain in {{ {chain}; }}; }}")

    def drop_none(self, host: str) -> None:
        self._run(host, "nft", "delete", "table", "inet", "lost")

    def start(self, host: str) -> Host:
        """Start a host of the mission."""
        maps = [
            f"--map={each}=" + ",".join(f"{address(each, network)}:{PORT}" for network in NETWORKS)
            for each in HOSTS
        ]
        arguments = ["up", str(self._folder / "mission.dL"), "--host", host, *maps, "--no-record"]
        arguments += ["--keys", str(self._folder / "keys"), "--state", str(self._folder / f"state-{host}")]
        there = ["ip", "netns", "exec", self._named(host)]
        made = self.hosts[host] = Host([*there, sys.executable, "-um", "lfield", *arguments])
        return made

    def sent(self, host: str, network: str) -> int:
        """The bytes that a host has sent in a network, with the headers of Ethernet."""
        path = f"/sys/class/net/{network}/statistics/tx_bytes"
        words = ["ip", "netns", "exec", self._named(host), "cat", path]
        return int(subprocess.run(words, check=True, capture_output=True).stdout)

    def stamps(self) -> list[tuple[float, int]]:
        """All stamps of both hosts, in order of their times."""
        return sorted(stamp for host in self.hosts.values() for stamp in host.stamps())

    def wait_for_stamps(self, count: int) -> None:
        """Wait until there are `count` stamps."""
        end = time.monotonic() + TIMEOUT
        while len(self.stamps()) < count:
            assert time.monotonic() < end, self.text()
            time.sleep(0.05)

    def gap(self, since: float, until: float) -> float:
        """The longest time without a stamp that began between `since` and `until`."""
        times = [at for at, _ in self.stamps() if at >= since - 1.0]
        return max(later - max(since, at) for at, later in itertools.pairwise(times) if at < until)

    def text(self, since: float = 0.0) -> str:
        return "\n".join(f"--- {name}\n{host.text(since)}" for name, host in self.hosts.items())

    def close(self) -> None:
        for host in self.hosts.values():
            host.end()
        for host in HOSTS:
            subprocess.run(["ip", "netns", "del", self._named(host)], capture_output=True)
