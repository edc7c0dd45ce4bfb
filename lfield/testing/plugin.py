"""The pytest plugin for tests of missions: `pytest_plugins = ["lfield.testing.plugin"]`, or `lfield test`.

Nothing loads it by itself: a project that does not name it never sees it.
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
    from lfield.testing.mission.team import Team

#: Makes a team: the deployment's path, beside the test's file where it is not absolute; and Team's options.
OpenMission = Callable[..., "Team"]

#: Under this name a test's report says which pictures it has drawn, or could not draw: it may have run in
#: another process.
_DRAWN = "lfield tracks"
#: The longest name of a file, without what tells it from others of that name.
_LONGEST = 120


def pytest_addoption(parser: pytest.Parser) -> None:
    """Where pictures go."""
    parser.getgroup("lfield").addoption(
        "--tracks", metavar="DIR", type=Path, help="draw the tracks of each team there, as FILE.TEST.svg"
    )


@pytest.fixture
def lfield_mission(request: pytest.FixtureRequest) -> Iterator[OpenMission]:
    """Opens missions for a test: `team = lfield_mission("mission.dL", seed=1)`; options as `Team` has."""
    # Here, since a run that opens no mission need not wait for it.
    from lfield.testing.mission.team import Team

    teams: list[Team] = []

    def opened(path: str | Path, **options: Any) -> Team:
        __tracebackhide__ = True
        try:
            team = Team(request.path.parent / path, **options)
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


def _draw(request: pytest.FixtureRequest, team: Team, which: str) -> None:
    """The picture of a team, where somebody wants one and there is something to see."""
    folder: Path | None = request.config.getoption("--tracks")
    if folder is None or not team.has_moved:
        return
    from lfield.testing.mission.picture import draw

    file = folder / f"{_name(request)}{which}.svg"
    picture = draw(team.tracks, f"{team.mission.name}: {request.node.name}", team.marks)
    told = str(file)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file.write_text(picture)
    except OSError as error:
        told = f"{file} cannot be written: {error.strerror}"
    request.node.user_properties.append((_DRAWN, told))


def _name(request: pytest.FixtureRequest) -> str:
    """The name of a test's picture; of those that would have the same, each has a number."""
    name = _plain(request.node)
    same = [item.nodeid for item in request.session.items if _plain(item) == name]
    return name if len(same) == 1 else f"{name}~{same.index(request.node.nodeid) + 1}"


def _plain(item: pytest.Item) -> str:
    """File and test, in what may stand in the name of a file."""
    return re.sub(r"[^\w.-]+", "-", f"{item.path.stem}.{item.name}").strip("-")[:_LONGEST]


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Say which pictures there are."""
    reports = (report for found in terminalreporter.stats.values() for report in found)
    ended = (report for report in reports if getattr(report, "when", "") == "teardown")
    for file in sorted(value for report in ended for name, value in report.user_properties if name == _DRAWN):
        terminalreporter.write_line(f"tracks: {file}")
