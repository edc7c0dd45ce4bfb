"""A bug in the host's own code while its vehicle flies: the host says so and ends, the vehicle lands."""

from __future__ import annotations

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
