"""Coordinators that start, stop and await others: hosts that crash, links that break, repeated requests."""

from __future__ import annotations

from pathlib import Path

import pytest
from sequencing_team import HOSTS, SequencingTeam, run_scenario


@pytest.mark.parametrize("keeps", [True, False])
@pytest.mark.parametrize("home", HOSTS)
def test_without_faults_each_start_is_made_once(tmp_path: Path, home: str, keeps: bool) -> None:
    team = SequencingTeam(tmp_path, 1, home, keeps=keeps)
    team.finish(120.0)
    assert team.starts == [1, 2, 3, 4]
    assert [team.count(f"ended: {how}") for how in ("done", "stopped")] == [2, 2]
    assert team.count("patrol begins") == 4
    assert team.count("patrol has been everywhere") == 2


@pytest.mark.few(6)
@pytest.mark.parametrize("seed", range(40))
def test_starts_are_made_once_despite_crashes_and_broken_links(tmp_path: Path, seed: int) -> None:
    run_scenario(tmp_path, seed)
