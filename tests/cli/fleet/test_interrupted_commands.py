"""Ctrl-C during a fleet command: robots that have received it continue, and the message reports that."""

from __future__ import annotations

import pytest

from lfield import exit_status
from lfield.cli.fleet import push, rollback
from lfield.client import mission_start, mission_stop

pytestmark = pytest.mark.process


async def interrupt_soon(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("words", "owner", "name"),
    [
        (("push", "mission.dL"), push, "_push"),
        (("rollback",), rollback, "_rollback"),
        (("stop",), mission_stop, "stop_mission"),
    ],
)
def test_an_interrupted_command_names_what_robots_continue(
    here, robots, monkeypatch, words, owner, name
) -> None:
    robots("alpha", "bravo").mission()
    monkeypatch.setattr(owner, name, interrupt_soon)
    ended = here(*words, status=exit_status.INTERRUPTED)
    assert [("interrupted: " in line, "'lfield status'" in line) for line in ended.err] == [(True, True)]


@pytest.mark.few(0)
def test_an_interrupted_start_continues(here, robots, monkeypatch) -> None:
    team = robots("alpha", "bravo")
    team.up()
    team.mission()
    here("push", "mission.dL", status=0)
    monkeypatch.setattr(mission_start, "wait_until_up", interrupt_soon)
    ended = here("start", status=exit_status.INTERRUPTED)
    assert ["'lfield status'" in line for line in ended.err] == [True]
    team.services["alpha"].wait_for("status 0")
