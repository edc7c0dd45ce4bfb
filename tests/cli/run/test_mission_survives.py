"""The example whose hosts are killed: it is run once, as its README says."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

RUN = Path(__file__).parents[3] / "examples" / "04-the-mission-survives" / "run.py"

pytestmark = [pytest.mark.process, pytest.mark.long, pytest.mark.timeout(400)]


#: Seconds of a shadow's interval and, behind it, of leases that run out; and what a busy computer may add.
INTERVAL, LEASES, BUSY = 3.0, 3.0, 2.0


def test_missions_complete_whose_hosts_are_killed(lfield, alone):
    environment = {**lfield.environment, **alone}
    done = subprocess.run([sys.executable, str(RUN)], env=environment, capture_output=True, text=True)
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    assert "Traceback" not in said
    assert lfield.left() == []
    again, for_good = re.split("^quorum: a host that never .*$", done.stdout, flags=re.M)
    assert re.findall(r"^killed +(\w+)", again, re.M) == ["sky", "ground"]
    told = re.findall(r"^told +(.*)", again, re.M)
    for host, resource, portal in (("sky", "scout", "flyTo"), ("ground", "truck", "reach")):
        assert f"{host} was started again; this call may have begun ({resource}.{portal})" in told
        assert any(line.startswith(f"{resource} was started again since") for line in told)
    # The truck's field was lost with its computer: it counts from one again, and each call once.
    assert re.findall(r"the truck has served (\d)", again) == ["1", "2"]
    assert len(re.findall("survivor: complete", again)) == 1
    assert_it_went_on_without(for_good, again)


def assert_it_went_on_without(summary: str, said: str) -> None:
    """One host never came back: what it had done is lost and told, and the rest is done elsewhere."""
    (gone,) = re.findall(r"^killed +(\w+) after .* for good", summary, re.M)
    ((heir, seconds),) = re.findall(r"^back +on (\w+), ([\d.]+) s after the kill", summary, re.M)
    assert heir != gone
    assert INTERVAL < float(seconds) <= INTERVAL + LEASES + BUSY
    (lost,) = re.findall(r"^lost +(.*)", summary, re.M)
    assert re.findall(r"part (\d+) is in the box", lost) == ["7", "8"]
    told = re.findall(r"^told +(.*)", summary, re.M)
    assert told[0].startswith(f"clearer was recovered on {heir} from where it left for {gone}")
    assert any(f"{gone} could not be reached" in line for line in told)
    parts = re.findall(rf"^quorum {gone} +\| clearer: part (\d+)", said, re.M)
    assert parts == ["1", "2", "3", "7", "8"]
    parts = re.findall(rf"^quorum {heir} +\| clearer: part (\d+)", said, re.M)
    assert parts == ["4", "5", "6", "7", "8", "9", "10", "11", "12"]
    assert len(re.findall("clearer: complete", said)) == 1
