"""A push of a small change to two robots on poor radio, compared with the whole bundle over plain TCP.

make bench ONLY=push            ten pushes in each cell, about five minutes; needs root for the namespaces
CELLS='20 %' make bench ONLY=push ROUNDS=3
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from emulator.cells import CELLS
from emulator.radio import Radio
from emulator.tun import missing
from harness.checkout import Checkout
from harness.figure import Figure, Row
from harness.number_text import COUNT
from harness.processes import Processes
from harness.samples import Tick, chosen, sentence
from radio_fleet import DESK, HOSTS, RadioFleet, result_of

PUSH_CELLS = ("perfect", "200 ms + 5 %", "57.6 kbit/s + 100 ms + 5 %", "20 %")
#: Lines of text in the program, and seconds for one push.
LINES, TIMEOUT = 150, 300.0
PORT, SERVICE = 9000, 8182
#: A program that receives a file and confirms it.
RECEIVER = f"""
import socket
s = socket.create_server(("", {PORT}))
print("ready", flush=True)
while True:
    c, _ = s.accept()
    while c.recv(65536): pass
    c.sendall(b"k"); c.close()
"""
#: A program with arguments SIZE ADDRESS...: sends SIZE bytes to all addresses at once; prints the seconds.
SENDER = f"""
import socket, sys, threading, time
data = __import__("os").urandom(int(sys.argv[1]))
def send(to):
    with socket.create_connection((to, {PORT})) as s:
        s.sendall(data); s.shutdown(socket.SHUT_WR); s.recv(1)
begun = time.monotonic()
threads = [threading.Thread(target=send, args=(to,)) for to in sys.argv[2:]]
for t in threads: t.start()
for t in threads: t.join()
print(time.monotonic() - begun)
"""


def rows(checkout: Checkout, samples: int, tick: Tick) -> Iterator[Row]:
    """The rows of all cells, or of those that $CELLS names."""
    if reason := missing():
        yield Row("push", "", error=reason)
        return
    for cell in chosen("CELLS", PUSH_CELLS):
        try:
            yield from _cell(cell, samples, tick)
        except Exception as error:
            yield Row(cell, "", error=sentence(error))


def _cell(cell: str, samples: int, tick: Tick) -> Iterator[Row]:
    with Processes() as processes, Radio(*HOSTS, DESK) as radio:
        fleet = RadioFleet(radio, Path(processes.folder()))
        fleet.up()
        size = result_of(fleet.desk("push", fleet.mission(LINES), "--json"), TIMEOUT)["size"]
        for host in HOSTS:
            server = radio[host].start([sys.executable, "-Sc", RECEIVER], stdout=subprocess.PIPE)
            assert server.stdout is not None
            server.stdout.readline()
        radio.set(CELLS[cell])
        pushes: list[float] = []
        sent: list[float] = []
        push_seconds: list[float] = []
        for number in range(samples):
            tick(f"{cell}, push {number + 1}")
            mission = fleet.mission(LINES, last=f"change {number}")
            radio.reset()
            started = time.monotonic()
            done = result_of(fleet.desk("push", mission, "--json"), TIMEOUT)
            assert done["outcome"] == "activated", done
            pushes.append(time.monotonic() - started)
            sent.append(radio.total(SERVICE).bytes)
            push_seconds.append(_whole(radio, size))
    yield Row(cell, "lfield push: built, sent, voted, active", samples=pushes)
    yield Row("", "TCP: the whole bundle, received", samples=push_seconds)
    yield Row("", "bytes on the air of a push to both", COUNT, sent)
    yield Row("", "bytes of the bundle", COUNT, [size])


def _whole(radio: Radio, size: int) -> float:
    """Seconds to send the bytes of a bundle to both robots."""
    addresses = [radio[host].address for host in HOSTS]
    command = [sys.executable, "-Sc", SENDER, str(size), *addresses]
    return float(radio[DESK].run(command, capture_output=True, text=True, check=True).stdout)


FIGURE = Figure(
    "Push of a small change to two robots on poor radio",
    {},
    rounds=10,
    own_rows=rows,
    one_size="the cells differ by the radio, not by a size",
    notes=(
        "a push includes the start of Python, the build, the signature, TLS and the vote",
        "bytes are those of IP packets of both directions, lost ones included",
    ),
)
