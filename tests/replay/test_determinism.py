"""A replay detects a core that is not determined by its inputs, and another hash seed changes nothing."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from math import inf

import pytest
from recorded_teams import RecordedTeam, compare, run_into, run_recorded, walk_mission

from lfield.host.core import HostCore
from lfield.host.recording.host_records import IdleTurn, TurnRecord
from lfield.replay.host_replay import HostReplay
from lfield.text import log_messages
from lfield.vm.turns.run_limit import RunCuts

#: A replay in a process with another hash seed, so with another order of sets.
OTHER_SEED = "4711"


@pytest.fixture
def walked(tmp_path) -> RecordedTeam:
    return run_recorded(walk_mission(tmp_path), 6.0)


def test_a_core_that_reads_the_real_time_is_detected(walked, monkeypatch):
    assert compare(walked, at_checkpoints=False).first is None
    run = HostCore.run

    def late(self: HostCore) -> float | None:
        self.context.log(log_messages.LINK_LOST.line(host=f"{time.perf_counter_ns()}"))
        return run(self)

    monkeypatch.setattr(HostCore, "run", late)
    found = run_recorded(walked.mission, 1.0)
    assert compare(found, at_checkpoints=False).first is not None


@pytest.mark.few(0)
@pytest.mark.process
def test_another_hash_seed_changes_nothing(tmp_path):
    run_into(tmp_path / "records", walk_mission(tmp_path), 6.0)
    for seed in ("0", OTHER_SEED):
        ran = subprocess.run(
            [sys.executable, "-m", "lfield", "replay", "records"], cwd=tmp_path, capture_output=True,
            text=True, timeout=60, env={**os.environ, "PYTHONHASHSEED": seed},
        )  # fmt: skip
        assert ran.returncode == 0, ran.stdout + ran.stderr
        assert ran.stdout.count(": equal") == 2


def test_a_turn_without_input_after_a_cut_one_is_not_cut(walked):
    recording = walked.recordings()[0]
    replay = HostReplay(recording, walked.mission)
    limit = replay.core.context.run_limit
    replay.prepare(TurnRecord(recording.started_at, cuts=RunCuts(turns=1)))
    assert [limit.stopwatch() for _ in range(3)] == [0.0, inf, inf]
    replay.prepare(IdleTurn(recording.started_at))
    assert [limit.stopwatch() for _ in range(3)] == [0.0, 0.0, 0.0]
