"""A host with a journal that is killed in a call and restarted; the example with killed hosts."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

RUN = Path(__file__).parents[3] / "examples" / "04-the-mission-survives" / "run.py"

pytestmark = [pytest.mark.process, pytest.mark.timeout(400)]

#: A call that lasts until its host is killed, on a computer of any speed.
PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal stay(real seconds) { print("call begun"); sleep(seconds); }
}
coordinator Tour {
    init(string[] arg) {
        findPost(arg[1]).stay(0.0);
        try {
            findPost(arg[2]).stay(1000.0);
        } catch (RestartException restart) {
            print("restart: " + restart.message());
        }
        findPost(arg[1]).stay(0.0);
        print("complete after " + i2s(hops()) + " hops");
    }
}
"""
DEPLOYMENT = "//Post:near@alpha\n//Post:far@bravo\n//Tour:tom@alpha?near&far\n"


def test_a_coordinator_resumes_from_the_journal_of_its_killed_host(lfield):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    up = ("up", "--deploy", deployment, *lfield.maps(["alpha", "bravo"]), "--until-done", "--state", "state")
    hosts = {name: lfield.start(*up, "--first-start", "--host", name) for name in ("alpha", "bravo")}
    hosts["bravo"].wait_for("far: call begun")
    hosts["bravo"].signal(signal.SIGKILL)
    hosts["bravo"].popen.wait()
    again = lfield.start(*up, "--host", "bravo")
    assert (again.wait(), hosts["alpha"].wait()) == (0, 0)
    assert "tom resumed from the journal" in again.said
    assert "tom: restart: bravo restarted; this call may have begun (far.stay)" in again.said
    assert "far: call begun" not in again.said
    assert "tom: complete after 2 hops" in hosts["alpha"].said


#: Seconds without a heartbeat after which another host continues the coordinator.
INTERVAL = 3.0


@pytest.mark.few(0)
def test_missions_with_killed_hosts_complete(lfield, alone):
    environment = {**lfield.environment, **alone}
    done = subprocess.run([sys.executable, str(RUN)], env=environment, capture_output=True, text=True)
    output = done.stdout + done.stderr
    assert done.returncode == 0, output
    assert "Traceback" not in output
    assert lfield.left() == []
    again, for_good = re.split("^quorum: a host that never .*$", done.stdout, flags=re.M)
    assert re.findall(r"^killed +(\w+)", again, re.M) == ["sky", "ground"]
    lines = re.findall(r"^told +(.*)", again, re.M)
    # The portal of the call depends on the time of the kill and on the speed of the computer.
    for host, resource in (("sky", "scout"), ("ground", "truck")):
        assert any(f"{host} restarted; this call may have begun ({resource}." in line for line in lines)
        assert any(line.startswith(f"{resource} has restarted since") for line in lines)
    # The truck's field was lost with its computer: it counts from one again, and counts each call once.
    assert re.findall(r"the truck has served (\d)", again) == ["1", "2"]
    assert len(re.findall("survivor: complete", again)) == 1
    assert_completed_without(for_good, again)


def assert_completed_without(summary: str, said: str) -> None:
    """Assert that the work of the killed host is reported lost, and other hosts complete the rest."""
    (killed,) = re.findall(r"^killed +(\w+) after .* permanently", summary, re.M)
    ((heir, seconds),) = re.findall(r"^back +on (\w+), ([\d.]+) s after the kill", summary, re.M)
    assert heir != killed
    assert float(seconds) > INTERVAL
    (lost,) = re.findall(r"^lost +(.*)", summary, re.M)
    assert re.findall(r"part (\d+) is in the box", lost) == ["7", "8"]
    lines = re.findall(r"^told +(.*)", summary, re.M)
    assert lines[0].startswith(f"clearer was recovered on {heir} from its departure for {killed}")
    assert any(f"{killed} could not be reached" in line for line in lines)
    parts = re.findall(rf"^quorum {killed} +\| clearer: part (\d+)", said, re.M)
    assert parts == ["1", "2", "3", "7", "8"]
    parts = re.findall(rf"^quorum {heir} +\| clearer: part (\d+)", said, re.M)
    assert parts == ["4", "5", "6", "7", "8", "9", "10", "11", "12"]
    assert len(re.findall("clearer: complete", said)) == 1
