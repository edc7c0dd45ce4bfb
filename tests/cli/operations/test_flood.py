"""Unauthenticated connections: their cost for a host, and the access of its peers and observers."""

from __future__ import annotations

import contextlib
import re
import socket
import ssl
import threading
import time
from pathlib import Path

import pytest

from lfield.wire.codec import HANDSHAKE_LIMITS, HELLO, MAGIC
from lfield.wire.framing import frame_header

pytestmark = pytest.mark.process

PROGRAM = """
resource Post { init(string[] arg) { } portal greet() { write("greeted\\n"); } }
coordinator Guest { init(string[] arg) { findPost("near").greet(); } }
"""
DEPLOYMENT = "//Post:near@alpha\n//Guest:tom@bravo\n//Post:far@bravo\n"
#: Connections at a time, and the limit of their memory in KiB.
MANY, MOST = 500, 30 << 10


class Flood:
    """Keeps connections to a port open, each of which sends only the start of a handshake."""

    def __init__(self, port: int, start: bytes) -> None:
        self._port, self._start = port, start
        self._open: list[socket.socket] = []
        self._over = threading.Event()
        self.called = 0
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Flood:
        self._thread.start()
        while self.called < 4 * MANY:
            time.sleep(0.05)
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._over.is_set():
            if len(self._open) == MANY:
                self._open.pop(0).close()
            try:
                self._open.append(socket.create_connection(("127.0.0.1", self._port), 5.0))
                self._open[-1].sendall(self._start)
            except OSError:
                continue
            finally:
                self.called += 1
        for link in self._open:
            link.close()


def peak(pid: int) -> int:
    """The peak memory of a process, in KiB."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    assert found
    return int(found[1])


def first_words() -> bytes:
    """The first bytes of a TLS handshake."""
    out, context = ssl.MemoryBIO(), ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    with contextlib.suppress(ssl.SSLWantReadError):
        context.wrap_bio(ssl.MemoryBIO(), out).do_handshake()
    return out.read()


#: States of the host: it waits for a certificate, for the rest of the largest record, for the rest of a
#: frame.
STARTS = {
    "a whole first word": first_words(),
    "half a record": b"\x16\x03\x01\x40\x00\x01\x00\x3f\xfc\x03\x03" + bytes(16000),
    "a frame": frame_header(HELLO, HANDSHAKE_LIMITS[HELLO]) + MAGIC + bytes(1000),
}


@pytest.mark.few(0)
@pytest.mark.parametrize("start", STARTS)
def test_a_flood_costs_little_memory_and_blocks_no_peer(lfield, start):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    maps = lfield.maps(["alpha", "bravo"])
    up = ("up", "--deploy", deployment, *maps, "--host")
    alpha = lfield.start(*up, "alpha")
    alpha.wait_for("alpha listening on")
    before = peak(alpha.pid)
    port = int(maps[1].rpartition(":")[2])
    with Flood(port, STARTS[start]) as flood:
        started = flood.called, time.monotonic()
        lfield.start(*up, "bravo")
        alpha.wait_for("greeted")
        alpha.wait_for("link to bravo established")
        lfield("ps", "--deploy", deployment, *maps, status=0)
        rate = (flood.called - started[0]) / (time.monotonic() - started[1])
    cost = peak(alpha.pid) - before
    print(f"{flood.called} connections that do not greet, {rate:.0f} / s: {cost / 1024:.1f} MiB more")
    assert cost < MOST
