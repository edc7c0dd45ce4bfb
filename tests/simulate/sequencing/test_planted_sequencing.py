"""Every planted bug of the sequencing is found by a scenario with faults."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from planted_sequencing_bugs import SEQUENCING_BUGS
from sequencing_team import run_scenario

#: Seeds that are searched.
SEEDS = range(60)


@pytest.mark.few(1)
@pytest.mark.parametrize("bug", SEQUENCING_BUGS, ids=lambda bug: bug.__name__)
def test_a_planted_sequencing_bug_is_found(
    bug: Callable[[pytest.MonkeyPatch], None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    bug(monkeypatch)
    for seed in SEEDS:
        try:
            run_scenario(tmp_path, seed, at_most=300.0)
        except AssertionError:
            return
    pytest.fail(f"no scenario from 0 to {SEEDS[-1]}")
