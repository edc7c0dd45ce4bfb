"""The pytest plugin in other projects, only by opt-in, and `lfield test`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from lfield import exit_status

pytestmark = pytest.mark.process

MISSION = """
coordinator Boss {
    init(string[] arg) { print("over"); }
}
"""
TEST = """
def test_it_ends(lfield_mission):
    team = lfield_mission("walk.dL")
    team.run(until_done=True)
    assert team.ended == {"boss": "done"}

def test_it_does_not(lfield_mission):
    team = lfield_mission("walk.dL")
    team.run(until="never")
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A mission with a test that passes and one that fails."""
    (tmp_path / "walk.L").write_text(MISSION)
    (tmp_path / "walk.dL").write_text("//Boss:boss@alpha\n")
    (tmp_path / "test_walk.py").write_text(TEST)
    return tmp_path


def run(folder: Path, *arguments: str, pytest_variables: bool = False) -> tuple[int, str]:
    """A command of Python in a project; its status and output."""
    kept_names = ("PYTEST_ADDOPTS",) if pytest_variables else ()
    environment = {
        name: value
        for name, value in os.environ.items()
        if name in kept_names or not name.startswith("PYTEST")
    }
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=240.0,
    )
    return done.returncode, done.stdout + done.stderr


def test_a_run_without_the_plugin_has_no_fixture_and_imports_no_lfield(project):
    (project / "test_a.py").write_text("import sys\ndef test_a():\n    assert 'lfield' not in sys.modules\n")
    _, output = run(project, "-m", "pytest", "-q")
    assert "1 passed" in output
    assert "fixture 'lfield_mission' not found" in output


@pytest.mark.few(0)
def test_a_conftest_with_the_plugin_has_the_fixture(project):
    (project / "conftest.py").write_text('pytest_plugins = ["lfield.testing.plugin"]\n')
    status, output = run(project, "-m", "pytest", "-q", "-k", "it_ends")
    assert status == 0, output
    assert "1 passed" in output


@pytest.mark.few(0)
def test_lfield_test_reports_the_result_by_its_status(project):
    status, output = run(project, "-m", "lfield", "test", "test_walk.py", "-k", "it_ends")
    assert (status, "1 passed" in output) == (exit_status.DONE, True), output
    status, output = run(project, "-m", "lfield", "test")
    assert (status, "1 failed, 1 passed" in output) == (exit_status.FAILED, True), output
    assert "no log line contains 'never' after 120 s of the mission, which has ended" in output
    status, output = run(project, "-m", "lfield", "test", "-k", "nothing")
    assert status == exit_status.NO_INPUT, output
    assert not (project / "tracks").exists(), "nobody has moved"


@pytest.mark.few(0)
def test_arguments_of_lfield_test_may_be_in_any_order(project):
    (project / "test_other.py").write_text("def test_it_ends_too():\n    pass\n")
    words = ("-k", "it_ends", "test_walk.py", "-x", "test_other.py", "-q")
    status, output = run(project, "-m", "lfield", "test", *words)
    assert (status, "2 passed, 1 deselected" in output) == (exit_status.DONE, True), output
    assert "platform" not in output
    status, output = run(project, "-m", "lfield", "check", "walk.L", "--json", "walk.dL")
    assert status == exit_status.DONE, output
    status, output = run(project, "-m", "lfield", "test", "test_walk.py", "--xyzzy", "test_other.py")
    assert status == exit_status.USAGE
    assert output.startswith("lfield: unrecognized arguments: --xyzzy")


#: Configurations of a surrounding project for plugins that are not installed, or with errors.
FOREIGN = {
    "option": (
        "pytest.ini",
        "[pytest]\naddopts = --no-such-option=3 --strict-markers\nmarkers = ours: kept\n",
    ),
    "plugin": ("setup.cfg", "[tool:pytest]\naddopts = -p no_such_plugin\n"),
    "required": ("tox.ini", "[pytest]\nrequired_plugins = pytest-no-such-plugin>=3\n"),
    "version": ("pytest.ini", "[pytest]\nminversion = 99\n"),
    "setting": ("pytest.ini", "[pytest]\nno_such_setting = 3\nfilterwarnings = error\n"),
    "strict": ("pyproject.toml", '[tool.pytest.ini_options]\nno_such = 3\naddopts = "--strict-config"\n'),
    "section": ("setup.cfg", "[pytest]\naddopts = -q\n"),
    "damaged": ("pyproject.toml", "[tool.pytest.ini_options\n"),
}


@pytest.mark.few(0)
@pytest.mark.parametrize("name", FOREIGN)
def test_a_configuration_that_pytest_refuses_is_ignored(project, name):
    file, text = FOREIGN[name]
    (project / file).write_text(text)
    missions = project / "missions"
    missions.mkdir()
    for each in ("walk.L", "walk.dL", "test_walk.py"):
        (project / each).rename(missions / each)
    (missions / "conftest.py").write_text(
        "import pytest\n@pytest.fixture(autouse=True)\ndef mine():\n    yield 1\n"
    )
    status, output = run(project, "-m", "lfield", "test", "missions", "-k", "it_ends", "-v")
    assert (status, "1 passed" in output) == (exit_status.DONE, True), output
    assert ("configuration ignored" in output) == (name not in ("setting", "strict")), output
    assert "warning" not in output


@pytest.mark.few(0)
def test_the_rest_of_a_configuration_with_a_refused_option_is_kept(project):
    (project / "pytest.ini").write_text(
        FOREIGN["option"][1] + "filterwarnings = error\npythonpath = sources\n"
    )
    (project / "sources").mkdir()
    (project / "sources" / "of_mine.py").write_text("")
    (project / "test_walk.py").write_text(
        "import pytest, of_mine\n@pytest.mark.ours\ndef test_it_ends():\n    pass\n"
    )
    status, output = run(project, "-m", "lfield", "test")
    assert (status, "1 passed" in output) == (exit_status.DONE, True), output


@pytest.mark.few(0)
def test_options_of_the_environment_that_pytest_refuses_are_ignored(project, monkeypatch):
    monkeypatch.setenv("PYTEST_ADDOPTS", "--no-such-option")
    status, output = run(project, "-m", "lfield", "test", "-k", "it_ends", pytest_variables=True)
    assert (status, "1 passed" in output) == (exit_status.DONE, True), output


@pytest.mark.few(0)
def test_a_conftest_that_fails_is_reported_as_such(project):
    (project / "conftest.py").write_text("import no_such_module\n")
    (project / "pytest.ini").write_text(FOREIGN["option"][1])
    status, output = run(project, "-m", "lfield", "test")
    assert status == exit_status.USAGE
    assert "No module named 'no_such_module'" in output
    assert "ignored" not in output


MOVES = """
import pytest
from pathlib import Path

FLIGHT = Path({flight!r})

@pytest.mark.parametrize("way", ["a/b", "a-b", "long"], ids=["a/b", "a-b", "x" * 300])
def test_it_moves(lfield_mission, way):
    team = lfield_mission(FLIGHT)
    team.run(12.0)
    assert team.has_moved

def test_two_teams(lfield_mission):
    for seed in (1, 2):
        lfield_mission(FLIGHT, seed=seed).run(12.0)
"""


@pytest.mark.few(0)
def test_each_team_of_each_test_has_its_own_picture(tmp_path):
    test = MOVES.format(flight=str(Path(__file__).parents[2] / "examples/01-first-flight/mission.dL"))
    for folder in ("near", "far"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "test_walk.py").write_text(test)
    arguments = ("test", ".", "-q", "-k", "moves or far", "--tracks", "seen")
    (tmp_path / "pytest.ini").write_text("[pytest]\naddopts = --import-mode=importlib\n")
    status, output = run(tmp_path, "-m", "lfield", *arguments)
    assert (status, "7 passed, 1 deselected" in output) == (exit_status.DONE, True), output
    pictures = sorted(file.name for file in (tmp_path / "seen").iterdir())
    long = f"test_walk.test_it_moves-{'x' * 300}"[:120]
    assert pictures == sorted(
        [
            *(f"test_walk.test_it_moves-a-b~{number}.svg" for number in (1, 2, 3, 4)),
            *(f"{long}~{number}.svg" for number in (1, 2)),
            *(f"test_walk.test_two_teams~{number}.svg" for number in (1, 2)),
        ]
    )
    assert output.count("tracks: ") == len(pictures)


@pytest.mark.few(0)
def test_a_picture_that_cannot_be_written_fails_no_test(tmp_path):
    test = MOVES.format(flight=str(Path(__file__).parents[2] / "examples/01-first-flight/mission.dL"))
    (tmp_path / "test_walk.py").write_text(test)
    (tmp_path / "taken").write_text("")
    status, output = run(tmp_path, "-m", "lfield", "test", "-k", "two_teams", "--tracks", "taken")
    assert (status, "error" in output) == (exit_status.DONE, False), output
    assert f"tracks: {tmp_path}/taken/test_walk.test_two_teams~1.svg cannot be written: File exists" in output


FLOWN = """
import hashlib, sys
from pathlib import Path
from lfield.testing.mission.mission_team import MissionTeam
team = MissionTeam(Path(sys.argv[1]), seed=5)
team.run(until_done=True)
print(hashlib.sha256(repr((team.log, team.tracks, team.hops)).encode()).hexdigest())
"""


@pytest.mark.few(0)
def test_the_same_seed_is_the_same_flight_in_every_process(tmp_path, monkeypatch):
    flight = str(Path(__file__).parents[2] / "examples/01-first-flight/mission.dL")
    observed = set()
    for number in ("1", "2"):
        monkeypatch.setenv("PYTHONHASHSEED", number)
        status, output = run(tmp_path, "-c", FLOWN, flight)
        assert status == 0, output
        observed.add(output)
    assert len(observed) == 1


def test_without_pytest_the_error_names_the_package(project):
    (project / "pytest.py").write_text("raise ImportError\n")
    status, output = run(project, "-m", "lfield", "test")
    assert (status, output) == (
        exit_status.UNAVAILABLE,
        "lfield: 'lfield test' needs pytest: pip install 'lfield[desk]'\n",
    )


def test_a_picture_shows_every_device_and_its_faults():
    from lfield.testing.mission.recorders import Point
    from lfield.testing.mission.track_picture import Mark, draw

    tracks = {
        "a.fc": [Point(0.0, 0.0, 0.0, 0.0), Point(1.0, 5.0, 1.0, 2.0)],
        "b & c": [Point(0.0, 1.0, 1.0, 0.0)],
        "nowhere": [],
    }
    svg = draw(
        tracks, "a <title>", [Mark(0.9, "a.fc", "a.fc: motor_failure=true"), Mark(0.5, "", "alpha is cut")]
    )
    root = ElementTree.fromstring(svg)
    texts = [text.text for text in root.iter("{http://www.w3.org/2000/svg}text")]
    assert {"a <title>", "a.fc", "b & c", "0.9 s: a.fc: motor_failure=true", "0.5 s: alpha is cut"} <= set(
        texts
    )
    assert "height over 1 s, up to 2.0 m" in texts
    with pytest.raises(ValueError, match="no device has a known position"):
        draw({"nowhere": []}, "empty")


def test_names_of_devices_at_one_place_do_not_overlap():
    from lfield.testing.mission.recorders import Point
    from lfield.testing.mission.track_picture import LINE, draw

    names = ["a.fc", "b.fc", "c.fc", "far.fc"]
    tracks = {
        name: [Point(0.0, 9.0, 9.0, 0.0), Point(1.0, 0.1 * n, 0.0, 0.0)] for n, name in enumerate(names)
    }
    tracks["far.fc"] = [Point(0.0, 0.0, 0.0, 0.0), Point(1.0, 0.0, 5.0, 0.0)]
    root = ElementTree.fromstring(draw(tracks, "a landing"))
    found = root.iter("{http://www.w3.org/2000/svg}text")
    places = {text.text: (float(text.get("x")), float(text.get("y"))) for text in found}
    heights = sorted(places[name][1] for name in names[:3])
    assert heights[1] - heights[0] >= LINE
    assert heights[2] - heights[1] >= LINE
    # Without neighbours, a name is next to its disc.
    assert places["far.fc"][1] == places["a.fc"][1]
