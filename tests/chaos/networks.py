"""The networks of a round: TCP, or two linked Zenoh routers.

Every connection of two hosts over TCP, or of a host and its router over Zenoh, goes through a `LinkProxy`.
`--map` names addresses, an inventory the routers.
"""

from __future__ import annotations

import random
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from link_proxy import LinkProxy

#: The router program of the transport's tests.
ROUTER = Path(__file__).parents[1] / "net" / "zenoh" / "router_process.py"


class TcpNetwork:
    """Every host connects to every other host; one proxy for each direction."""

    def __init__(self, hosts: int) -> None:
        self._ports = free_ports(hosts)
        pairs = [(a, b) for a in range(hosts) for b in range(hosts) if a != b]
        self._links = {pair: LinkProxy(self._ports[pair[1]]) for pair in pairs}
        self._calls: dict[tuple[int, int], int] = {}
        self.routers: Sequence[RouterProcess] = ()

    async def open(self) -> None:
        """Open the proxies."""
        self._calls = {pair: await link.open() for pair, link in self._links.items()}

    def options(self, host: int) -> list[str]:
        """Options of `lfield up` for a host."""
        own = f"--map=h{host}=127.0.0.1:{self._ports[host]}"
        return [own, *(f"--map=h{b}=127.0.0.1:{at}" for (a, b), at in self._calls.items() if a == host)]

    @property
    def links(self) -> list[LinkProxy]:
        """All proxies."""
        return list(self._links.values())

    def links_of(self, host: int) -> list[LinkProxy]:
        """The proxies that isolate a host."""
        return [link for pair, link in self._links.items() if host in pair]

    def links_between(self, first: int, second: int) -> list[LinkProxy]:
        """The proxies that disconnect two hosts."""
        return [self._links[first, second], self._links[second, first]]

    async def close(self) -> None:
        """Break everything permanently."""
        for link in self.links:
            await link.close()


class RouterProcess:
    """A router that can be killed and restarted at its port."""

    def __init__(self, port: int, *connect: int) -> None:
        endpoints = [f"tcp/127.0.0.1:{each}" for each in (port, *connect)]
        self._command = [sys.executable, str(ROUTER), *endpoints]
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the router; hosts retry until it listens."""
        if self._process is None:
            quiet = subprocess.DEVNULL
            self._process = subprocess.Popen(self._command, stdout=quiet, stderr=quiet)

    def kill(self) -> None:
        """Kill the router."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


class RouterNetwork:
    """Two linked routers, each with half of the hosts; one proxy between each host and its router.

    A pair of hosts cannot be disconnected separately: both lose their router.
    """

    def __init__(self, hosts: int, folder: Path) -> None:
        near, far = free_ports(2)
        self._folder = folder
        self.routers: Sequence[RouterProcess] = (RouterProcess(near), RouterProcess(far, near))
        self.links = [LinkProxy(far if host % 2 else near) for host in range(hosts)]

    async def open(self) -> None:
        """Start the routers, open the proxies, and write an inventory for each host."""
        for router in self.routers:
            router.start()
        names = [f"h{number}" for number in range(len(self.links))]
        rows = "".join(f'  {name}: {{addresses: ["zenoh:{name}"]}}\n' for name in names)
        for name, link in zip(names, self.links, strict=True):
            endpoint = f"tcp/127.0.0.1:{await link.open()}"
            text = f"zenoh: {{connect: [{endpoint}]}}\nhosts:\n{rows}"
            self._inventory(name).write_text(text, encoding="utf-8")

    def _inventory(self, name: str) -> Path:
        return self._folder / f"{name}.inventory.yaml"

    def options(self, host: int) -> list[str]:
        """Options of `lfield up` for a host."""
        return [f"--inventory={self._inventory(f'h{host}')}"]

    def links_of(self, host: int) -> list[LinkProxy]:
        """The proxies that isolate a host."""
        return [self.links[host]]

    def links_between(self, first: int, second: int) -> list[LinkProxy]:
        """The proxies that disconnect two hosts."""
        return [self.links[first], self.links[second]]

    async def close(self) -> None:
        """Break everything permanently."""
        for link in self.links:
            await link.close()
        for router in self.routers:
            router.kill()


def free_ports(count: int) -> list[int]:
    """Loopback ports without a listener, below the system's range for outgoing connections."""
    found: list[int] = []
    while len(found) < count:
        port = random.SystemRandom().randrange(20000, 32000)
        with socket.socket() as probe:
            if port not in found and probe.connect_ex(("127.0.0.1", port)) != 0:
                found.append(port)
    return found
