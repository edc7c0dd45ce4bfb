"""Thousands of scenarios, over several processes: `make simulate SEEDS=10000`.

A scenario with a breach is printed with the command that repeats it, and again shrunk.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from simulation_testing.scenarios.scenario import Scenario
from simulation_testing.scenarios.scenario_drawing import draw_scenario
from simulation_testing.scenarios.scenario_run import RunVerdict, run_scenario
from simulation_testing.scenarios.scenario_shrinker import command, shrink_scenario

#: Seeds of a process at a time, and the number after which it is replaced.
CHUNK, MAX_SEEDS_PER_PROCESS = 8, 160
#: The most scenarios that are shrunk; of the others the command is printed.
MAX_SHRUNK = 3


@dataclass(slots=True)
class SeedTally:
    """The results of many scenarios."""

    runs: int = 0
    seconds: float = 0.0
    faults: int = 0
    calls: int = 0
    restarts: int = 0
    recovered: int = 0
    broken: list[RunVerdict] = field(default_factory=list)
    digests: dict[int, str] = field(default_factory=dict)
    outcomes: dict[int, str] = field(default_factory=dict)

    def add(self, verdict: RunVerdict) -> None:
        """Add a result."""
        self.runs += 1
        self.seconds += verdict.seconds
        self.faults += len(verdict.faults)
        self.calls += verdict.calls
        self.restarts += verdict.restarts
        self.recovered += verdict.recovered
        self.digests[verdict.scenario.seed] = verdict.digest
        self.outcomes[verdict.scenario.seed] = verdict.outcome
        if verdict.breaches:
            self.broken.append(verdict)

    @property
    def digest(self) -> str:
        """A digest of all runs."""
        lines = (f"{seed} {digest}\n" for seed, digest in sorted(self.digests.items()))
        return hashlib.sha256("".join(lines).encode()).hexdigest()


#: Digits of a written outcome, and seeds of a line.
DIGITS, IN_A_LINE = 8, 10


def lines_of(outcomes: Mapping[int, str]) -> list[str]:
    """Outcomes by seed as lines: the first seed of a line, then the digests of the next ten seeds.

    Raises ValueError unless the seeds are the first 10, 20, 30 ...
    """
    count = len(outcomes)
    if sorted(outcomes) != [*range(count)] or count % IN_A_LINE:
        raise ValueError(f"outcomes are written for all seeds from 0 to a multiple of {IN_A_LINE}")
    lines = [range(first, first + IN_A_LINE) for first in range(0, count, IN_A_LINE)]
    return [" ".join([str(seeds[0]), *(outcomes[seed][:DIGITS] for seed in seeds)]) for seeds in lines]


#: Draws the scenario of a seed.
DrawScenario = Callable[[int], Scenario]


def run_seed(seed: int, draws: DrawScenario = draw_scenario) -> RunVerdict:
    """The result of the scenario of a seed."""
    return run_scenario(draws(seed))


def first_broken(seeds: Iterable[int], draws: DrawScenario = draw_scenario) -> RunVerdict | None:
    """The first scenario of these seeds with a breach."""
    verdicts = (run_seed(seed, draws) for seed in seeds)
    return next((verdict for verdict in verdicts if verdict.breaches), None)


@contextmanager
def _spread(seeds: range, processes: int) -> Iterator[Iterator[RunVerdict]]:
    """The results of the scenarios, as they arrive."""
    if processes == 1:
        yield map(run_seed, seeds)
        return
    with multiprocessing.get_context("spawn").Pool(
        processes, maxtasksperchild=MAX_SEEDS_PER_PROCESS // CHUNK
    ) as pool:
        yield pool.imap_unordered(run_seed, seeds, CHUNK)


def run_seeds(seeds: range, processes: int = 0, console: Console | None = None) -> SeedTally:
    """Run the scenarios of some seeds, and print each breach; `processes` 0: one for each core."""
    console = console or Console()
    processes = processes or len(os.sched_getaffinity(0))
    tally, started = SeedTally(), time.monotonic()
    columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.description}"))
    with (
        Progress(*columns, console=console, transient=True) as progress,
        _spread(seeds, processes) as verdicts,
    ):
        task = progress.add_task("0 breaches", total=len(seeds))
        for verdict in verdicts:
            tally.add(verdict)
            progress.update(task, advance=1, description=f"{len(tally.broken)} breaches")
            if verdict.breaches:
                _write_verdict(progress.console.print, verdict)
    for verdict in sorted(tally.broken, key=lambda verdict: verdict.scenario.seed)[:MAX_SHRUNK]:
        console.print("shrunk:", highlight=False)
        _write_verdict(console.print, shrink_scenario(verdict))
    elapsed = time.monotonic() - started
    console.print(summary(tally, elapsed), highlight=False, soft_wrap=True)
    return tally


def summary(tally: SeedTally, took: float) -> str:
    """The summary in two lines; `took` is in real seconds."""
    kinds = Counter(verdict.breaches[0].name for verdict in tally.broken)
    of = f" ({', '.join(f'{name} {count}' for name, count in sorted(kinds.items()))})" if kinds else ""
    return (
        f"{tally.runs:,} seeds, {len(tally.broken):,} breaches{of}; "
        f"{tally.faults:,} faults, {tally.calls:,} calls, {tally.restarts:,} restarts, "
        f"{tally.recovered:,} recoveries\n"
        f"{tally.seconds:,.0f} virtual seconds in {took:,.1f} s: {tally.seconds / took:,.0f} per second; "
        f"digest {tally.digest[:16]}"
    )


def _write_verdict(write: Callable[..., None], verdict: RunVerdict) -> None:
    """Print the breach, the size of the scenario, and the command that repeats it."""
    scenario = verdict.scenario
    write(f"{verdict.breaches[0]}", markup=False, highlight=False, soft_wrap=True)
    size = f"{scenario.hosts} hosts, {scenario.walkers} walkers, {len(verdict.faults)} faults"
    write(
        f"    {size}, {verdict.seconds:.1f} s: {command(scenario)}",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )
