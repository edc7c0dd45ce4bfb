"""`up` on a slow computer: simulated vehicles continue to fly, hardware is not opened."""

from __future__ import annotations

import itertools
import json
import os
import re
import signal
import time

import pytest

from lfield import event_loop
from lfield.clock import SystemClock

PROGRAM = """
include <mavlink/copter.L>;
coordinator Pilot {
    init(string[] arg) {
        Copter copter = findCopter(arg[1]);
        copter.takeOff(1.0);
        print("in the air");
        copter.land();
        print("landed");
    }
}
"""
DEPLOYMENT = "//Copter:lead@alpha\n//Pilot:pilot@bravo?lead\n"
HARDWARE = """\
silence: 0.1
agents:
  lead:
    devices:
      fc: {driver: mavlink, endpoint: "udp:127.0.0.1:9", waivers: [device_watchdog]}
"""


@pytest.mark.few(0)
@pytest.mark.process
def test_a_simulated_team_survives_half_a_second_without_a_processor(lfield):
    """The devices file allows 0.1 s of silence in the field, which a busy computer cannot keep.

    Hosts, guards and fakes are stopped in sequence. The copter hovers.
    """
    program = PROGRAM.replace("copter.land();", "sleep(8.0); copter.land();")
    deployment = lfield.mission(program, DEPLOYMENT, HARDWARE)
    team = lfield.start("up", "--deploy", deployment, "--all", "--sim", "--until-done")
    team.wait_for("in the air")
    for process in lfield.left():
        os.kill(process, signal.SIGSTOP)
        time.sleep(0.6)
        os.kill(process, signal.SIGCONT)
        time.sleep(0.1)
    assert team.wait() == 0, team.said
    assert "pilot: landed" in team.said
    assert "silent for over" not in team.said


@pytest.fixture
def late(monkeypatch):
    """A computer that stalls for 0.12 s repeatedly."""
    polls, monotonic = itertools.count(), SystemClock.monotonic
    late = staticmethod(lambda: monotonic() + 0.12 * (next(polls) // 15))
    monkeypatch.setattr(SystemClock, "monotonic", late)


@pytest.mark.usefixtures("late")
def test_a_host_too_slow_for_its_bindings_does_not_start(here, lfield, monkeypatch):
    monkeypatch.setattr(event_loop, "may_raise_timer_priority", lambda: False)
    deployment = lfield.mission(PROGRAM, DEPLOYMENT, HARDWARE)
    up = here("up", "--deploy", deployment, "--host", "alpha", *lfield.maps(["alpha", "bravo"]), status=69)
    # A really late computer may print more lines, before and after this one.
    (expected_lines,) = [
        line for line in up.err if line.startswith("'silence: 0.1' is too short for this computer")
    ]
    # More than 0.12 s, if the computer is really late during the measurement.
    assert re.search(r"are up to [\d.]+ s late, and the shortest possible silence is ", expected_lines)
    assert "reduce the load of this computer, give its guards real-time priority" in expected_lines
    assert re.search(r"or write 'silence: [\d.]+' if ", expected_lines)


@pytest.mark.few(0)
@pytest.mark.process
def test_ps_and_doctor_show_the_delay(lfield):
    deployment = lfield.mission(PROGRAM.replace("copter.land();", "sleep(1000.0);"), DEPLOYMENT, HARDWARE)
    team = lfield.start("up", "--deploy", deployment, "--all", "--sim")
    team.wait_for("in the air")
    data = json.loads("\n".join(lfield("ps", "--deploy", deployment, "--json").out))
    assert data["alpha"]["silence"] == 2.0
    assert 0.0 <= data["alpha"]["late"] < 2.0
    assert (data["bravo"]["late"], data["bravo"]["silence"]) == (None, None)
    output = lfield("ps", "--deploy", deployment).out
    assert any(line.split()[:3] == ["HOST", "HEARTBEAT", "DELAY"] for line in output)
    doctor = lfield("doctor")
    expected_lines = (
        "ok      heartbeats to guards up to",
        "warning 'silence: 0.2' is too short for this computer",
    )
    assert any(line.startswith(expected_lines) for line in doctor.out), doctor.said
