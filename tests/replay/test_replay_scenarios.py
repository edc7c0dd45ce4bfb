"""Simulated teams with kills, recoveries, cuts and full disks are replayed without a difference."""

from __future__ import annotations

import pytest
from recorded_teams import compare, recorded

from lfield.host.recording import flight_recorder
from lfield.host.recording.recording_target import RecordingMemory
from lfield.mission.mission import Mission
from lfield.simulate import host_fleet
from simulation_testing.scenarios.scenario_drawing import draw_scenario
from simulation_testing.scenarios.scenario_run import run_scenario


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(300, 500))
def test_a_scenario_is_replayed(seed, monkeypatch):
    monkeypatch.setattr(flight_recorder, "CHECKPOINT_INTERVAL", 20.0)
    missions: list[Mission] = []
    original = host_fleet.Fleet.__init__

    def init(fleet, *args, **options):
        original(fleet, *args, **options)
        missions.append(fleet.mission)

    monkeypatch.setattr(host_fleet.Fleet, "__init__", init)
    memory = RecordingMemory()
    verdict = run_scenario(draw_scenario(seed), record=memory)
    assert not verdict.breaches
    found = compare(recorded(missions[-1], memory), at_checkpoints=True)
    assert found.first is None
    assert found.digests > 0


def test_a_scenario_is_the_same_with_and_without_a_recorder():
    scenario = draw_scenario(301)
    assert run_scenario(scenario).digest == run_scenario(scenario, record=RecordingMemory()).digest
