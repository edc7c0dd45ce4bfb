"""The mission of a fuzzed host and its simulated peers."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from msgspec.structs import replace

from lfield.mission.bindings import MissionStart
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission

PROGRAM = """
resource Bell {
    int rung; string[] who;
    init(string[] arg) { who = arg; }
    portal ring(int n, string word, real[] r) emit int { rung = rung + n; return rung; }
    portal slow(real s) emit string { sleep(s); return "slow"; }
    portal fail() { throw new ArithmeticException("no"); }
}
resource Crane {
    Mavlink fc;
    init(string[] arg) { }
    portal hoist(real height) emit real { return height; }
}
class Notes coordinator specific {
    public int n; public string[] texts; public Notes next;
    public Notes(int k) { n = k; texts = {"a", "b"}; }
}
coordinator Walker {
    Notes notes; Bell[] bells; real[][] table;
    init(string[] arg) {
        notes = new Notes(3); notes.next = notes;
        bells = new Bell[] {findBell("bell"), findBell("horn")};
        table = new real[][] {{1.0, 2.0}, {}};
        int[] got = {0, 0};
        for (int i = 0; i < 1000; i = i + 1) {
            try {
                bells[1].ring(i, "x", table[0]);
                bells[0].ring(i, "y", table[1]);
                together {
                    got[0] = bells[0].ring(1, "z", table[0]);
                    got[1] = bells[1].ring(2, "z", table[0]);
                }
                reserve (bells) { bells[0].slow(0.5); bells[1].slow(0.5); }
                within (2.0) { bells[0].slow(5.0); }
                bells[1].fail();
                Lift[] some = findLift("payload > 1.0 && battery > 0.1");
                if (some.length() > 0) some[0].lift(2.0);
            } catch (Exception e) { notes.texts[0] = e.message(); }

        }
    }
}
coordinator Idler {
    init(string[] arg) {
        heartbeatInterval(2);
        while (true) { findBell("bell").slow(1.0); sleep(1.0); }
    }
}
"""
CAPABILITIES = """
registry: 1
providers:
  Crane:
    attributes: {payload: 50.0}
    live: {battery: fc.battery, armed: fc.armed}
    serves: {Lift: {portals: {lift: hoist, lower: hoist}}}
agents:
  near: {payload: 1.5}
"""
DEPLOYMENT = """//Bell:bell@alpha?one&two
//Walker:tom@alpha
//Bell:horn@bravo
//Walker:ann@bravo
//Bell:gong@charlie
//Crane:near@alpha
//Crane:far@bravo
//Idler:idle@charlie
"""
DEVICES = """
defaults: {heap: 2 MiB}
unreachable_after: 3
silence: 0.5
recovery: {lease: 2, members: [alpha, bravo, charlie]}
frame: {origin: {latitude: 47.0, longitude: 8.0, altitude: 400}}
agents:
  near:
    call_depth: 77
    attributes: {payload: 2.0}
    frame: {north: 1.0, east: 2.0, down: 0.0, heading: 0.5}
    devices:
      fc:
        driver: mavlink
        endpoint: "udp:127.0.0.1:14550, serial:/dev/ttyUSB0:57600"
        system: 1
        kind: copter
        limits: {speed: 2.0, altitude: 20}
        without_policy: {after: 30, do: land}
        waivers: [device_watchdog]
  far:
    devices:
      fc: {driver: mavlink, endpoint: "serial:/dev/ttyS1:57600", system: 2, kind: copter, limits: {speed: 3}}
"""
HOSTS = ("alpha", "bravo", "charlie")


@cache
def mission() -> Mission:
    """The mission, compiled once. Its coordinators start without links: the fuzzer is the only peer."""
    with tempfile.TemporaryDirectory(prefix="lfield-") as folder:
        at = Path(folder)
        (at / "mission.L").write_text(PROGRAM)
        (at / "mission.dL").write_text(DEPLOYMENT)
        (at / "mission.capabilities.yaml").write_text(CAPABILITIES)
        loaded = load_mission(at / "mission.dL", simulate=True)
    alone = MissionStart(tuple(loaded.team.hosts))
    return loaded.with_bindings(replace(loaded.bindings, start=alone))
