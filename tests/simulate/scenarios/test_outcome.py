"""The outcome of a scenario: its contents, and its dependence on the seed alone."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from lfield.replication.transfer.coordinator_copies import CoordinatorCopy
from lfield.replication.transfer.effects import Effect
from lfield.replication.transfer.transfer_sender import TransferSender
from lfield.simulate.host_fleet import ProcessLog
from simulation_testing.command_line import main
from simulation_testing.seed_runner import SeedTally, run_seed


@pytest.mark.few(0)
def test_a_changed_log_line_changes_the_digest_and_not_the_outcome(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before, write = run_seed(3), ProcessLog.write
    monkeypatch.setattr(ProcessLog, "write", lambda self, text: write(self, f"in other words: {text}"))
    after = run_seed(3)
    assert after.digest != before.digest
    assert after.outcome == before.outcome


@pytest.mark.few(0)
def test_changed_behaviour_changes_the_outcome(monkeypatch: pytest.MonkeyPatch) -> None:
    before = run_seed(11)

    def resumes(self: TransferSender, copy: CoordinatorCopy, now: float) -> list[Effect]:
        return self._resume(copy, "UnreachableResourceException", "it took too long")

    monkeypatch.setattr(TransferSender, "on_deadline", resumes)
    assert run_seed(11).outcome != before.outcome


@pytest.mark.few(0)
def test_a_scenario_with_orders_is_the_same_at_other_memory_addresses() -> None:
    """The tasks of the operator are cancelled in the order of their start."""
    kept: list[object] = []
    outcomes = set()
    for _ in range(3):
        kept.append([object() for _ in range(1000)])
        outcomes.add(run_seed(19).outcome)
    assert len(outcomes) == 1


def test_outcomes_are_written_to_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tally = SeedTally(outcomes={seed: f"{seed:064x}" for seed in range(10)})
    monkeypatch.setattr("simulation_testing.command_line.run_seeds", lambda seeds, processes: tally)
    file = tmp_path / "outcomes.txt"
    monkeypatch.setattr(sys, "argv", ["simulate", "--seeds", "10", "--outcomes", str(file)])
    assert main() == 0
    assert file.read_text() == f"0{' 00000000' * 10}\n"


@pytest.mark.parametrize("words", [["--seeds", "15"], ["--seeds", "10", "--first", "10"]])
def test_outcomes_are_written_for_all_seeds_in_groups_of_ten(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["simulate", *words, "--outcomes", str(tmp_path / "outcomes.txt")])
    with pytest.raises(SystemExit):
        main()
    assert "--outcomes needs --first 0" in capsys.readouterr().err
