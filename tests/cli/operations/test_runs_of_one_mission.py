"""Commands find the runs on a computer: two teams of a mission, a single host, remains of killed runs."""

from __future__ import annotations

import json
import re
import signal
from pathlib import Path

import pytest

from lfield.authority.identity import Right

pytestmark = pytest.mark.process

PROGRAM = """
resource Post { init(string[] arg) { write("posted\\n"); while (true) yield(); } portal hold() { } }
coordinator Guest { init(string[] arg) { sleep(1000.0); } }
"""
DEPLOYMENT = "//Post:near@alpha\n//Guest:tom@alpha\n//Post:far@bravo\n"


@pytest.fixture
def mission(lfield):
    return lfield.mission(PROGRAM, DEPLOYMENT)


def up_all(lfield, own, mission):
    """A team whose posts have started."""
    run = lfield.start("up", "--deploy", mission, "--all", env=own)
    for host in ("alpha", "bravo"):
        run.wait_for(rf"{host} +\| posted")
    return run


def runs_left(own) -> list[Path]:
    return list(Path(own["XDG_RUNTIME_DIR"]).glob("lfield/*-*"))


@pytest.mark.few(0)
def test_a_team_is_found_after_another_of_its_mission_has_ended(lfield, own, mission):
    first, second = up_all(lfield, own, mission), up_all(lfield, own, mission)
    assert len(runs_left(own)) == 2
    second.signal(signal.SIGTERM)
    second.wait()
    (left,) = runs_left(own)
    assert sorted(path.name for path in left.iterdir()) == ["alpha.sock", "bravo.sock", "note.json"]
    lfield("ps", "--deploy", mission, env=own, status=0)
    stopped = lfield("estop", "--deploy", mission, env=own, status=0)
    assert stopped.out == ["alpha: has no devices that move", "bravo: has no devices that move"]
    for host in ("alpha", "bravo"):
        first.wait_for(rf"{host} +\| EMERGENCY STOP")
    first.signal(signal.SIGINT)
    first.wait()
    assert runs_left(own) == []


@pytest.mark.few(0)
def test_all_runs_are_listed_and_stopped_without_arguments(lfield, own, mission):
    """Two teams run, and a single host of a team whose other host does not run."""
    teams = [up_all(lfield, own, mission) for _ in range(2)]
    other = lfield.mission(PROGRAM, DEPLOYMENT.replace("tom", "tim"), name="other")
    alone = lfield.start(
        "up", "--deploy", other, "--host", "alpha", *lfield.maps(["alpha", "bravo"]), env=own
    )
    alone.wait_for("posted")
    output = lfield("ps", "--json", env=own, status=69)
    found = json.loads("\n".join(output.out))
    hosts = [[run["hosts"] for run in team["runs"]] for team in found.values()]
    assert hosts == [[["alpha", "bravo"]], [["alpha", "bravo"]], [["alpha"]]]
    first, second, third = found
    assert found[third]["hosts"]["alpha"]["host"] == "alpha"
    assert set(found[third]["hosts"]["bravo"]) == {"error", "code"}
    listed = lfield("ps", env={**own, "COLUMNS": "200"})
    rows = [line.split() for line in listed.out]
    assert rows[0] == ["RUN", "HOSTS", "USER", "UP", "SINCE", "MISSION"]
    assert [row[0] for row in rows[1:4]] == [first, second, third]
    assert rows[1][-1] == str(mission)
    assert [first] in rows
    result = lfield("query", "Lift", env=own, status=64)
    assert "several missions run here, name one" in result.err[0]
    stopped = lfield("estop", env=own, status=3)
    assert stopped.out[:3] == [
        f"stopping {first}: alpha, bravo",
        f"stopping {second}: alpha, bravo",
        f"stopping {third}: alpha, bravo",
    ]
    assert f"{second}/bravo: has no devices that move" in stopped.out
    assert stopped.err[0].startswith(f"{third}/bravo: NOT REACHED, its devices have not confirmed: ")
    for run in (*teams, alone):
        run.wait_for("EMERGENCY STOP")
    picked = lfield("estop", "--lift", "--run", first, env=own, status=0)
    assert picked.out == [
        f"lifting {first}: alpha, bravo",
        "alpha: has no devices that move",
        "bravo: has no devices that move",
    ]


def test_a_killed_run_is_removed_when_its_last_host_has_ended(lfield, own, mission, here):
    run = up_all(lfield, own, mission)
    run.signal(signal.SIGKILL)
    run.popen.wait()
    assert lfield.all_ended()
    assert len(runs_left(own)) == 1
    output = here("ps", env=own)
    assert (output.status, output.out) == (69, [])
    (line,) = output.err
    assert line.startswith("lfield: no mission is running on this computer: searched ")
    assert str(Path(own["XDG_RUNTIME_DIR"]) / "lfield") in line
    assert runs_left(own) == []


def test_the_only_running_mission_is_queried_without_its_name(lfield, own, mission, here):
    lfield.write("mission.capabilities.yaml", "registry: 1\nproviders: {Post: {serves: {Hold: {}}}}\n")
    up_all(lfield, own, mission)
    result = here("query", "Hold", env=own)
    assert result.out[0] == "from the running team: 2 of 2 hosts answered", result.said


@pytest.mark.few(0)
def test_a_run_that_no_command_could_find_does_not_start(lfield, own, mission):
    """No command could stop the vehicles of such a run; this also applies to a host with keys."""
    place = Path(own["XDG_RUNTIME_DIR"]) / "lfield"
    place.write_text("in the way\n")
    alone = lfield.mission(PROGRAM, "//Post:near@alpha\n", name="alone")
    lfield.keys.put("me", lfield.keys.issue("person", "anna", Right.COMMAND))
    with_keys = ("--host", "alpha", "--first-start", "--volatile", *lfield.maps(["alpha", "bravo"]))
    for arguments in ((mission, "--all"), (alone, "--host", "alpha"), (mission, *with_keys)):
        refused = lfield("up", "--deploy", *arguments, env=own, status=73)
        assert refused.err == [
            f"lfield: cannot write {place}: it is not a folder; no command could find what runs, to stop it: "
            "set XDG_RUNTIME_DIR to another folder of your own, or remove what is in the way"
        ]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("ps", "--map", "alpha=127.0.0.1:1"), "--map is for the hosts of a mission: name the mission too"),
        (
            ("estop", "--run", "x"),
            "no run x: no mission is running on this computer: searched ...",
        ),
        (("estop",), "no mission is running on this computer: searched ..."),
        (("query", "Lift"), "no mission is running on this computer: searched ..."),
    ],
)
def test_ambiguous_or_missing_runs_are_refused(here, own, monkeypatch, words, sentence):
    for name, value in own.items():
        monkeypatch.setenv(name, value)
    result = here(*words)
    assert result.status in (64, 69)
    assert [re.sub("searched .*", "searched ...", line) for line in result.err] == [f"lfield: {sentence}"]
