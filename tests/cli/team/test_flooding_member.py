"""A member of the team that sends without an end: guards keep time, a stop gets through, the log names it."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.process

PROGRAM = """
resource Copter {
    Mavlink fc;
    init(string[] arg) { fc.arm(); fc.takeoff(2.0); write("flies\\n"); while (true) { sleep(0.2); fc.hold(); } }
}
resource Post { init(string[] arg) { } portal greet() { write("greeted\\n"); } }
coordinator Guest { init(string[] arg) { findPost("here").greet(); sleep(1000.0); } }
"""
DEPLOYMENT = "//Copter:lead@alpha\n//Post:here@alpha\n//Guest:tom@charlie\n//@bravo\n"


@pytest.mark.parametrize("kind", ["pings", "records", "gossip", "rooms", "transfers", "handshakes"])
@pytest.mark.parametrize("rate", ["50", "0"])
def test_a_member_that_floods(lfield, alone, kind, rate):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    maps = lfield.maps(["alpha", "bravo", "charlie"])
    port = int(maps[1].rpartition(":")[2])
    up = ("up", "--deploy", deployment, *maps, "--sim", "--first-start", "--host")
    alpha = lfield.start(*up, "alpha", env=alone)
    alpha.wait_for("flies")
    script = Path(__file__).with_name("flooding.py")
    bravo = subprocess.Popen([sys.executable, str(script), str(port), str(lfield.keys.folder / "bravo"), "bravo", kind, rate], stdout=subprocess.PIPE, text=True)
    try:
        if kind != "handshakes": assert "linked" in bravo.stdout.readline()
        began = time.monotonic()
        charlie = lfield.start(*up, "charlie", env=alone)
        alpha.wait_for("greeted")
        print("hop", time.monotonic()-began)
        time.sleep(8)
        shown = lfield("ps", "--deploy", deployment, *maps, "--json", env=alone)
        hosts = json.loads("\n".join(shown.out))
        print("late", {h: s.get("late") for h, s in hosts.items()})
        pressed_at = time.monotonic()
        pressed = lfield("estop", "--deploy", deployment, *maps, "--no-wait", env=alone)
        print("stop", time.monotonic() - pressed_at, pressed.said)
        print(alpha.said)
    finally:
        bravo.kill()
        bravo.wait()
        print(bravo.stdout.read())
    assert 0
