"""A remote portal call, compared with a remote method call.

Two hosts run as real processes on loopback TCP. One call is one hop: the block is sent once, and only an
asynchronous confirmation returns. With an RPC library the caller does not move: one call is a request and a
reply with the same bytes in both. The live state is an int array of the given size in addition to the
coordinator. The L program measures the time: the two hosts share this computer's clock.
"""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path

from harness.checkout import Checkout, paced_mission
from harness.figure import Figure, Opener
from harness.processes import Processes
from harness.samples import Contender
from hops.rpc import CLIENTS, Echo

from lfield.testing.keyring import Keyring

SIZES = (64, 1 << 10, 8 << 10, 64 << 10)
CALLS, WARM_UP = 300, 20

_HERE = Path(__file__).parent


def hops(checkout: Checkout, processes: Processes, *, kept_on_disk: bool = False) -> Contender:
    """The coordinator of hop.L, on two hosts."""
    return paced_mission(checkout, processes, _HERE / "hop.L", _agents(), kept=kept_on_disk)


def leased_hops(checkout: Checkout, processes: Processes) -> Contender:
    """The same with recovery by a quorum, which needs a third host, without agents."""
    first = "        near = findPost"
    text = (_HERE / "hop.L").read_text(encoding="utf-8")
    program = processes.folder() / "hop.L"
    program.write_text(text.replace(first, f"        heartbeatInterval(3.0);\n{first}"), encoding="utf-8")
    return paced_mission(checkout, processes, program, (*_agents(), "//@c"), kept=True)


def _agents() -> tuple[str, ...]:
    arguments = "&".join(str(word) for word in (CALLS, WARM_UP, *SIZES))
    kept = CALLS // 2
    return f"//Post:near@a?{kept}", f"//Post:far@b?{kept}", f"//Traveller:traveller@a?{arguments}"


def calls(library: str) -> Opener:
    """Echo calls of a library."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        keys = Keyring(processes.folder()).give("host") / "host"
        server = checkout.run(processes, str(_HERE / "rpc.py"), library, str(keys))
        echo = CLIENTS[library](int(server.line()), keys)
        return lambda: {f"{count} B": _echoes(echo, count) for count in SIZES}

    return opener


def _echoes(echo: Echo, count: int) -> list[float]:
    """Seconds of each of CALLS echoes, after a warm-up."""
    data, durations = bytes(count), []
    for _ in range(WARM_UP):
        echo(data)
    for _ in range(CALLS):
        start = time.perf_counter()
        echo(data)
        durations.append(time.perf_counter() - start)
    return durations


FIGURE = Figure(
    "A remote portal call by live state; ratio to the fastest RPC library",
    {
        "lfield: a hop": hops,
        "lfield: a hop, kept on disk": partial(hops, kept_on_disk=True),
        "lfield: a hop, kept, under leases": leased_hops,
        "TCP, echo": calls("TCP"),
        "Pyro5, method call": calls("Pyro5"),
        "RPyC, method call": calls("RPyC"),
        "RPyC in TLS, method call": calls("RPyC in TLS"),
        "gRPC, method call": calls("gRPC"),
    },
    base=("Pyro5, method call", "RPyC, method call", "gRPC, method call"),
    rounds=8,
    sizes={f"{count} B": count for count in SIZES},
    ratios=(
        ("lfield: a hop", "RPyC, method call", "0.60x"),
        ("lfield: a hop", "RPyC in TLS, method call", ""),
        ("lfield: a hop", "TCP, echo", "4.00x"),
    ),
    notes=(
        f"rounds of {CALLS} calls; a portal call is one hop, a method call or an echo goes and returns",
        "a hop is in TLS 1.3 with certificates on both sides; of the others only what says so is",
    ),
    between=("lfield: a hop",),
)
