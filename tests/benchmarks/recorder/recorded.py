"""The cost of the flight recorder, measured with and without it in turns, and the speed of its recordings."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from harness.checkout import Checkout, paced_mission
from harness.figure import Figure, Row
from harness.number_text import BYTES, COUNT, PERCENT, TIMES
from harness.processes import Processes
from harness.samples import Contender, Tick, flat, in_turns, pair_ratios
from recorder.recorded_hosts import SECONDS, Cost, cost_of, teams

CALLS, WARM_UP, SIZE = 300, 20, 64
_HERE = Path(__file__).parent
_HOP = _HERE.with_name("hops") / "hop.L"
WITHOUT, WITH = "without a recorder", "with a recorder"
#: Seconds for making and using a recording of an hour.
_TIMEOUT = 900.0


def _rows(checkout: Checkout, rounds: int, tick: Tick) -> Iterator[Row]:
    yield from _hops(checkout, rounds, tick)
    with Processes() as processes:
        for case, team in teams(processes).items():
            costs: dict[str, list[Cost]] = {WITHOUT: [], WITH: []}
            for number in range(2):
                for name in costs if number % 2 == 0 else reversed(costs):
                    tick(f"{case}, {name}")
                    records = processes.folder() if name == WITH else None
                    costs[name].append(cost_of(checkout, team, records))
            yield from _team_rows(case, costs)
    tick("a recording of one hour")
    with Processes() as processes:
        found = json.loads(checkout.run(processes, str(_HERE / "one_hour.py")).line(_TIMEOUT))
    for case, samples in found.items():
        unit = BYTES if case.endswith(": size") else TIMES if "times" in case else "s"
        yield Row(case, "", unit, samples, target="1 s" if "first step back" in case else "")


def _team_rows(case: str, costs: dict[str, list[Cost]]) -> Iterator[Row]:
    label = f"{case}: processor of a host"
    for name, found in costs.items():
        yield Row(label, name, PERCENT, [each.processor for each in found])
        label = ""
    yield Row("", f"bytes a minute, {WITH}", BYTES, [each.bytes_a_minute for each in costs[WITH]])
    if any(each.hops for each in costs[WITH]):
        for name, found in costs.items():
            yield Row("", f"hops a second, {name}", COUNT, [round(each.hops) for each in found])


def _hops(checkout: Checkout, rounds: int, tick: Tick) -> Iterator[Row]:
    with Processes() as processes:

        def opener(name: str) -> Contender:
            agents = (
                f"//Post:near@a?{CALLS // 2}",
                f"//Post:far@b?{CALLS // 2}",
                f"//Traveller:traveller@a?{CALLS}&{WARM_UP}&{SIZE}",
            )
            options = ("--record", str(processes.folder())) if name == WITH else ("--no-record",)
            return paced_mission(checkout, processes, _HOP, agents, options=options)

        samples, errors = in_turns(
            {WITHOUT: partial(opener, WITHOUT), WITH: partial(opener, WITH)}, rounds, tick
        )
    yield from (Row("a hop", name, error=error) for name, error in errors.items())
    label = "a hop"
    for name, of_case in samples.items():
        for found in of_case.values():
            yield Row(label, name, samples=flat(found))
            label = ""
    for case in samples.get(WITH, {}).keys() & samples.get(WITHOUT, {}).keys():
        ratios = pair_ratios(samples[WITH][case], samples[WITHOUT][case])
        yield Row("", "ratio of the medians of each round", TIMES, ratios, target="1.15x")


FIGURE = Figure(
    "The flight recorder: what it costs, and how fast its recordings are used",
    {},
    rounds=10,
    own_rows=_rows,
    one_size="a recording is as long as the mission",
    notes=(
        f"each team is measured for {SECONDS:g} s, twice with and twice without a recorder, in turns",
        "processor and bytes are of one host with its guards; bytes without the checkpoints, one a minute",
        "1,000 hops a second are attempted; the rows have the reached rate",
    ),
)
