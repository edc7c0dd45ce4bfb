"""The pytest plugin for tests of missions: `pytest_plugins = ["lfield.testing.plugin"]`, or `lfield test`.

The plugin is not loaded automatically.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from lfield.errors import LfieldError, ProgramError

if TYPE_CHECKING:
    from lfield.testing.mission.mission_team import MissionTeam

#: Opens a team: the deployment's path, relative to the test's file; and MissionTeam's options.
OpenMission = Callable[..., "MissionTeam"]

#: Name of the list of drawn pictures in a test's report, which may come from another process.
_DRAWN = "lfield tracks"
#: Maximum length of a file name, without the suffix that makes it unique.
_LONGEST = 120


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds the option for pictures."""
    parser.getgroup("lfield").addoption(
        "--tracks", metavar="DIR", type=Path, help="draw the tracks of each team there, as FILE.TEST.svg"
    )


@pytest.fixture
def lfield_mission(request: pytest.FixtureRequest) -> Iterator[OpenMission]:
    """Opens missions for a test: `team = lfield_mission("mission.dL", seed=1)`; options as of
    `MissionTeam`.
    """
    # Imported here: a run that opens no mission need not wait for it.
    from lfield.testing.mission.mission_team import MissionTeam

    teams: list[MissionTeam] = []

    def opened(path: str | Path, **options: Any) -> MissionTeam:
        __tracebackhide__ = True
        if not isinstance(path, str | Path):
            pytest.fail(f"lfield_mission({path!r}): give the path of a deployment", pytrace=False)
        try:
            team = MissionTeam(request.path.parent / path, **options)
        except ProgramError as error:
            pytest.fail("\n".join(finding.render() for finding in error.diagnostics), pytrace=False)
        except LfieldError as error:
            pytest.fail(f"{path}: {error}", pytrace=False)
        teams.append(team)
        return team

    yield opened
    with ExitStack() as closing:
        for team in teams:
            closing.callback(team.close)
        for number, team in enumerate(teams, 1):
            _draw(request, team, "" if len(teams) == 1 else f"~{number}")


def _draw(request: pytest.FixtureRequest, team: MissionTeam, which: str) -> None:
    """Draws the picture of a team, if requested and not empty."""
    folder: Path | None = request.config.getoption("--tracks")
    if folder is None or not team.has_moved:
        return
    from lfield.testing.mission.track_picture import draw

    file = folder / f"{_name(request)}{which}.svg"
    svg = draw(team.tracks, f"{team.mission.name}: {request.node.name}", team.marks)
    message = str(file)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file.write_text(svg)
    except OSError as error:
        message = f"{file} cannot be written: {error.strerror}"
    request.node.user_properties.append((_DRAWN, message))


def _name(request: pytest.FixtureRequest) -> str:
    """The file name of a test's picture; equal names are numbered."""
    name = _plain(request.node)
    same_named = [item.nodeid for item in request.session.items if _plain(item) == name]
    return name if len(same_named) == 1 else f"{name}~{same_named.index(request.node.nodeid) + 1}"


def _plain(item: pytest.Item) -> str:
    """File and test, with characters that are valid in a file name."""
    return re.sub(r"[^\w.-]+", "-", f"{item.path.stem}.{item.name}").strip("-")[:_LONGEST]


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Lists the pictures."""
    reports = (report for found in terminalreporter.stats.values() for report in found)
    ended = (report for report in reports if getattr(report, "when", "") == "teardown")
    for file in sorted(value for report in ended for name, value in report.user_properties if name == _DRAWN):
        terminalreporter.write_line(f"tracks: {file}")
