"""The emulated radio itself, with namespaces and a router; the model is tested in test_air.py."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest
from emulator.cells import CELLS, Cell, Link
from emulator.packets import UDP
from emulator.radio import Flow, Radio
from emulator.tun import missing

pytestmark = pytest.mark.skipif(bool(why := missing()), reason=why)

PORT = 9000
ECHO = f"""
import socket
s = socket.socket(type=socket.SOCK_DGRAM)
s.bind(("0.0.0.0", {PORT}))
print("ready", flush=True)
while True:
    s.sendto(*s.recvfrom(2048))
"""
#: Prints the milliseconds until the answer to one packet, or "lost".
ASK = f"""
import socket, sys, time
s = socket.socket(type=socket.SOCK_DGRAM)
s.settimeout(float(sys.argv[2]))
begun = time.monotonic()
s.sendto(bytes(600), (sys.argv[1], {PORT}))
try:
    s.recv(2048)
    print((time.monotonic() - begun) * 1e3)
except TimeoutError:
    print("lost")
"""
#: With the headers of IP and UDP.
SIZE = 628


def echo(radio: Radio, name: str) -> None:
    server = radio[name].start([sys.executable, "-Sc", ECHO], stdout=subprocess.PIPE)
    assert server.stdout is not None
    assert server.stdout.readline() == b"ready\n"


def ask(radio: Radio, name: str, address: str, timeout: float = 60.0) -> str:
    command = [sys.executable, "-Sc", ASK, address, timeout]
    return str(radio[name].run(command, capture_output=True, text=True, check=True).stdout.strip())


@pytest.mark.process
def test_packets_are_delayed_counted_cut_and_follow_an_address() -> None:
    with Radio("alpha", "bravo") as radio:
        echo(radio, "bravo")
        radio.set(Cell(Link(delay=0.05)))
        radio.reset()
        assert float(ask(radio, "alpha", radio["bravo"].address)) >= 100
        flows = {flow: count for flow, count in radio.counts().items() if flow.port == PORT}
        assert set(flows) == {Flow(a, b, UDP, PORT) for a, b in (("alpha", "bravo"), ("bravo", "alpha"))}
        assert {(c.packets, c.bytes, c.lost, c.payload) for c in flows.values()} == {(1, SIZE, 0, 600)}

        old = radio["bravo"].address
        radio["bravo"].move("10.77.0.71")
        assert ask(radio, "alpha", old, 0.2) == "lost"
        assert float(ask(radio, "alpha", "10.77.0.71")) >= 100

        radio.cut(60.0, "bravo")
        assert ask(radio, "alpha", "10.77.0.71", 0.2) == "lost"
        radio.mend()
        assert float(ask(radio, "alpha", "10.77.0.71")) >= 100


@pytest.mark.process
@pytest.mark.few(0)
@pytest.mark.parametrize("ipv6", [False, True])
def test_robots_have_only_loopback_and_the_radio(ipv6: bool) -> None:
    with Radio("alpha", ipv6=ipv6) as radio:
        output = radio["alpha"].run(["ip", "-o", "addr"], capture_output=True, text=True, check=True).stdout
        assert {line.split()[1] for line in output.splitlines()} == {"lo", "air0"}
        assert ("inet6" in output) == ipv6


@pytest.mark.process
@pytest.mark.few(0)
@pytest.mark.parametrize("name", ["50 ms", "200 ms + 5 %", "500 ms + 2 %", "57.6 kbit/s + 100 ms + 5 %"])
def test_cell_has_the_round_trip_of_its_name(name: str) -> None:
    cell = CELLS[name]
    with Radio("alpha", "bravo") as radio:
        echo(radio, "bravo")
        radio.set(Cell(Link(cell.link.delay), cell.channel))
        rate = cell.channel.rate
        expected = 2e3 * (cell.link.delay + (SIZE * 8 / rate if rate else 0.0))
        assert float(ask(radio, "alpha", radio["bravo"].address)) >= expected - 0.1


@pytest.mark.process
@pytest.mark.few(0)
def test_router_ends_with_the_radio() -> None:
    with Radio("alpha", "bravo") as radio:
        pids = [robot.pid for robot in radio]
        sleeper = radio["alpha"].start(["sleep", "600"])
    started = time.monotonic()
    assert sleeper.poll() is not None
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
    assert time.monotonic() - started < 5.0
