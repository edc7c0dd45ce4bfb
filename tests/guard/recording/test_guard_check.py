"""`lfield replay` compares the decisions of guards too."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

from recorded_guards import DrawnInputs, RecordedGuard

from lfield.guard.core import GuardCore
from lfield.guard.effects import Exit
from lfield.recording.folders import guard_folder
from lfield.replay.team_check import check_guards


def team(folder: Path) -> SimpleNamespace:
    """A recording of one host, whose core does not matter here."""
    part = SimpleNamespace(start=SimpleNamespace(incarnation=7))
    incarnation = SimpleNamespace(folder=folder, host="alpha", parts=(part,))
    return SimpleNamespace(incarnations=(incarnation,))


def recorded(folder: Path) -> list[Path]:
    guard = DrawnInputs(7, RecordedGuard(limit=5000)).run(200)
    guard.recorder.close()
    own = guard_folder(folder, "a.arm")
    own.mkdir()
    return guard.ring.stored(own)


def test_guards_of_a_host_are_replayed_and_differences_counted(tmp_path, monkeypatch):
    recorded(tmp_path)
    (result,), problems = check_guards(team(tmp_path))
    assert (result.host, result.differences, result.first, problems) == ("alpha", 0, None, [])
    assert result.guard
    assert result.digests >= 200
    monkeypatch.setattr(GuardCore, "tick", lambda core: [Exit(3)])
    (result,), _ = check_guards(team(tmp_path))
    assert result.differences == 1
    assert result.first.host == "alpha"
    assert result.first.recorded != result.first.replayed


def test_damaged_guard_file_is_named(tmp_path):
    path = recorded(tmp_path)[-1]
    path.write_bytes(path.read_bytes()[:-3])
    (result,), problems = check_guards(team(tmp_path))
    assert result.differences == 0
    assert len(problems) == 1
    assert path.name in problems[0]
