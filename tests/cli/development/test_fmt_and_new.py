"""`lfield fmt` and `lfield new`, as commands."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from lfield.cli.main import main
from lfield.lang.deployment import read_deployment
from lfield.mission.loader import check_file
from lfield.mission.skeleton import coordinator_name

GOOD = "resource Bell {\n    init(string[] arg) { }\n}\n"
LOOSE = "resource Bell{\ninit(string[] arg){}\n}"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_files_are_formatted_in_place_and_keep_their_mode(folder: Path, capsys) -> None:
    for name, text in (("a.L", LOOSE), ("b.L", GOOD), ("c.dL", "  //Bell:b@h\n\n\n")):
        (folder / name).write_text(text)
    (folder / "a.L").chmod(0o640)
    (folder / "link.L").symlink_to("a.L")
    assert main(["fmt", "link.L", "b.L", "c.dL"]) == 0
    assert capsys.readouterr().out == "link.L\nc.dL\n"
    assert (folder / "a.L").read_text() == (folder / "b.L").read_text() == GOOD
    assert (folder / "c.dL").read_text() == "//Bell:b@h\n"
    assert (folder / "link.L").is_symlink()
    assert (folder / "a.L").stat().st_mode & 0o777 == 0o640
    assert main(["fmt", "a.L", "b.L"]) == 0
    assert capsys.readouterr().out == ""


def test_fmt_check_changes_nothing(folder: Path, capsys) -> None:
    (folder / "a.L").write_text(LOOSE)
    (folder / "b.L").write_text(GOOD)
    assert main(["fmt", "--check", "a.L", "b.L"]) == 1
    assert capsys.readouterr().out == "a.L\n"
    assert (folder / "a.L").read_text() == LOOSE
    assert main(["fmt", "--check", "b.L"]) == 0


def test_a_file_with_syntax_errors_stays_and_others_are_formatted(folder: Path, capsys) -> None:
    (folder / "bad.L").write_text("resource Bell {\n  init( }")
    (folder / "latin.L").write_bytes("// caf\u00e9".encode("latin-1"))
    (folder / "a.L").write_text(LOOSE)
    assert main(["fmt", "bad.L", "latin.L", "a.L"]) == 65
    output = capsys.readouterr().err
    assert "bad.L:2:9: error[L" in output
    assert "latin.L:1:7: error[L" in output
    assert (folder / "bad.L").read_text() == "resource Bell {\n  init( }"
    assert (folder / "a.L").read_text() == GOOD


def test_a_program_on_stdin_is_printed(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(LOOSE.encode())))
    assert main(["fmt", "-"]) == 0
    assert capsys.readouterr().out == GOOD


@pytest.mark.parametrize(
    ("name", "text", "status"),
    [("x.yaml", "a: 1", 64), ("none.L", None, 66), ("folder.L", "", 66), ("locked.L", LOOSE, 73)],
)
def test_a_file_that_cannot_be_formatted_is_refused(
    folder: Path, name: str, text: str | None, status: int, monkeypatch
) -> None:
    if name == "folder.L":
        (folder / name).mkdir()
    elif text is not None:
        (folder / name).write_text(text)
    # The tests may run as root, which may write everything.
    monkeypatch.setattr("os.access", lambda path, mode: not str(path).endswith("locked.L"))
    assert main(["fmt", name]) == status


def test_a_new_mission_has_no_findings_and_is_formatted(folder: Path, capsys) -> None:
    assert main(["new", "box-search"]) == 0
    made = folder / "box-search"
    files = ["mission.L", "mission.dL", "mission.devices.yaml", "test_box_search.py"]
    assert sorted(path.name for path in made.iterdir()) == sorted(files)
    assert [line for line in capsys.readouterr().out.splitlines() if line.startswith("box-search/")] == [
        f"box-search/{name}" for name in files
    ]
    assert "BoxSearch" in {agent.type for agent in read_deployment(made / "mission.dL", None).agents}
    assert main(["check", str(made / "mission.dL")]) == 0
    assert list(check_file(made / "mission.dL")) == []
    assert main(["fmt", "--check", str(made / "mission.L"), str(made / "mission.dL")]) == 0


def test_an_empty_directory_may_be_used(folder: Path) -> None:
    (folder / "field").mkdir()
    assert main(["new", "survey", "--into", "field"]) == 0
    assert (folder / "field" / "test_survey.py").exists()


@pytest.mark.parametrize(
    "name", ["Survey", "1st", "a b", "a--b", "../x", "copter", "exception", "mavlink", "x" * 40]
)
def test_an_invalid_name_is_refused(folder: Path, name: str, capsys) -> None:
    assert main(["new", name]) == 64
    assert list(folder.iterdir()) == []
    assert "cannot be the name of a mission" in capsys.readouterr().err


def test_a_directory_with_files_or_without_write_access_is_refused(folder: Path) -> None:
    (folder / "survey").mkdir()
    (folder / "survey" / "x").write_text("")
    assert main(["new", "survey"]) == 64
    assert main(["new", "survey", "--into", "survey/x"]) == 64
    assert main(["new", "survey", "--into", "survey/x/y"]) == 73
    assert coordinator_name("a-b1-c") == "AB1C"
