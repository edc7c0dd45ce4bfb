"""A bug in the host's own code while its vehicle flies: the host says so and ends, the vehicle lands."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[3] / "examples"


PROGRAM = """
include <mavlink/copter.L>;
coordinator Pilot {
    init(string[] arg) {
        Copter copter = findCopter(arg[1]);
        copter.takeOff(3.0);
        print("in the air");
        while (true) sleep(1.0);
    }
}
"""
#: Loaded by Python before anything else: soon after the line of the coordinator nothing works in the host.
BROKEN = """
import lfield.host.core as core
import lfield.host.team.host_services as world
import os

going_on, air = core.HostCore.run, []

def run(self):
    if air:
        raise ZeroDivisionError("planted")
    return going_on(self)

say = world.HostServices.log

def log(self, agent, text):
    air.append(text)
    say(self, agent, text)

core.HostCore.run, world.HostServices.log = run, log
"""


def test_a_host_with_a_bug_ends_with_70_and_its_copter_lands(lfield):
    deployment = lfield.mission(PROGRAM, "//Copter:lead@alpha\n//Pilot:pilot@alpha?lead\n", "silence: 2\n")
    lfield.write("broken/sitecustomize.py", BROKEN)
    path = {"PYTHONPATH": str(lfield.folder / "broken")}
    words = ("up", "--deploy", deployment, "--host", "alpha", "--sim", *lfield.maps(["alpha"]))
    host = lfield.start(*words, env=path)
    status = host.wait()
    assert status == 70, host.said
    assert "alpha stopped: bug in lfield: ZeroDivisionError: planted" in host.said
    assert "lead.fc in safe state 'land'" in host.said


@pytest.mark.few(0)
def test_guards_of_a_killed_host_log_json_lines_with_its_name(lfield):
    deployment = EXAMPLES / "01-first-flight" / "mission.dL"
    team = lfield.start("up", "--deploy", deployment, "--all", "--sim", "--until-done", "--json")
    team.wait_for("wing: at ")
    os.kill(lfield.child("bravo"), signal.SIGKILL)
    assert team.wait() == 3
    lines = [json.loads(line) for line in team.out]
    codes = {line["code"] for line in lines if line["host"] == "bravo"}
    assert "host-killed" in codes
    # The fake of the device has ended with the host: its guard reports the lost link.
    assert codes & {"mavlink-link-lost", "endpoint-lost"}, codes
    assert ("device-safe" in codes) != ("device-unconfirmed" in codes)
    assert not any("wing.fc" in line for line in team.err)
