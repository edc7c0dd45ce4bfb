"""No activation while a robot flies; a bundle staged in flight becomes active after the landing."""

from __future__ import annotations

import time

import pytest
from robots import Robots, told

pytestmark = pytest.mark.process

PROGRAM = """
resource Copter {
    Mavlink fc;
    init(string[] arg) { }
    portal fly() {
        fc.waitReady(90.0);
        fc.arm();
        fc.takeoff(3.0);
        write("up\\n");
        sleep(4.0);
        fc.land();
        write("CHANGED\\n");
    }
}
coordinator Pilot {
    init(string[] arg) { findCopter(arg[1]).fly(); }
}
"""
TEAM = "//Copter:lead@alpha\n//Pilot:pilot@alpha?lead\n"
DEVICES = """
agents:
  lead:
    devices:
      fc: {driver: mavlink, endpoint: "udp:127.0.0.1:14550", kind: copter, waivers: [device_watchdog]}
"""


@pytest.mark.few(0)
def test_a_flying_robot_votes_against_an_activation(lfield, here, robots) -> None:
    team: Robots = robots("alpha")
    team.up(options="--sim")
    lfield.mission(PROGRAM.replace("CHANGED", "down"), TEAM, DEVICES)
    first = here("push", "mission.dL", "--json")
    assert told(first)["outcome"] == "activated"
    here("start", status=0)
    team.services["alpha"].wait_for("^up$")
    lfield.mission(PROGRAM.replace("CHANGED", "landed"), TEAM, DEVICES)
    refused = here("push", "mission.dL", "--json")
    assert (refused.status, told(refused)["outcome"]) == (1, "aborted")
    assert told(refused)["reasons"] == {"alpha": "lead.fc is off the ground"}
    team.services["alpha"].wait_for("^down$")
    end = time.monotonic() + 60
    while told(here("status", "--json"))["alpha"]["refusal"]:
        assert time.monotonic() < end
        time.sleep(0.2)
    again = told(here("push", "mission.dL", "--json"))
    assert again["outcome"] == "activated"
    assert again["bundle"] != told(first)["bundle"]
