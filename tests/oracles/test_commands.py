"""The output and the exit status of each command are in `golden/COMMAND.txt`.

`make oracles` rewrites these files; `git diff` then shows the effects of a change.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from cases import CASES
from command_lines import ROOT, transcript
from golden_files import GoldenFile

#: Commands with a case for each mission of the examples: a run includes a few of these cases.
SAMPLED = [name for name, cases in CASES.items() if len(cases) > 10]
SHORT = [name for name in CASES if name not in SAMPLED]


def of(names: list[str]) -> list[object]:
    return [pytest.param(name, case, id=f"{name}-{case}") for name in names for case in CASES[name]]


@pytest.fixture(autouse=True)
def _own_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Set the folders of keys and runs, and the width of the output."""
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("COLUMNS", "120")
    for name in ("LFIELD_KEYS", "LFIELD_AUTHORITY"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.few(20)
@pytest.mark.parametrize(("command", "case"), of(SHORT))
def test_a_command_prints_what_it_did(golden, command: str, case: str, tmp_path: Path) -> None:
    golden(command).check(case, transcript(CASES[command][case], tmp_path))


@pytest.mark.few(6)
@pytest.mark.parametrize(("command", "case"), of(SAMPLED))
def test_a_command_prints_of_each_example_what_it_did(
    golden, command: str, case: str, tmp_path: Path
) -> None:
    golden(command).check(case, transcript(CASES[command][case], tmp_path))


@pytest.mark.parametrize("command", CASES)
def test_golden_files_have_no_other_sections(golden, command: str) -> None:
    file: GoldenFile = golden(command)
    file.has_only(CASES[command])
