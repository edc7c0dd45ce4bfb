"""Small missions, written into a folder."""

from __future__ import annotations

from pathlib import Path

PROGRAM = """
resource Crane {
    Dynamixel boom;
    init(string[] arg) { while (true) yield(); }
    portal hoist(real height) emit real { return height; }
}
coordinator Boss {
    init(string[] arg) {
        Lift[] who = findLift("payload > 1.0");
        print(i2s(who.length()));
        return;
        print("never");
    }
}
"""
DEPLOYMENT = "//Crane:small@yard?1&2\n//Crane:large@dock:9000\n//Boss:boss@dock\n"
DEVICES = """
defaults: {heap: 2 MiB}
unreachable_after: 3
agents:
  small:
    call_depth: 77
    devices:
      boom: {driver: dynamixel, endpoint: "serial:/dev/ttyUSB0:57600", id: 1}
  large:
    devices:
      boom: {driver: dynamixel, endpoint: "serial:/dev/ttyUSB0:57600", id: 2, ttl: 0.25}
"""
CAPABILITIES = """
registry: 1
attributes:
  boom: {type: real, unit: deg, live: true}
providers:
  Crane:
    attributes: {payload: 50.0, environment: [terrestrial]}
    live: {boom: boom.position}
    serves: {Lift: {portals: {lift: hoist, lower: hoist}, when: payload > 1.0 && environment == terrestrial}}
agents:
  small: {payload: 1.5}
"""
PLAIN = """
resource Echo { init(string[] arg) { } portal say() { write("here\\n"); } }
coordinator Caller { init(string[] arg) { findEcho(arg[1]).say(); } }
"""
PLAIN_DEPLOYMENT = "//Caller:tom@alpha?echo\n//Echo:echo@bravo\n"


def write_rich(folder: Path) -> Path:
    """Write a mission with devices and its own registry; returns its deployment."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {".L": PROGRAM, ".devices.yaml": DEVICES, ".capabilities.yaml": CAPABILITIES, ".dL": DEPLOYMENT}
    for ending, text in texts.items():
        (folder / f"mission{ending}").write_text(text)
    return folder / "mission.dL"


def write_plain(folder: Path) -> Path:
    """Write a mission of two files; returns its deployment."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "mission.L").write_text(PLAIN)
    (folder / "mission.dL").write_text(PLAIN_DEPLOYMENT)
    return folder / "mission.dL"
