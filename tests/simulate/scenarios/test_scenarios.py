"""Scenarios with orders of an operator, wrecks, split and large teams, and slow computers."""

from __future__ import annotations

import gc
import random
from collections import Counter
from dataclasses import replace

import pytest

from lfield.host.host import Host
from lfield.host.stop_orders.order_executor import HOLD_NAMES, NEWER_ORDER
from lfield.replication.membership.overlay import Overlay
from lfield.simulate.host_fleet import Fleet, FleetOptions
from simulation_testing.fault_injection import FaultRates
from simulation_testing.invariants.run_judge import RunJudge
from simulation_testing.scenarios.scenario import FOR_EVER, plain
from simulation_testing.scenarios.scenario_drawing import KINDS, draw_scenario, under_orders
from simulation_testing.scenarios.scenario_run import run_scenario
from simulation_testing.scenarios.scenario_shrinker import command
from simulation_testing.seed_runner import run_seed
from simulation_testing.simulated_operator import Hold, SimulatedOperator


@pytest.mark.few(0)
@pytest.mark.parametrize("kind", ["split", "wrecked", "crowd", "flown"])
def test_rare_scenarios_keep_every_promise(kind: str) -> None:
    totals = Counter[str]()
    for seed in range(3):
        verdict = run_seed(seed, KINDS[kind])
        assert not verdict.breaches, f"{verdict.breaches[0]}: {command(verdict.scenario)}"
        totals.update(calls=verdict.calls, **verdict.orders)
    assert totals["calls"] > 20
    assert kind != "wrecked" or totals["recover"] + totals["forget"] > 0


@pytest.mark.few(0)
def test_hosts_keep_confirmed_orders() -> None:
    totals = Counter[str]()
    for seed in range(6):
        scenario = under_orders(replace(plain(seed), journals=True), random.Random(seed))
        verdict = run_scenario(scenario)
        assert not verdict.breaches, verdict.breaches[0]
        totals.update(verdict.orders)
    assert min(totals["stop"], totals["pause"]) > 3


def test_seeds_draw_scenarios_of_all_kinds() -> None:
    scenarios = [draw_scenario(seed) for seed in range(400)]
    assert {scenario.kind for scenario in scenarios} == KINDS.keys()
    struck = {kind for scenario in scenarios for kind in scenario.means}
    assert struck == FaultRates.__dataclass_fields__.keys()
    assert {scenario.slowness for scenario in scenarios} > {1.0}


def test_a_team_of_more_than_nine_hosts_links_only_neighbours() -> None:
    mission = KINDS["crowd"](0).mission
    hosts = mission.team.hosts
    assert len(Overlay(hosts, 0).neighbours) < len(hosts) - 1


def test_code_takes_processor_time_on_a_slow_computer() -> None:
    """A host that runs much code is late with all its actions."""
    scenario = replace(plain(1), keep=frozenset(), hosts=3, walkers=3, arms=0, calls=FOR_EVER, stay=0.04)
    calls = []
    for slowness in (1.0, 1000.0):
        judge = RunJudge()
        judge.fleet = Fleet(
            scenario.mission, 1, on_start=judge.on_host_start, options=FleetOptions(slowness=slowness)
        )
        judge.fleet.run(8.0)
        calls.append(judge.calls)
        judge.fleet.close()
    assert calls[1] < 0.5 * calls[0]


def test_an_operator_stops_and_pauses_a_team_until_it_is_lifted() -> None:
    scenario = replace(plain(1), keep=frozenset(), hosts=3, walkers=1, arms=1, calls=FOR_EVER, stay=0.04)
    judge = RunJudge()
    fleet = judge.fleet = Fleet(scenario.mission, 1, on_start=judge.on_host_start)
    operator = SimulatedOperator(fleet, judge.orders, random.Random(1))
    fleet.run(4.0)
    operator.press("pause", 3.0)
    fleet.run(1.0)
    paused, calls = [life.core.coordinators.paused for life in fleet.runs.values()], judge.calls
    fleet.run(1.0)
    assert paused == [True] * 3
    assert judge.calls == calls
    operator.press("stop", 20.0)
    fleet.run(4.0)
    assert {life.core.coordinators.stopped for life in fleet.runs.values()} != {""}
    assert not any(life.core.coordinators.paused for life in fleet.runs.values())
    assert judge.calls > calls
    operator.free_all()
    fleet.run(2.0)
    assert {life.core.coordinators.stopped for life in fleet.runs.values()} == {""}
    assert operator.carried_out == {"pause": 3, "stop": 3}
    judge.check()
    assert not judge.breaches
    fleet.close()


@pytest.mark.parametrize("hold", ["stop", "pause"])
def test_a_late_order_does_not_end_a_stop_given_after_it(hold: Hold) -> None:
    scenario = replace(plain(1), keep=frozenset(), hosts=3, walkers=1, arms=1, calls=FOR_EVER, stay=0.04)
    judge = RunJudge()
    fleet = judge.fleet = Fleet(scenario.mission, 1, on_start=judge.on_host_start)
    operator = SimulatedOperator(fleet, judge.orders, random.Random(1))

    def held() -> list[bool]:
        cores = [life.core.coordinators for _, life in sorted(fleet.runs.items())]
        return [bool(core.stopped if hold == "stop" else core.paused) for core in cores]

    fleet.run(4.0)
    operator.press(hold, 1.0)
    fleet.run(0.9)
    # The lift has its own link, and is in flight to h0 for some seconds.
    fleet.network.paths.slow["operator", "h0"] = 2.0, 2.0
    fleet.run(3.5)
    assert held() == [True, False, False]
    del fleet.network.paths.slow["operator", "h0"]
    operator.press(hold, 30.0)
    fleet.run(0.3)
    assert held() == [True] * 3
    fleet.run(5.0)
    assert held() == [True] * 3
    reason = NEWER_ORDER.format(HOLD_NAMES[hold], HOLD_NAMES[hold])
    assert any(reason in text for _, _, text in fleet.log)
    judge.check()
    assert not judge.breaches
    operator.free_all()
    fleet.run(2.0)
    assert held() == [False] * 3
    fleet.close()


@pytest.mark.few(0)
def test_a_scenario_leaves_nothing_in_memory() -> None:
    """The objects of the simulated processes are freed with it: 2,000 scenarios fit into one process."""
    gc.collect()
    # Not isinstance: it asks weak references of other tests for the class of freed objects.
    before = sum(type(found) is Host for found in gc.get_objects())
    verdict = run_seed(0)
    assert verdict.calls
    gc.collect()
    assert sum(type(found) is Host for found in gc.get_objects()) == before
