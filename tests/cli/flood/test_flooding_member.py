"""A team member that sends continuously: guards keep their periods, a stop arrives, the log names it."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytestmark = pytest.mark.process

PROGRAM = """
resource Copter {
    Mavlink fc;
    init(string[] arg) { }
    portal fly() {
        fc.arm();
        fc.takeoff(2.0);
        write("flies\\n");
        try { while (true) { sleep(0.2); fc.hold(); } }
        catch (DeviceException held) { }
    }
}
resource Post { init(string[] arg) { } portal greet() { write("greeted\\n"); } }
coordinator Guest { init(string[] arg) { findPost("here").greet(); findCopter("lead").fly(); } }
"""
DEPLOYMENT = "//Copter:lead@alpha\n//Post:here@alpha\n//Guest:tom@charlie\n//@bravo\n"
KINDS = ("pings", "records", "gossip", "rooms", "transfers", "turns", "oversize", "handshakes")


class Flood:
    """The flooding process and its output."""

    def __init__(self, popen: subprocess.Popen[str]) -> None:
        self._popen = popen

    def next(self, word: str) -> float:
        """The monotonic time of the next output line with this word."""
        assert self._popen.stdout is not None
        for line in self._popen.stdout:
            if line.startswith(word):
                return float(line.split()[1])
        raise AssertionError(f"it ended without {word}")


@contextmanager
def flooding(lfield, port: int, kind: str) -> Iterator[Flood]:
    script = Path(__file__).with_name("flood_callers.py")
    arguments = [sys.executable, str(script), str(port), str(lfield.keys.folder / "bravo"), "bravo", kind]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True, env=lfield.environment) as popen:
        try:
            yield Flood(popen)
        finally:
            popen.kill()


# tests/net/test_members.py has the same in virtual time.
@pytest.mark.few(0)
@pytest.mark.parametrize("kind", KINDS)
def test_a_flooding_member_does_not_block_others_and_is_named(lfield, alone, kind):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    maps = lfield.maps(["alpha", "bravo", "charlie"])
    team = ("--deploy", deployment, *maps)
    up = ("up", *team, "--sim", "--first-start", "--host")
    alpha = lfield.start(*up, "alpha", env=alone)
    alpha.wait_for("alpha listening")
    with flooding(lfield, int(maps[1].rpartition(":")[2]), kind) as flood:
        linked = flood.next("linked")
        lfield.start(*up, "charlie", env=alone)
        alpha.wait_for("greeted")
        alpha.wait_for("flies")
        alpha.wait_for(r"host bravo at 127\.0\.0\.1 disconnected: .*; bravo is accept")
        if kind != "handshakes":
            assert flood.next("closed") - linked >= 5.0
        flood.next("refused")
        flood.next("linked")
        started = time.monotonic()
        pressed = lfield("estop", *team, "--no-wait", env=alone)
        elapsed = time.monotonic() - started
        assert "alpha: lead.fc: safe" in pressed.out, pressed.said
        status = json.loads("\n".join(lfield("ps", *team, "--json", env=alone).out))
    print(f"{kind}: beats were late by {status['alpha']['late']} s at most, a stop took {elapsed:.2f} s")
    assert "the host was silent" not in alpha.said
