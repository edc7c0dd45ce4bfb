"""Robots on one computer, connected by a poor radio only: a network namespace and a TUN device each.

    with Radio("alpha", "bravo", seed=1) as radio:
        radio.set(CELLS["20 %"])
        server = radio["bravo"].start(["lfield", "up", ...])   # a Popen, killed with the radio
        radio["alpha"].run(["lfield", "estop", ...])
        radio.cut(5.0, "alpha")                                # loses all packets of a robot, or of a pair
        radio["alpha"].move("10.77.0.71")                      # changes its address
        radio.counts()                                         # packets and bytes by direction and port

The radio needs root, /dev/net/tun, unshare, nsenter and ip (`missing`). The networks of the computer do not
change.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple, Self

from emulator.cells import Cell, Link
from emulator.tun import DEVICE

#: The networks of all robots; the numbers of robots begin with 1.
NETWORK, NETWORK_V6 = "10.77.0.", "fd77::"
#: In bytes: smaller than that of Ethernet, as on most radios.
MTU = 1400
_TIMEOUT = 10.0


class Flow(NamedTuple):
    """A direction and a service: `to` is "" for packets to no robot, `port` the lower of both ports."""

    source: str
    to: str
    protocol: int
    port: int


class Count(NamedTuple):
    """Packets that robots have sent, including lost ones; bytes with their IP headers."""

    packets: int = 0
    bytes: int = 0
    lost: int = 0
    with_payload: int = 0
    payload: int = 0

    def __add__(self, other: tuple[Any, ...]) -> Count:
        return Count(*map(sum, zip(self, other, strict=True)))


class Robot:
    """A network namespace with loopback and the device of the radio."""

    def __init__(self, name: str, number: int, radio: Radio, ipv6: bool) -> None:
        self.name, self.address = name, f"{NETWORK}{number}"
        self.address_v6 = f"{NETWORK_V6}{number}" if ipv6 else ""
        self._radio = radio
        # This process holds the namespace until its stdin is closed: by `close`, or at the end of the tests.
        self._holder = subprocess.Popen(
            ["unshare", "--net", "sh", "-c", "echo; exec cat"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        assert self._holder.stdout is not None
        self._holder.stdout.readline()

    @property
    def pid(self) -> int:
        """A process in the namespace."""
        return self._holder.pid

    @property
    def addresses(self) -> list[str]:
        """The present addresses of the robot."""
        return [self.address, *filter(None, [self.address_v6])]

    def line(self, command: Sequence[object]) -> list[str]:
        """The command line that runs a command in the namespace; the started process becomes the command."""
        return ["nsenter", f"--net=/proc/{self.pid}/ns/net", *map(str, command)]

    def start(self, command: Sequence[object], **options: Any) -> subprocess.Popen[Any]:
        """Start a command, with options of `subprocess.Popen`; it is killed with the radio."""
        process = subprocess.Popen(self.line(command), **{"stdin": subprocess.DEVNULL} | options)
        self._radio.end_later(process)
        return process

    def run(self, command: Sequence[object], **options: Any) -> subprocess.CompletedProcess[Any]:
        """Run a command to its end, with options of `subprocess.run`."""
        return subprocess.run(self.line(command), **{"stdin": subprocess.DEVNULL} | options)

    def configure(self, congestion: str) -> None:
        """Bring the devices up, with reno where a namespace may not have the congestion control."""
        settings = "/proc/sys/net"
        script = f"""
            echo {congestion} 2>/dev/null >{settings}/ipv4/tcp_congestion_control ||
                echo reno >{settings}/ipv4/tcp_congestion_control
            echo 1 >{settings}/ipv4/tcp_no_metrics_save
            echo 1 >{settings}/ipv4/conf/all/promote_secondaries
            without_v6={settings}/ipv6/conf/all/disable_ipv6
            if [ -e $without_v6 ]; then echo {0 if self.address_v6 else 1} >$without_v6; fi
            ip link set lo up
            ip addr add {self.address}/24 dev {DEVICE}
            {f"ip addr add {self.address_v6}/64 dev {DEVICE} nodad" if self.address_v6 else ""}
            ip link set {DEVICE} mtu {MTU} up
        """
        self.run(["sh", "-ec", script], check=True)

    def move(self, address: str) -> None:
        """Change the IPv4 address, as roaming or DHCP do; bound sockets keep the old address."""
        script = f"ip addr add {address}/24 dev {DEVICE}; ip addr del {self.address}/24 dev {DEVICE}"
        self.run(["sh", "-ec", script], check=True)
        self.address = address
        self._radio.request("move", one=self.name, addresses=self.addresses)

    def close(self) -> None:
        """End the namespace, once its last process has ended."""
        assert self._holder.stdin is not None
        assert self._holder.stdout is not None
        self._holder.stdin.close()
        self._holder.stdout.close()
        self._holder.wait(_TIMEOUT)


class Radio:
    """Robots by name, the router between them, and the started processes; all end with the `with` block.

    The radio is perfect at first. Raises OSError or subprocess.CalledProcessError if a requirement is
    missing (`missing` names it).
    """

    def __init__(self, *names: str, seed: int = 1, congestion: str = "cubic", ipv6: bool = False) -> None:
        self._open, self._robots = ExitStack(), dict[str, Robot]()
        with ExitStack() as cleanup:
            for number, name in enumerate(names, 1):
                self._robots[name] = Robot(name, number, self, ipv6)
                cleanup.callback(self._robots[name].close)
            self._router = self._start_router(seed)
            cleanup.callback(self._end_router)
            for robot in self._robots.values():
                robot.configure(congestion)
            self._open = cleanup.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __getitem__(self, name: str) -> Robot:
        return self._robots[name]

    def __iter__(self) -> Iterator[Robot]:
        return iter(self._robots.values())

    def set(self, cell: Cell) -> None:
        """Set the radio of all pairs."""
        self.request("cell", cell=cell.as_json())

    def set_link(self, link: Link, one: str, other: str) -> None:
        """Set both directions of one pair, until the next `set`."""
        self.request("link", link=asdict(link), one=one, other=other)

    def cut(self, seconds: float, one: str, other: str | None = None) -> float:
        """Lose all packets of a robot, or of a pair. Returns the monotonic time of the path's return."""
        self.request("cut", seconds=seconds, one=one, other=other)
        return time.monotonic() + seconds

    def mend(self) -> None:
        """End all cuts."""
        self.request("mend")

    def counts(self) -> dict[Flow, Count]:
        """Counts of the packets of each flow since the start or the last `reset`."""
        return {Flow(*row[:4]): Count(*row[4:]) for row in self.request("counts")}

    def total(self, port: int | None = None) -> Count:
        """The sum of all flows, or of the flows of one port."""
        return sum((c for flow, c in self.counts().items() if port in (None, flow.port)), Count())

    def reset(self) -> None:
        """Set all counts to zero."""
        self.request("reset")

    def request(self, order: str, **words: object) -> Any:
        """Send a request to the router; returns its answer."""
        assert self._router.stdin is not None
        assert self._router.stdout is not None
        self._router.stdin.write(json.dumps({"do": order, **words}) + "\n")
        self._router.stdin.flush()
        if not (line := self._router.stdout.readline()):
            raise OSError("the router of the emulated radio has ended")
        return json.loads(line)

    def end_later(self, process: subprocess.Popen[Any]) -> None:
        """Kill a process at the end, unless it has ended."""
        self._open.callback(_end, process)

    def close(self) -> None:
        """End all started processes, the last started first."""
        self._open.close()

    def _start_router(self, seed: int) -> subprocess.Popen[str]:
        router = subprocess.Popen(
            [sys.executable, "-m", "emulator.router"],
            env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        robots = [{"name": r.name, "addresses": r.addresses, "pid": r.pid} for r in self]
        assert router.stdin is not None
        assert router.stdout is not None
        router.stdin.write(json.dumps({"seed": seed, "robots": robots}) + "\n")
        router.stdin.flush()
        if not router.stdout.readline():
            raise OSError("the router of the emulated radio did not start")
        return router

    def _end_router(self) -> None:
        assert self._router.stdin is not None
        assert self._router.stdout is not None
        self._router.stdin.close()
        self._router.stdout.close()
        self._router.wait(_TIMEOUT)


def _end(process: subprocess.Popen[Any]) -> None:
    process.kill()
    process.wait()
    for pipe in (process.stdout, process.stderr):
        if pipe is not None:
            pipe.close()
