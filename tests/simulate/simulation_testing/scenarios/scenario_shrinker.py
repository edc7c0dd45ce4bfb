"""Shrinks a scenario with a breach: fewer faults, hosts, walkers, devices, and a shorter time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from simulation_testing.scenarios.scenario import Scenario
from simulation_testing.scenarios.scenario_drawing import KINDS, draw_scenario
from simulation_testing.scenarios.scenario_run import RunVerdict, run_scenario

#: The command that runs scenarios, from the root of the project.
COMMAND = "python tests/simulate/simulate.py"
#: The most smaller scenarios that are tried.
MAX_TRIALS = 200


def shrink_scenario(found: RunVerdict, most: int = MAX_TRIALS) -> RunVerdict:
    """The smallest scenario with the same breach that was found."""
    name, best = found.breaches[0].name, found
    tries = most
    while tries > 0:
        for scenario in _smaller(best):
            tries -= 1
            verdict = run_scenario(scenario)
            if any(breach.name == name for breach in verdict.breaches):
                best = verdict
                break
            if tries <= 0:
                break
        else:
            break
    return best


def _smaller(verdict: RunVerdict) -> Iterator[Scenario]:
    """Slightly smaller scenarios, the smallest first."""
    scenario = verdict.scenario
    if verdict.seconds + 0.1 < scenario.seconds:
        yield replace(scenario, seconds=round(verdict.seconds + 0.1, 3))
    struck = [number for number, fault in scenario.numbered if fault.at < scenario.seconds]
    size = len(struck)
    if size < len(scenario.numbered):
        yield replace(scenario, keep=frozenset(struck))
    if scenario.hosts > 2:
        witnesses = max(0, scenario.witnesses - 1)
        yield replace(
            scenario,
            hosts=scenario.hosts - 1,
            arms=min(scenario.arms, scenario.hosts - 1),
            witnesses=witnesses,
        )
    if scenario.walkers > 1:
        yield replace(scenario, walkers=scenario.walkers - 1)
    if scenario.arms:
        yield replace(scenario, arms=scenario.arms - 1)
    while size > 1:
        size = (size + 1) // 2
        for first in range(0, len(struck), size):
            yield replace(scenario, keep=frozenset(struck[:first] + struck[first + size :]))
    if len(struck) == 1:
        yield replace(scenario, keep=frozenset())


def command(scenario: Scenario) -> str:
    """The command that repeats this scenario."""
    usual, words = draw_scenario(scenario.seed), [f"{COMMAND} --story {scenario.seed}"]
    if (usual.kind, usual.means, usual.slowness) != (scenario.kind, scenario.means, scenario.slowness):
        usual = KINDS[scenario.kind](scenario.seed)
        words.append(f"--as {scenario.kind}")
    for name in ("hosts", "walkers", "arms", "seconds"):
        value = getattr(scenario, name)
        if value != getattr(usual, name):
            words.append(f"--{name} {value}")
    if scenario.keep is not None:
        words.append(f"--keep {','.join(str(number) for number in sorted(scenario.keep))}")
    return " ".join(words)
