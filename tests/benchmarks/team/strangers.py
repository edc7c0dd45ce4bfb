"""The memory cost of 2,000 simultaneous unauthenticated connections for a host.

Each connection sends only the first message of a TLS handshake, half of that message, or other bytes.
"""

from __future__ import annotations

import contextlib
import re
import socket
import ssl
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

from harness.checkout import Checkout, Mission
from harness.figure import Figure, Opener
from harness.number_text import BYTES
from harness.paced import Round
from harness.processes import Child, Processes
from harness.samples import Contender

#: Connections that are open at a time, and in total.
MANY, IN_ALL = 2000, 4000

_PROGRAM = """
resource Post { init(string[] arg) { } portal greet() { } }
coordinator Guest { init(string[] arg) { while (true) findPost("near").greet(); } }
"""


def client_hello() -> bytes:
    """The first message of a client in a TLS handshake."""
    out, context = ssl.MemoryBIO(), ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    with contextlib.suppress(ssl.SSLWantReadError):
        context.wrap_bio(ssl.MemoryBIO(), out).do_handshake()
    return out.read()


def flooded(start: Callable[[], bytes]) -> Opener:
    """Measure a host under connections with these first bytes; every round starts a new host."""

    def opener(checkout: Checkout, _: Processes) -> Contender:
        return partial(_round, checkout, start())

    return opener


def _round(checkout: Checkout, start: bytes) -> Round:
    with Processes() as processes:
        mission = Mission(processes.folder(), _PROGRAM, ("//Post:near@a", "//Post:far@b"))
        host = mission.host(checkout, processes, "a", merged=True)
        while " listening " not in host.line():
            pass
        before = _peak(host)
        _flood(int(mission.addresses["a"].rpartition(":")[2]), start)
        return {"more memory at its peak": [float(_peak(host) - before)]}


def _flood(port: int, start: bytes) -> None:
    """Keep MANY connections open; two threads, because one waits for the host."""
    threads = [threading.Thread(target=_half, args=(port, start)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def _half(port: int, start: bytes) -> None:
    held: list[socket.socket] = []
    for _ in range(IN_ALL // 2):
        if len(held) == MANY // 2:
            held.pop(0).close()
        with contextlib.suppress(OSError):
            held.append(socket.create_connection(("127.0.0.1", port), 10.0))
            held[-1].sendall(start)
    for link in held:
        link.close()


def _peak(host: Child) -> int:
    found = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{host.pid}/status").read_text(encoding="ascii"))
    assert found
    return int(found[1]) * 1024


_HALF = b"\x16\x03\x01\x40\x00\x01\x00\x3f\xfc\x03\x03" + bytes(16000)

FIGURE = Figure(
    f"A host under {MANY} unauthenticated connections",
    {
        "an incomplete handshake": flooded(client_hello),
        "half a handshake record": flooded(lambda: _HALF),
        "no TLS": flooded(lambda: bytes(1000)),
    },
    rounds=3,
    units={"more memory at its peak": BYTES},
    one_size="one number of connections: a host holds at most 64",
    targets={"more memory at its peak": "30.0 MB"},
    notes=(f"{MANY} are open at a time, {IN_ALL} in total; a host holds 64 without a Hello",),
)
