"""A remote portal call over a Zenoh router, compared with TCP, both on loopback and in turns.

The router is the one of the Python package, as a process. The hosts and their messages are the same: TLS
runs from host to host.
"""

from __future__ import annotations

import sys
from pathlib import Path

from harness.checkout import Checkout, paced_mission
from harness.figure import Figure
from harness.processes import Processes, free_port
from harness.samples import Contender
from hops.hop import CALLS, SIZES, WARM_UP, hops

#: The router program of the transport's tests, and the L program of the hops.
ROUTER = Path(__file__).parents[2] / "net" / "zenoh" / "router_process.py"
PROGRAM = Path(__file__).parents[1] / "hops" / "hop.L"


def hops_over_zenoh(checkout: Checkout, processes: Processes) -> Contender:
    """Run the coordinator of hop.L on two hosts with addresses in a Zenoh fabric."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = processes.start(
        sys.executable, str(ROUTER), endpoint, environment=checkout.environment, folder=checkout.root
    )
    assert router.line() == "ready"
    inventory = processes.folder() / "inventory.yaml"
    inventory.write_text(
        f"zenoh: {{connect: [{endpoint}]}}\n"
        'hosts: {a: {addresses: ["zenoh:a"]}, b: {addresses: ["zenoh:b"]}}\n',
        encoding="utf-8",
    )
    arguments = "&".join(str(word) for word in (CALLS, WARM_UP, *SIZES))
    kept = CALLS // 2
    agents = (f"//Post:near@a?{kept}", f"//Post:far@b?{kept}", f"//Traveller:traveller@a?{arguments}")
    maps = ("--inventory", str(inventory), "--map", "a=zenoh:a:8181", "--map", "b=zenoh:b:8181")
    return paced_mission(checkout, processes, PROGRAM, agents, options=maps)


FIGURE = Figure(
    "A remote portal call over a router of Zenoh, beside TCP",
    {"lfield: a hop": hops, "lfield: a hop over Zenoh": hops_over_zenoh},
    base=("lfield: a hop",),
    rounds=8,
    sizes={f"{count} B": count for count in SIZES},
    ratios=(("lfield: a hop over Zenoh", "lfield: a hop", ""),),
    notes=(
        f"rounds of {CALLS} calls; a portal call is one hop; TLS 1.3 from host to host in both",
        "the router is a separate process that is not stopped between rounds",
    ),
    between=("lfield: a hop",),
)
