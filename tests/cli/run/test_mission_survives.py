"""The example whose hosts are killed: it is run once, as its README says."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

RUN = Path(__file__).parents[3] / "examples" / "04-the-mission-survives" / "run.py"

pytestmark = [pytest.mark.process, pytest.mark.long, pytest.mark.timeout(400)]


def test_a_mission_completes_whose_hosts_are_killed(lfield, alone):
    environment = {**lfield.environment, **alone}
    done = subprocess.run([sys.executable, str(RUN)], env=environment, capture_output=True, text=True)
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    assert "Traceback" not in said
    assert lfield.left() == []
    assert re.findall(r"^killed +(\w+)", done.stdout, re.M) == ["sky", "ground"]
    told = re.findall(r"^told +(.*)", done.stdout, re.M)
    for host, resource in (("sky", "scout"), ("ground", "truck")):
        assert f"{host} was started again; this call may have begun" in told
        assert any(line.startswith(f"{resource} was started again since") for line in told)
    # The truck's field was lost with its computer: it counts from one again, and each call once.
    assert re.findall(r"the truck has served (\d)", done.stdout) == ["1", "2"]
    assert len(re.findall("survivor: complete", done.stdout)) == 1
