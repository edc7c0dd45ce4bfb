"""What it costs a host to know a large team: processor time, and bytes on each link.

One host of 50 is measured with its 49 links on loopback TCP; the other hosts share a process. Every host has
5 agents with 4 live attributes each, all of which change in every second, so every host reports all of them
at its full rate. For comparison the same team in which nothing changes: what is left are the signs of life
that keep links.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from harness import Children, Figure, Row, free_port, times

HOSTS, AGENTS, SECONDS = 50, 5, 20.0
#: Percent of a processor, and kilobytes per second and link in both directions together.
TARGET_PROCESSOR, TARGET_LINK = 2.0, 20.0

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


def figure() -> Figure:
    """Both teams."""
    rows = [*_rows("all values change each second", swing=0.4), *_rows("nothing changes", swing=0.0)]
    notes = (f"{HOSTS} hosts x {AGENTS} agents x 4 live attributes, {SECONDS:g} s; links: both directions",)
    return Figure("Knowing a large team; ratio to the target", rows, notes)


def _rows(case: str, swing: float) -> list[Row]:
    """The processor time of one host and the bytes of its links."""
    processor, rate = measure(swing)
    return [
        Row(
            case,
            "processor time of a host",
            f"{processor:.2f} %",
            ratio=times(processor / TARGET_PROCESSOR),
            target=f"{TARGET_PROCESSOR:g} %",
        ),
        Row(
            "",
            "bytes on each link",
            f"{rate:.2f} kB/s",
            ratio=times(rate / TARGET_LINK),
            target=f"{TARGET_LINK:g} kB/s",
        ),
    ]


def measure(swing: float) -> tuple[float, float]:
    """Percent of a processor that a host needs, and kilobytes per second on each of its links."""
    with Children() as children, tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "large.L").write_text(_PROGRAM)
        (folder / "large.capabilities.yaml").write_text(_CAPABILITIES)
        cranes = [f"//Crane:crane{h}.{a}@host{h}" for h in range(HOSTS) for a in range(AGENTS)]
        (folder / "large.dL").write_text("\n".join([*cranes, "//Foreman:foreman@host0"]))
        # An address for each: of fifty free ports some would be taken again before they are listened on.
        port = free_port()
        maps = [f"host{number}=127.0.1.{number + 1}:{port}" for number in range(HOSTS)]
        words = (name, str(swing), str(SECONDS), *maps)
        others = children.start(sys.executable, _HOSTS, "others", *words)
        host = children.start(sys.executable, _HOSTS, "host", *words)
        came, went, seconds = map(float, others.line().split())
        rate = (came + went) / seconds / (HOSTS - 1) / 1000
        processor, seconds = map(float, host.line().split())
        known = int(host.line())
        if known != HOSTS * AGENTS:
            raise RuntimeError(f"the host knows {known} of {HOSTS * AGENTS} agents")
        return 100 * processor / seconds, rate
