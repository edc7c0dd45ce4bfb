"""The exact output of the programs of the thesis and of the examples, each host a process."""

from __future__ import annotations

import json
import re
import shutil
from collections import defaultdict
from pathlib import Path

import pytest

pytestmark = [pytest.mark.process, pytest.mark.long]

ROOT = Path(__file__).parents[3]
THESIS = ROOT.parent / "shared" / "thesis-programs"
EXAMPLES = ROOT / "examples"


def fly(lfield, deployment: Path, *options) -> dict[str, list[str]]:
    """Run a mission to its end; returns the lines of each host."""
    done = lfield("up", "--deploy", deployment, "--all", "--until-done", *options, status=0)
    by_host: dict[str, list[str]] = defaultdict(list)
    for line in done.out:
        host, bar, text = line.partition(" | ")
        assert bar, line
        by_host[host.rstrip()].append(text)
    return by_host


def _speaker(line: str) -> str:
    """The agent that wrote a line of a thesis program."""
    return "cache" if line.startswith("Cache: ") else line.split()[0]


def _caller(line: str) -> str | None:
    """The caller for whom a server wrote a line, or none."""
    match = re.match(r"\w+ for (\w+) :", line)
    return match[1] if match else None


def thesis_lines(lines: list[str]) -> dict[str, object]:
    """The lines by agent, and those of a server also by caller."""
    own: dict[str, list[str]] = defaultdict(list)
    served: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for line in lines:
        caller = _caller(line)
        if caller is None:
            own[_speaker(line)].append(line)
        else:
            served[_speaker(line)][caller].append(line)
    agents: dict[str, object] = {}
    for agent in {*own, *served}:
        if agent in own and agent in served:
            agents[agent] = {"requests": own[agent], "served": served[agent]}
        else:
            agents[agent] = own.get(agent) or served[agent]
    return agents


@pytest.mark.parametrize("name", ["cs", "mt", "peer"])
def test_programs_of_the_thesis_print_their_expected_output(lfield, name):
    if not THESIS.is_dir():
        pytest.skip(f"the programs of the thesis are not here ({THESIS})")
    by_host = fly(lfield, THESIS / f"{name}.dL")
    lines = [line for lines in by_host.values() for line in lines]
    assert thesis_lines(lines) == json.loads((THESIS / f"{name}.expected.json").read_text())
    assert len(by_host) == 3


@pytest.mark.few(0)
@pytest.mark.timeout(240)
def test_the_first_flight_example_runs(lfield):
    """The main use case: two copters on fakes, one coordinator that migrates between them."""
    flight = lfield.start(
        "up", "--deploy", EXAMPLES / "01-first-flight" / "mission.dL", "--all", "--sim", "--until-done"
    )
    for word in ("wing: at", "lead: landed", "wing: landed"):
        flight.wait_for(word)
    assert flight.wait() == 0, flight.said
    lines = [line.partition(" | ")[2] for line in flight.out]
    assert {line for line in lines if "taking off" in line} == {
        "lead: taking off to 2.0 m", "wing: taking off to 3.5 m",
    }  # fmt: skip
    places = re.findall(
        r"^(\w+): at north (-?[\d.]+) m, east (-?[\d.]+) m, height ([\d.]+) m$", "\n".join(lines), re.M
    )
    leads, wings = ([place for place in places if place[0] == name] for name in ("lead", "wing"))
    assert len(leads) == 3
    for lead, wing in zip(leads, wings, strict=True):
        assert abs(float(lead[1]) + float(wing[1])) < 1.5, "the paths are mirrored"
        assert abs(float(lead[2]) + float(wing[2])) < 1.5
        assert abs(float(wing[3]) - float(lead[3]) - 1.5) < 1.0
    assert set(lines[-2:]) == {"lead: landed", "wing: landed"}
    assert re.search(
        r"pilot: smallest measured distance [\d.]+ m; batteries lead \d+ %, wing \d+ %", flight.said
    )
    hops = re.search(r"pilot: the coordinator migrated (\d+) times", flight.said)
    # Takeoff, 3 legs, landing: a hop to start each and a hop to fetch; the summary ends on the other host.
    assert hops
    assert int(hops[1]) == 11
    assert lfield.left() == []


@pytest.mark.few(0)
@pytest.mark.timeout(240)
def test_the_mixed_team_example_runs(lfield):
    """Three drivers on three hosts: a copter, a gripper and a winch transfer a parcel."""
    team = lfield.start(
        "up", "--deploy", EXAMPLES / "03-mixed-team" / "mission.dL", "--all", "--sim", "--until-done"
    )
    team.wait_for("handed over in")
    assert team.wait() == 0, team.said
    steps = re.findall(r"^(\w+) +\| courier: (.*)$", team.said, re.M)
    assert [(host, text.split(",")[0].split(" at ")[0]) for host, text in steps[:4]] == [
        ("sky", "the copter has the parcel"),
        ("sky", "the hook is"),
        ("sky", "the hand has the parcel; the copter may land"),
        ("sky", "the hook is back"),
    ]
    assert "at 1.20 m" in steps[1][1]
    assert "closed on nothing" not in team.said
    for device, state in (("carrier.fc", "land"), ("hoist.axis", "brake"), ("hand.motor", "torque_hold")):
        assert f"{device} in safe state '{state}': the host is stopping" in team.said
    assert lfield.left() == []


@pytest.mark.few(0)
@pytest.mark.timeout(360)
def test_the_two_carry_one_example_runs(lfield):
    """Two of four copters carry a beam, by a rule of the mission, and the others carry crates.

    The distances are shorter than in the example, because the flights run in real time.
    """
    shutil.copytree(EXAMPLES / "05-two-carry-one", lfield.folder / "example")
    deployment = lfield.folder / "example" / "mission.dL"
    text = deployment.read_text()
    for far, near in (("4&4&0&16&0", "4&4&0&8&0"), ("-3&12&8&12", "-3&12&1&12")):
        assert far in text
        text = text.replace(far, near)
    deployment.write_text(text)
    team = lfield.start("up", "--deploy", deployment, "--all", "--sim", "--until-done")
    team.wait_for("take the beam")
    team.wait_for("bring a crate each")
    team.wait_for("the beam lies at")
    team.wait_for("the crates are there")
    assert team.wait() == 0, team.said
    pair = re.findall(r"beam: (\w+)\+(\w+) take the beam", team.said)
    crates = re.findall(r"crates: (\w+) and (\w+) bring a crate each", team.said)
    assert len(pair) == len(crates) == 1
    assert {*pair[0], *crates[0]} == {"ada", "bob", "cat", "dan"}, team.said
    assert "beam: the beam lies at (8.0, 0.0)" in team.said
    assert lfield.left() == []
