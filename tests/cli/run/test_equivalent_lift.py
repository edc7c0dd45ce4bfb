"""The example of capabilities with the commands of its README: `make test-more`."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

DEMO = Path(__file__).parents[3] / "examples" / "02-equivalent-lift" / "demo.py"

pytestmark = [pytest.mark.process, pytest.mark.long, pytest.mark.timeout(600)]


def lifts_of(run: str) -> list[tuple[str, str]]:
    """The foreman's host when the parcel was lifted, and by how many metres."""
    return re.findall(r"^(\w+) +\| foreman: the parcel went up by (.*) m$", run, re.M)


def shown(lfield, alone, *arguments: str) -> str:
    """The output of Python, in the folder of the example."""
    environment = {**lfield.environment, **alone}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, env=environment, cwd=DEMO.parent, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    assert lfield.left() == []
    return done.stdout


@pytest.mark.few(0)
def test_the_best_then_the_equivalent_then_the_composed_then_no_lift(lfield, alone):
    output = shown(lfield, alone, str(DEMO))
    runs = re.split(r"^Run \d: .*$", output, flags=re.M)[1:]
    lifts = [lifts_of(run) for run in runs]
    assert [[host for host, _ in lift] for lift in lifts] == [["yard"], ["air"], ["bench"], []], output
    # Crane and arm are exact, a copter is not.
    assert [height for lift in lifts for host, height in lift if host != "air"] == ["0.8", "0.8"]
    assert "(direct, " in runs[0]
    assert "equivalent: climb-lifts of Climb" in runs[1]
    assert "composed: grip-and-climb of Grip (hand), Climb (arm)" in runs[2]
    explanation = runs[3].partition("no agent can lift the parcel\n")[2]
    assert re.search(r"crane: axis: no message for \d", explanation), runs[3]
    assert re.search(r"sky: battery 0\.1\d* \(measured \d+\.\d s ago\) < 0\.3", explanation), runs[3]
