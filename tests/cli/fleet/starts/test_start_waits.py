"""`lfield start` and `lfield status` if the mission's host does not start."""

from __future__ import annotations

import time

import pytest
from robots import told

pytestmark = pytest.mark.process

PROGRAM = """
resource Copter { Mavlink fc; init(string[] arg) { } portal fly() { } }
coordinator Pilot { init(string[] arg) { findCopter(arg[1]).fly(); } }
"""
TEAM = "//Copter:lead@alpha\n//Pilot:pilot@alpha?lead\n"
#: A computer without an autopilot.
DEVICES = """
agents:
  lead:
    devices:
      fc: {driver: mavlink, endpoint: "serial:/dev/ttyNONE:57600", kind: copter, waivers: [device_watchdog]}
"""


@pytest.mark.few(0)
def test_a_start_reports_why_a_host_ends_repeatedly(lfield, here, robots) -> None:
    team = robots("alpha")
    team.up()
    lfield.mission(PROGRAM, TEAM, DEVICES)
    assert told(here("push", "mission.dL", "--json"))["outcome"] == "activated"
    started = here("start", "--json")
    assert (started.status, told(started)["started"]) == (1, False)
    assert "/dev/ttyNONE" in told(started)["waits"]["alpha"]
    # The reason is shown at any time, also while the next attempt starts.
    end = time.monotonic() + 3.0
    while time.monotonic() < end:
        assert "/dev/ttyNONE" in told(here("status", "--json"))["alpha"]["run"]["reason"]
    here("stop", status=0)
    assert "/dev/ttyNONE" not in told(here("status", "--json"))["alpha"]["run"]["reason"]
