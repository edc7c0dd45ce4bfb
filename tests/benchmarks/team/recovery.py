"""The pause of a coordinator whose host is killed with SIGKILL: real processes on loopback.

Under `self` the host is restarted: the time from the start of the new process until the program continues.
Under `quorum` the host is not restarted: the time from the kill until the program continues on another host.
Three hosts without devices, one of them without agents.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from harness.checkout import Checkout, Mission
from harness.figure import Figure
from harness.paced import Round
from harness.processes import Child, Processes
from harness.samples import Contender

#: Seconds without a heartbeat until the recovery, and the most seconds for the leases after them.
INTERVAL, LEASES = 3.0, 3.0
AGENTS = ("//Post:far@b", "//@c", "//Traveller:traveller@a")
CONTINUES = "traveller: continues"
SELF, QUORUM = "self, from the start of its process", "quorum, from the kill"

_PROGRAM = Path(__file__).with_name("recovery.L")


def until(child: Child, line: str) -> float:
    """Wait for a line; returns the time."""
    while child.line() != line:
        pass
    return time.perf_counter()


def kill(child: Child) -> float:
    """Send SIGKILL; returns the time."""
    os.kill(child.pid, signal.SIGKILL)
    return time.perf_counter()


def by_its_host(checkout: Checkout, processes: Processes) -> float:
    """Seconds until the program continues on the restarted host."""
    mission, hosts = _up(checkout, processes, "")
    kill(hosts["b"])
    hosts["b"].end()
    again = mission.host(checkout, processes, "b", merged=True)
    return until(again, CONTINUES) - again.started


def by_a_majority(checkout: Checkout, processes: Processes) -> float:
    """Seconds until the program continues on another host."""
    _, hosts = _up(checkout, processes, f"heartbeatInterval({INTERVAL});")
    # The other hosts have received a heartbeat of the coordinator.
    time.sleep(1.0)
    killed = kill(hosts["b"])
    return until(hosts["a"], CONTINUES) - killed


def _up(checkout: Checkout, processes: Processes, interval: str) -> tuple[Mission, dict[str, Child]]:
    """Start the mission; returns it and its hosts once the coordinator has arrived on host b."""
    program = _PROGRAM.read_text(encoding="utf-8").replace("INTERVAL", interval)
    mission = Mission(processes.folder(), program, AGENTS, kept=True)
    hosts = {host: mission.host(checkout, processes, host, merged=True) for host in mission.addresses}
    until(hosts["b"], "stays")
    return mission, hosts


def _measured(
    case: str, measure: Callable[[Checkout, Processes], float], checkout: Checkout, _: Processes
) -> Contender:
    def contender() -> Round:
        with Processes() as processes:
            return {case: [measure(checkout, processes)]}

    return contender


FIGURE = Figure(
    "From the failure of a coordinator's host until the program continues",
    {
        "lfield: self": partial(_measured, SELF, by_its_host),
        "lfield: quorum": partial(_measured, QUORUM, by_a_majority),
    },
    rounds=8,
    one_size="one team with fixed intervals",
    targets={QUORUM: f"{INTERVAL + LEASES:g} s"},
    notes=(
        "self: nearly all of the time is the start of Python",
        f"quorum: {INTERVAL:g} s of silence, 0.75 s at most for the query, 2.06 s until leases of 2 s end",
    ),
)
