"""The programs of the documentation of `lfield.client`, as processes with real hosts."""

from __future__ import annotations

import csv
import subprocess
import sys

import pytest
from client_pages import program_of_page

pytestmark = pytest.mark.process

PROGRAM = """
resource Crane {
    init(string[] arg) { }
    portal hoist(real height) emit real { return height; }
    portal sink(real height) emit real { return height; }
}
coordinator Boss {
    init(string[] arg) {
        Lift[] all = findLift();
        Crane[] cranes = findCrane();
        for (int n = 0; n < 4; n = n + 1) cranes[n % 2].hoist(1.0);
        sleep(PAUSE);
    }
}
"""
DEPLOYMENT = "//Crane:near@alpha\n//Crane:far@bravo\n//Boss:boss@alpha\n"
CAPABILITIES = """
registry: 1
providers:
  Crane:
    attributes: {payload: 50.0}
    serves: {Lift: {portals: {lift: hoist, lower: sink}}}
"""


def run_program(
    lfield, name: str, *arguments: object, env: dict[str, str]
) -> subprocess.CompletedProcess[str]:
    file = lfield.write(name, program_of_page(name))
    return subprocess.run(
        [sys.executable, file, *map(str, arguments)],
        cwd=lfield.folder,
        env={**lfield.environment, **env},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.few(0)
def test_the_query_program_prints_offers_and_reasons(lfield, alone) -> None:
    lfield.write("mission.capabilities.yaml", CAPABILITIES)
    mission = lfield.mission(PROGRAM.replace("PAUSE", "600.0"), DEPLOYMENT)
    team = lfield.start("up", "--all", "--sim", mission, env=alone)
    team.wait_for("link to .* established")
    ended = run_program(lfield, "offers.py", mission, "Lift where payload >= 20.0", env=alone)
    assert ended.returncode == 0, ended.stderr
    assert {tuple(line.split()[:2]) for line in ended.stdout.splitlines()} == {
        ("near", "alpha"),
        ("far", "bravo"),
    }
    ended = run_program(lfield, "offers.py", mission, "Lift where payload >= 99.0", env=alone)
    assert ended.returncode == 0, ended.stderr
    assert [line.partition(":")[0] for line in ended.stdout.splitlines()] == ["near", "far"]


@pytest.mark.few(0)
def test_the_event_program_writes_events_until_the_mission_ends(lfield, alone) -> None:
    lfield.write("mission.capabilities.yaml", CAPABILITIES)
    mission = lfield.mission(PROGRAM.replace("PAUSE", "5.0"), DEPLOYMENT)
    team = lfield.start("up", "--all", "--sim", mission, env=alone)
    team.wait_for("listening")
    ended = run_program(lfield, "hops.py", mission, "hops.csv", env=alone)
    assert ended.returncode == 0, ended.stderr
    with (lfield.folder / "hops.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["agent"], row["to"]) for row in rows] == [
        ("boss", "bravo"),
        ("boss", "alpha"),
        ("boss", "bravo"),
    ]
    assert all(float(row["seconds"]) > 0 for row in rows)
