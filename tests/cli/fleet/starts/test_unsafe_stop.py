"""A stop of a robot whose host is killed: its vehicles may not be at rest, which is reported."""

from __future__ import annotations

import os
import signal

import pytest
from robots import told

from lfield import exit_status

pytestmark = pytest.mark.process


@pytest.mark.few(0)
def test_a_host_killed_during_a_stop_is_reported_and_nothing_is_discarded(lfield, here, robots) -> None:
    team = robots("alpha", "bravo")
    team.up()
    team.mission(rounds=1000, pause=0.2)
    here("push", "mission.dL", status=0)
    here("start", status=0)
    pid = team.state("bravo")["run"]["pid"]
    # The host cannot answer the order.
    os.kill(pid, signal.SIGSTOP)
    stopping = lfield.start("stop", "--discard", "--json")
    team.services["bravo"].wait_for("^stop requested")
    os.kill(pid, signal.SIGKILL)
    assert stopping.wait() == exit_status.UNSAFE
    found = told(stopping)
    assert ("killed by signal 9" in found["bravo"]["trouble"], found["bravo"]["checked"]) == (True, "")
    assert (found["alpha"]["trouble"], found["alpha"]["discarded"]) == ("", [])
    assert told(here("status", "bravo", "--json"))["bravo"]["refusal"]
    # The operator repeats the command, which prints the acknowledgement.
    again = here("stop", "--discard", "--json", status=0)
    found = told(again)
    assert (found["bravo"]["trouble"], found["bravo"]["checked"]) == ("", "killed by signal 9")
    assert found["alpha"]["discarded"] == ["tom"]
