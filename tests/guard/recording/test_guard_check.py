"""`lfield replay` also replays the recordings of guards, and compares their decisions."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

from recorded_guards import RandomInputs, RecordedGuard

from lfield.guard.core import GuardCore
from lfield.guard.effects import Exit
from lfield.recording.folders import guard_folder
from lfield.replay.team_check import check_guards


def team(folder: Path) -> SimpleNamespace:
    """A recording of one host, without the records of its core."""
    part = SimpleNamespace(start=SimpleNamespace(incarnation=7))
    incarnation = SimpleNamespace(folder=folder, host="alpha", parts=(part,))
    return SimpleNamespace(incarnations=(incarnation,))


def recorded(folder: Path) -> list[Path]:
    guard = RandomInputs(7, RecordedGuard(limit=5000)).run(200)
    guard.recorder.close()
    ring_folder = guard_folder(folder, "a.arm")
    ring_folder.mkdir()
    return guard.ring.stored(ring_folder)


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
