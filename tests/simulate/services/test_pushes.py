"""Scenarios with pushes: several desks, faults in each phase, and a judge of the promises of services."""

from __future__ import annotations

import gc
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from lfield.service.service import Service
from simulation_testing.services.push_runner import command, run_push_seed, shrink_push_scenario
from simulation_testing.services.push_scenario import (
    KINDS,
    PushScenario,
    draw_push_scenario,
    run_push_scenario,
)

#: Seeds of a case.
CASE = 6


@pytest.mark.few(1)
@pytest.mark.parametrize("first", range(0, 120, CASE))
def test_pushes_keep_every_promise(first: int) -> None:
    counts = Counter[str]()
    for seed in range(first, first + CASE):
        verdict = run_push_seed(seed)
        assert not verdict.breaches, f"{verdict.breaches[0]}: {command(verdict.scenario)}"
        counts.update(verdict.counts)
    assert min(counts["yes"], counts["no"], counts["activated"], counts["acts"]) > 3


def test_seeds_draw_all_kinds_of_faults_and_steps() -> None:
    scenarios = [draw_push_scenario(seed) for seed in range(60)]
    assert {fault.kind for scenario in scenarios for fault in scenario.faults} == KINDS.keys()
    steps = [step for scenario in scenarios for own in scenario.steps for step in own]
    assert {step.action for step in steps} == {"push", "push without", "start", "stop", "discard"}
    assert any(step.dies_after for step in steps)
    assert {scenario.robots for scenario in scenarios} == {2, 3, 4}
    assert {len(scenario.steps) for scenario in scenarios} == {1, 2, 3}


@pytest.mark.few(0)
def test_the_same_seed_gives_the_same_run() -> None:
    digest = run_push_seed(3).digest
    assert digest == run_push_seed(3).digest
    assert digest != run_push_seed(4).digest


@pytest.mark.few(0)
def test_a_push_scenario_leaves_nothing_in_memory() -> None:
    gc.collect()
    before = sum(type(found) is Service for found in gc.get_objects())
    assert run_push_seed(0).counts["yes"]
    assert sum(type(found) is Service for found in gc.get_objects()) == before


@pytest.mark.few(0)
def test_a_push_run_does_not_depend_on_the_process() -> None:
    """Sets of strings have another order in every process."""
    line = [sys.executable, str(Path(__file__).parents[1] / "simulate.py"), "--pushes", "--story", "5"]
    runs = [
        subprocess.run(
            [*line, "--quiet"], env={"PYTHONHASHSEED": salt}, capture_output=True, text=True, check=True
        ).stdout
        for salt in ("1", "2")
    ]
    assert runs[0] == runs[1]
    assert run_push_scenario(draw_push_scenario(5)).digest in runs[0]


@pytest.mark.few(0)
def test_a_push_scenario_with_a_breach_is_shrunk(monkeypatch: pytest.MonkeyPatch) -> None:
    from planted_push_bugs import a_held_host_is_not_released

    a_held_host_is_not_released(monkeypatch)
    found = next(v for v in map(run_push_seed, range(30)) if v.breaches)
    small = shrink_push_scenario(found, most=25)
    assert small.breaches[0].name == found.breaches[0].name

    def length(scenario: PushScenario) -> int:
        return len(scenario.faults) + sum(map(len, scenario.steps))

    assert length(small.scenario) < length(found.scenario)
