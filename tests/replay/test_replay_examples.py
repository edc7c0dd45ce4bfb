"""Every example, recorded in virtual time, is replayed without a difference, on both engines."""

from __future__ import annotations

import importlib.util
from collections import Counter
from pathlib import Path

import pytest
from recorded_teams import compare, run_recorded

from lfield.host.engine_provider import select_engine
from lfield.host.recording import flight_recorder
from lfield.host.recording.effect_summary import decode_effects
from lfield.host.recording.host_records import TurnRecord
from lfield.mission.loader import load_mission
from lfield.replay.program_replay import run_program
from lfield.replay.recording_files import TeamRecording
from lfield.replay.team_order import TeamOrder
from lfield.testing.recorded_run import record_mission
from lfield.vm.reference import ReferenceEngine

EXAMPLES = Path(__file__).parents[2] / "examples"
MISSIONS = sorted(str(path.relative_to(EXAMPLES)) for path in EXAMPLES.glob("*/*.dL"))
#: Examples without a file of devices.
SIMULATED = ("20-gps-driver/mission.dL",)
#: This mission waits for its operator first, at most 30 s.
SECONDS = {"16-three-tiers/sequences.dL": 90.0}


@pytest.fixture(autouse=True)
def drivers(monkeypatch, tmp_path):
    """The drivers and types of the examples, as in their own tests."""
    spec = importlib.util.spec_from_file_location("examples_conftest", EXAMPLES / "conftest.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for folder in module.project_folders(tmp_path):
        monkeypatch.syspath_prepend(folder)


@pytest.mark.few(1)
@pytest.mark.parametrize("engine", ["reference", "wasm"])
@pytest.mark.parametrize("name", MISSIONS)
def test_an_example_is_replayed_on_each_engine_and_from_each_checkpoint(name, engine, monkeypatch):
    monkeypatch.setattr(flight_recorder, "CHECKPOINT_INTERVAL", 2.0)
    team = run_recorded(load_mission(EXAMPLES / name, simulate=name in SIMULATED), SECONDS.get(name, 6.0))
    engines = ReferenceEngine if engine == "reference" else select_engine("wasm", lambda line: None, float)
    found = compare(team, engines, at_checkpoints=True)
    assert found.first is None
    assert found.digests > 100
    assert len(found.parts) >= 2 * len(team.hosts)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", MISSIONS)
def test_an_example_is_replayed_from_the_bundle_of_each_host(name):
    """A host has the drivers of its own devices only, but knows the devices of all hosts."""
    mission = load_mission(EXAMPLES / name, simulate=name in SIMULATED)
    team = run_recorded(mission, 3.0)
    assert len(team.bundles) >= len(mission.team.hosts)
    for host in team.with_own_bundles():
        assert compare(host, at_checkpoints=False).first is None


@pytest.mark.few(0)
@pytest.mark.parametrize("name", MISSIONS)
def test_the_program_of_an_example_makes_all_recorded_calls(name):
    """`lfield test --from` compares the whole flight."""
    parts, mission = record_mission(EXAMPLES / name, 15.0)
    recording = TeamRecording(mission, (), (), ())
    made: Counter[str] = Counter()
    for part in parts:
        for _, turn in part.turns_from(0):
            effects = decode_effects(turn.effects) if isinstance(turn, TurnRecord) else []
            made.update(effect[1] for effect in effects if effect[0] == "CallDevice")
    log = run_program(recording, TeamOrder(parts), mission)
    assert {agent: len(log.by_agent.get(agent, ())) for agent in made} == made
    again = run_program(recording, TeamOrder(parts), mission, recorded=log)
    assert log.count > 0
    assert log.first_difference(again) is None
