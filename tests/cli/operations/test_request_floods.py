"""A client with only the right to observe sends thousands of requests at a time: the vehicle flies, a stop
arrives.
"""

from __future__ import annotations

import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from lfield.authority.identity import Right
from lfield.net.tls import TlsIdentity
from lfield.wire.codec import encode
from lfield.wire.messages import Hello
from lfield.wire.subscription_messages import Subscribe

pytestmark = pytest.mark.process

#: The copter receives commands continuously, and the link to the other host is in use.
PROGRAM = r"""
resource Copter {
    Mavlink fc;
    init(string[] arg) { fc.arm(); fc.takeoff(2.0); write("flies\n"); }
    portal hold() { fc.hold(); }
}
coordinator Pilot {
    init(string[] arg) {
        while (true) { findCopter("lead").hold(); findPost("post").look(); }
    }
}
resource Post { init(string[] arg) { } portal look() { write("is seen\n"); sleep(0.2); } }
"""
DEPLOYMENT = "//Copter:lead@alpha\n//Pilot:tom@alpha\n//Post:post@bravo\n"
DEVICES = """
silence: 1.0
agents:
  lead: {devices: {fc: {driver: mavlink, endpoint: 'udp:127.0.0.1:14550', waivers: [device_watchdog]}}}
"""
#: Links of one person, requests of each link, the size of a record, and seconds for a host to answer.
LINKS, REQUESTS, RECORD, TIMEOUT = 20, 20_000, 550, 60.0
#: Lines of a host or its guard after a delay by the flood.
BROKEN = re.compile("silent|safe state|timed out after|DeviceException|lost")


class Asker:
    """A link after the handshake, with all requests encoded."""

    def __init__(self, address: str, tls: TlsIdentity | None) -> None:
        self._link = connected(address)
        self._channel = tls.channel(calls=True) if tls else None
        hello, asked = encode(Hello("observer", "observer", 0)), encode(Subscribe(once=True)) * REQUESTS
        if self._channel is None:
            self._link.sendall(hello)
            self._rest = asked
            return
        while not self._channel.proven:
            self._link.sendall(self._channel.data_to_send())
            list(self._channel.receive(self._link.recv(1 << 16)))
        self._link.sendall(self._channel.data_to_send() + self._channel.encrypt(hello))
        parts = (asked[start : start + RECORD] for start in range(0, len(asked), RECORD))
        self._rest = b"".join(map(self._channel.encrypt, parts))

    def ask(self, over: threading.Event) -> None:
        """Send and read as fast as the host accepts, until the end."""
        self._link.settimeout(0.05)
        while not over.is_set():
            try:
                self._rest = self._rest[self._link.send(self._rest) :] if self._rest else b""
                self._link.recv(1 << 16)
            except TimeoutError:
                continue
            except OSError:
                break
        self._link.close()


def connected(address: str) -> socket.socket:
    if address.startswith("/"):
        link = socket.socket(socket.AF_UNIX)
        link.settimeout(TIMEOUT)
        link.connect(address)
        return link
    host, _, port = address.rpartition(":")
    return socket.create_connection((host, int(port)), TIMEOUT)


@contextmanager
def flood(address: str, tls: TlsIdentity | None) -> Iterator[None]:
    """All links send requests in this context."""
    over, askers = threading.Event(), [Asker(address, tls) for _ in range(LINKS)]
    threads = [threading.Thread(target=asker.ask, args=(over,)) for asker in askers]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        over.set()
        for thread in threads:
            thread.join()


@pytest.mark.few(0)
@pytest.mark.parametrize("way", ["TLS", "the door"])
def test_endless_requests_delay_neither_a_flight_nor_a_link_nor_a_stop(lfield, alone, way):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT, DEVICES)
    maps = lfield.maps(["alpha", "bravo"])
    arguments = ("--deploy", deployment, *maps)
    hosts = [
        lfield.start("up", *arguments, "--host", name, "--sim", env=alone) for name in ("alpha", "bravo")
    ]
    hosts[1].wait_for("is seen$")
    (address,) = Path(alone["XDG_RUNTIME_DIR"]).rglob("alpha.sock")
    keys = lfield.keys.issue("person", "anna", Right.OBSERVE)
    at_tls = maps[1].partition("=")[2], TlsIdentity(keys)
    with flood(*(at_tls if way == "TLS" else (str(address), None))):
        time.sleep(4.0)
        broken_lines = [line for host in hosts for line in (*host.out, *host.err) if BROKEN.search(line)]
        assert broken_lines == []
        started = time.monotonic()
        pressed = lfield("estop", *arguments, "--no-wait", env=alone)
        print(f"pressed and confirmed in {time.monotonic() - started:.1f} s")
        assert lfield.status(pressed) == 0, pressed.said
        assert pressed.out[0] == "alpha: lead.fc: safe"
