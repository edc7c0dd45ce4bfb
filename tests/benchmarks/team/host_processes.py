"""Real host processes on one computer: time until all are linked, CPU and memory of each, and `lfield ps`.

Each host has one resource without devices. The hosts run on loopback without journals and recordings, and
are started by one `lfield up --all`.
"""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.number_text import BYTES, PERCENT, SECONDS
from harness.paced import Round
from harness.processes import Child, ChildError, Processes, free_port
from harness.samples import Contender
from machine.small import processor_seconds

from lfield.replication.membership.overlay import Overlay

#: Numbers of hosts, limited by 2 cores and 23 GB.
TEAMS = 10, 20, 50, 100
#: Seconds within which all hosts of a team must be linked, and seconds of measurement at rest.
TIMEOUT, IDLE = 300.0, 15.0
#: The end of the log line about a new link.
ESTABLISHED = " established"
ALL_LINKED, STARTED = "all neighbours linked", "processor of a host until then"
AT_REST = "processor of a host at rest"
RESIDENT, OWN = "resident", "resident, shared pages divided"
PS, PS_JSON = "lfield ps", "lfield ps --json"
_PROGRAM = "resource Post { init(string[] arg) { } portal stay() { } }\n"


def team(hosts: int) -> Opener:
    """Measure a team of `hosts` processes."""

    def opener(checkout: Checkout, _: Processes) -> Contender:
        return lambda: measure(checkout, hosts)

    return opener


def measure(checkout: Checkout, hosts: int) -> Round:
    """Start the hosts, wait until all are linked, and measure them at rest."""
    with Processes() as processes:
        mission = write_mission(processes.folder(), hosts)
        options = ("--all", "--volatile", "--no-record")
        up = checkout.lfield(processes, "up", str(mission), *options, *_maps(hosts), merged=True)
        elapsed = _await_links(up, hosts)
        folders = _children(up.pid)
        started = sum(map(processor_seconds, folders))
        memory = [_memory(folder) for folder in folders]
        before, start = sum(map(processor_seconds, folders)), time.monotonic()
        time.sleep(IDLE)
        spent, seconds = sum(map(processor_seconds, folders)) - before, time.monotonic() - start
        commands = {name: [_command(checkout, mission, name)] for name in (PS, PS_JSON)}
        up.ask_to_end()
        up.ended(TIMEOUT)
        return {
            ALL_LINKED: [elapsed],
            STARTED: [started / hosts],
            AT_REST: [100 * spent / seconds / hosts],
            RESIDENT: [sum(rss for rss, _ in memory) / hosts],
            OWN: [sum(pss for _, pss in memory) / hosts],
            **commands,
        }


def write_mission(folder: Path, hosts: int) -> Path:
    """Write a team with one resource on each host; returns its deployment file."""
    (folder / "posts.L").write_text(_PROGRAM)
    mission = folder / "posts.dL"
    mission.write_text("".join(f"//Post:p{n}@h{n}\n" for n in range(hosts)))
    return mission


def _maps(hosts: int) -> list[str]:
    ports = set[int]()
    while len(ports) < hosts:
        ports.add(free_port())
    return [
        argument for n, port in enumerate(sorted(ports)) for argument in ("--map", f"h{n}=127.0.0.1:{port}")
    ]


def _await_links(up: Child, hosts: int) -> float:
    """Seconds until each host has logged a link with each neighbour. Raises ChildError after TIMEOUT."""
    names = [f"h{n}" for n in range(hosts)]
    expected = sum(len(Overlay(names, here).neighbours) for here in range(hosts))
    while expected:
        left = up.started + TIMEOUT - time.perf_counter()
        if left <= 0.0:
            raise ChildError(f"{expected} ends of links are missing after {TIMEOUT:g} s")
        expected -= up.line(left).endswith(ESTABLISHED)
    return time.perf_counter() - up.started


def _children(pid: int) -> list[Path]:
    """The folders in /proc of the hosts."""
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii")
    return [Path(f"/proc/{child}") for child in text.split()]


def _memory(folder: Path) -> tuple[float, float]:
    """Resident bytes (RSS), and bytes with shared pages divided (PSS)."""
    lines = (folder / "smaps_rollup").read_text(encoding="ascii").splitlines()
    sizes = {name: rest for name, _, rest in (line.partition(":") for line in lines)}
    rss, pss = (float(sizes[name].split()[0]) * 1024 for name in ("Rss", "Pss"))
    return rss, pss


def _command(checkout: Checkout, mission: Path, name: str) -> float:
    """Seconds of a whole command."""
    _, verb, *options = name.split()
    arguments = [checkout.python, "-m", "lfield", verb, str(mission), *options]
    start = time.perf_counter()
    subprocess.run(arguments, env=checkout.environment, stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - start


FIGURE = Figure(
    "Host processes on one computer",
    {f"{hosts} hosts": team(hosts) for hosts in TEAMS},
    rounds=1,
    units={
        ALL_LINKED: SECONDS, STARTED: SECONDS, AT_REST: PERCENT, RESIDENT: BYTES, OWN: BYTES,
        PS: SECONDS, PS_JSON: SECONDS,
    },
    sizes={f"{hosts} hosts": hosts for hosts in TEAMS},
    targets={PS: "1 s", PS_JSON: "1 s"},
    notes=("one lfield up --all on loopback; hosts have no devices, journals or keys",),
)  # fmt: skip
