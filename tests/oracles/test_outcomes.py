"""The outcomes of 2,000 seeds do not change: `outcomes.txt` has a digest for each.

The digests cover the actions of programs, devices and coordinators in virtual time, without Python names and
messages (simulation_testing/invariants/outcome_recorder.py). `make oracles` rewrites the file.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from simulation_testing.seed_runner import DIGITS, IN_A_LINE, lines_of, run_seed

FILE = Path(__file__).parent / "outcomes.txt"
SEEDS = 2000
#: Half a line of the file.
IN_A_CASE = IN_A_LINE // 2


def frozen() -> list[str]:
    return FILE.read_text(encoding="utf-8").splitlines()


@pytest.mark.few(1)
@pytest.mark.parametrize("first", range(0, SEEDS, IN_A_CASE))
def test_outcomes_of_scenarios_are_unchanged(first: int) -> None:
    seeds = range(first, first + IN_A_CASE)
    outcomes = [run_seed(seed).outcome[:DIGITS] for seed in seeds]
    _, *line = frozen()[first // IN_A_LINE].split()
    expected = line[first % IN_A_LINE :][:IN_A_CASE]
    assert dict(zip(seeds, outcomes, strict=True)) == dict(zip(seeds, expected, strict=True))


def test_the_file_has_all_seeds() -> None:
    assert [int(line.split()[0]) for line in frozen()] == [*range(0, SEEDS, IN_A_LINE)]


def test_outcomes_are_written_ten_in_a_line() -> None:
    assert lines_of({seed: f"{seed:08x}ffff" for seed in range(20)})[1].split()[:2] == ["10", "0000000a"]
    with pytest.raises(ValueError, match="multiple of 10"):
        lines_of({0: "", 1: ""})
