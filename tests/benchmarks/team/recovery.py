"""How long a coordinator stands still whose host is killed with SIGKILL: real processes on loopback.

Under `self` that host is started again: from the start of the new process until the program goes on. Under
`quorum` it never is: from the kill until the program goes on on another host. No devices: what opening them
takes is theirs. Three hosts, of which one has no agents.
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

#: Seconds in which nobody may be heard to have it, and the most that leases may take behind that.
INTERVAL, LEASES = 3.0, 3.0
AGENTS = ("//Post:far@b", "//@c", "//Traveller:traveller@a")
GOES_ON = "traveller: goes on"
SELF, QUORUM = "self, from the start of its process", "quorum, from the kill"

_PROGRAM = Path(__file__).with_name("recovery.L")


def until(child: Child, line: str) -> float:
    """When it says so."""
    while child.line() != line:
        pass
    return time.perf_counter()


def kill(child: Child) -> float:
    """SIGKILL; returns when."""
    os.kill(child.pid, signal.SIGKILL)
    return time.perf_counter()


def by_its_host(checkout: Checkout, processes: Processes) -> float:
    """Seconds until it goes on where it was."""
    mission, hosts = _up(checkout, processes, "")
    kill(hosts["b"])
    hosts["b"].end()
    again = mission.host(checkout, processes, "b", merged=True)
    return until(again, GOES_ON) - again.started


def by_a_majority(checkout: Checkout, processes: Processes) -> float:
    """Seconds until it goes on elsewhere."""
    _, hosts = _up(checkout, processes, f"heartbeatInterval({INTERVAL});")
    # The others have had a heartbeat that names it.
    time.sleep(1.0)
    killed = kill(hosts["b"])
    return until(hosts["a"], GOES_ON) - killed


def _up(checkout: Checkout, processes: Processes, interval: str) -> tuple[Mission, dict[str, Child]]:
    """The mission, and its hosts when the coordinator is where it stays."""
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
    "From the death of a coordinator's host until it goes on",
    {
        "lfield: self": partial(_measured, SELF, by_its_host),
        "lfield: quorum": partial(_measured, QUORUM, by_a_majority),
    },
    rounds=8,
    one_size="one team, whose times are given",
    targets={QUORUM: f"{INTERVAL + LEASES:g} s"},
    notes=(
        "under self nearly all of it is the start of Python",
        f"under quorum {INTERVAL:g} s of silence, up to 0.75 s to ask, 2.06 s until no lease of 2 s is left",
    ),
)
