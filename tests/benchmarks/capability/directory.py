"""What it costs a host to know a large team: processor time, and bytes on each link.

One host of 50 is measured with its 49 links on loopback TCP; the other hosts share a process. Every host has
5 agents with 4 live attributes each, all of which change in every second, so every host reports all of them
at its full rate. For comparison the same team in which nothing changes: what is left are the signs of life
that keep links.
"""

from __future__ import annotations

from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.number_text import PERCENT, RATE
from harness.paced import Round
from harness.processes import ChildError, Processes, free_port
from harness.samples import Contender

HOSTS, AGENTS, SECONDS = 50, 5, 15.0
PROCESSOR, BYTES = "processor of a host", "bytes on each link"

_PROGRAM = """
resource Crane {
    Mavlink fc;

    init(string[] arg) { }
    portal hoist(real height) emit real { return height; }
}

coordinator Foreman {
    init(string[] arg) {
        Lift[] who = findLift();
        sleep(1000000.0);
    }
}
"""
_CAPABILITIES = """
registry: 1
providers:
  Crane:
    attributes: {payload: 50.0}
    live: {battery: fc.battery, north: "fc.position[0]", east: "fc.position[1]", down: "fc.position[2]"}
    serves: {Lift: {portals: {lift: hoist, lower: hoist}}}
"""
_HOSTS = str(Path(__file__).with_name("directory_hosts.py"))


def knowing(swing: float) -> Opener:
    """The team, with telemetry that swings so far."""

    def opener(checkout: Checkout, _: Processes) -> Contender:
        def measure() -> Round:
            with Processes() as processes:
                return _measure(checkout, processes, swing)

        return measure

    return opener


def _measure(checkout: Checkout, processes: Processes, swing: float) -> Round:
    folder = processes.folder()
    (folder / "large.L").write_text(_PROGRAM)
    (folder / "large.capabilities.yaml").write_text(_CAPABILITIES)
    cranes = [f"//Crane:crane{h}.{a}@host{h}" for h in range(HOSTS) for a in range(AGENTS)]
    (folder / "large.dL").write_text("\n".join([*cranes, "//Foreman:foreman@host0"]))
    # An address for each: of fifty free ports some would be taken again before they are listened on.
    port = free_port()
    maps = [f"host{number}=127.0.1.{number + 1}:{port}" for number in range(HOSTS)]
    words = str(folder), str(swing), str(SECONDS), *maps
    others = checkout.run(processes, _HOSTS, "others", *words)
    host = checkout.run(processes, _HOSTS, "host", *words)
    came, went, seconds = map(float, others.line(4 * SECONDS).split())
    processor, measured = map(float, host.line(4 * SECONDS).split())
    known = int(host.line())
    if known != HOSTS * AGENTS:
        raise ChildError(f"the host knows {known} of {HOSTS * AGENTS} agents")
    return {PROCESSOR: [100 * processor / measured], BYTES: [(came + went) / seconds / (HOSTS - 1) / 1000]}


FIGURE = Figure(
    "Knowing a large team",
    {"all values change each second": knowing(0.4), "nothing changes": knowing(0.0)},
    rounds=1,
    units={PROCESSOR: PERCENT, BYTES: RATE},
    one_size="one large team; `growth` has agents by number",
    targets={PROCESSOR: "2 %", BYTES: "20 kB/s"},
    notes=(f"{HOSTS} hosts x {AGENTS} agents x 4 live attributes, {SECONDS:g} s; links: both directions",),
)
