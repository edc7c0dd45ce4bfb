"""Thousands of scenarios with pushes, over several processes: `simulate.py --pushes --seeds 2000`.

For a scenario with a breach the command that repeats it is printed, and its size when it is shrunk.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from rich.console import Console

from simulation_testing.services.push_scenario import (
    PushScenario,
    PushVerdict,
    draw_push_scenario,
    run_push_scenario,
    smaller_scenarios,
)

#: Seeds that a process gets at a time.
CHUNK = 8
#: The most scenarios that are shrunk, and the attempts of each.
MAX_SHRUNK, MAX_TRIALS = 3, 150


def run_push_seed(seed: int) -> PushVerdict:
    """The verdict on the scenario of a seed."""
    return run_push_scenario(draw_push_scenario(seed))


def first_breach(seeds: Iterable[int]) -> PushVerdict | None:
    """The first verdict with a breach."""
    return next((verdict for verdict in map(run_push_seed, seeds) if verdict.breaches), None)


def shrink_push_scenario(found: PushVerdict, most: int = MAX_TRIALS) -> PushVerdict:
    """The smallest scenario that was found with the same breach."""
    name, best, tries = found.breaches[0].name, found, 0
    smaller = iter(smaller_scenarios(best.scenario))
    while (scenario := next(smaller, None)) is not None and tries < most:
        tries += 1
        verdict = run_push_scenario(scenario, keep_log=True)
        if any(breach.name == name for breach in verdict.breaches):
            best = verdict
            smaller = iter(smaller_scenarios(scenario))
    return best


@contextmanager
def _spread(seeds: range, processes: int) -> Iterator[Iterator[PushVerdict]]:
    if processes == 1:
        yield map(run_push_seed, seeds)
        return
    with multiprocessing.get_context("spawn").Pool(processes, maxtasksperchild=20) as pool:
        yield pool.imap_unordered(run_push_seed, seeds, CHUNK)


def run_push_seeds(seeds: range, processes: int = 0, console: Console | None = None) -> list[PushVerdict]:
    """Run and check the scenarios of some seeds; returns the verdicts with breaches.

    `processes` 0: one for each core.
    """
    console = console or Console()
    processes = processes or len(os.sched_getaffinity(0))
    counts, started, virtual = Counter[str](), time.monotonic(), 0.0
    digests: dict[int, str] = {}
    broken: list[PushVerdict] = []
    with _spread(seeds, processes) as verdicts:
        for verdict in verdicts:
            counts.update(verdict.counts)
            virtual += verdict.seconds
            digests[verdict.scenario.seed] = verdict.digest
            if verdict.breaches:
                broken.append(verdict)
                console.print(f"{verdict.breaches[0]}: {command(verdict.scenario)}", soft_wrap=True)
    for verdict in sorted(broken, key=lambda verdict: verdict.scenario.seed)[:MAX_SHRUNK]:
        console.print(f"shrunk: {size(shrink_push_scenario(verdict).scenario)}", soft_wrap=True)
    lines = "".join(f"{seed} {digest}\n" for seed, digest in sorted(digests.items()))
    digest = hashlib.sha256(lines.encode()).hexdigest()[:16]
    what = ", ".join(f"{count:,} {name}" for name, count in counts.items())
    seconds = time.monotonic() - started
    console.print(f"{len(seeds):,} scenarios with pushes, {len(broken):,} breaches; {what}", soft_wrap=True)
    console.print(f"{virtual:,.0f} virtual seconds in {seconds:,.1f} s; digest {digest}", soft_wrap=True)
    return broken


def command(scenario: PushScenario) -> str:
    """The command that repeats a scenario."""
    return f"python tests/simulate/simulate.py --pushes --story {scenario.seed}"


def size(scenario: PushScenario) -> str:
    """The size of a scenario."""
    steps = [f"desk{n} {step.at:.1f} {step.action}" for n, own in enumerate(scenario.steps) for step in own]
    faults = [f"{fault.at:.1f} {fault.kind} {fault.one} {fault.other}" for fault in scenario.faults]
    return f"seed {scenario.seed}, {scenario.robots} robots; {'; '.join([*steps, *faults])}"
