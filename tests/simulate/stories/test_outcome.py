"""The outcome of a story: what it covers, and that it depends on the seed alone."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from lfield.mobility.copies import Copy
from lfield.mobility.departures import Departures
from lfield.mobility.effects import Effect
from lfield.simulate.__main__ import main
from lfield.simulate.fleet import Book
from lfield.simulate.seeds import Tally, told


def test_another_log_line_changes_the_digest_of_a_story_and_not_its_outcome(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before, write = told(3), Book.write
    monkeypatch.setattr(Book, "write", lambda self, text: write(self, f"in other words: {text}"))
    after = told(3)
    assert after.digest != before.digest
    assert after.outcome == before.outcome


def test_another_behaviour_changes_the_outcome(monkeypatch: pytest.MonkeyPatch) -> None:
    before = told(15)

    def resumes(self: Departures, copy: Copy) -> list[Effect]:
        return self._resume(copy, "UnreachableResourceException", "it took too long")

    monkeypatch.setattr(Departures, "overdue", resumes)
    assert told(15).outcome != before.outcome


def test_a_story_of_orders_is_the_same_at_other_addresses_in_memory() -> None:
    """The tasks of the operator are cancelled in the order of their begin."""
    kept: list[object] = []
    outcomes = set()
    for _ in range(3):
        kept.append([object() for _ in range(1000)])
        outcomes.add(told(19).outcome)
    assert len(outcomes) == 1


def test_outcomes_are_written_to_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tally = Tally(outcomes={seed: f"{seed:064x}" for seed in range(10)})
    monkeypatch.setattr("lfield.simulate.__main__.run", lambda seeds, processes: tally)
    file = tmp_path / "outcomes.txt"
    monkeypatch.setattr(sys, "argv", ["simulate", "--seeds", "10", "--outcomes", str(file)])
    assert main() == 0
    assert file.read_text() == f"0{' 00000000' * 10}\n"


@pytest.mark.parametrize("words", [["--seeds", "15"], ["--seeds", "10", "--first", "10"]])
def test_outcomes_are_written_of_all_seeds_from_the_first_in_tens(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["simulate", *words, "--outcomes", str(tmp_path / "outcomes.txt")])
    with pytest.raises(SystemExit):
        main()
    assert "--outcomes needs --first 0" in capsys.readouterr().err
