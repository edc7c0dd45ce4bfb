"""The cost for a host of reporting events: one event, and hops and portal calls with an observer."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from harness.checkout import Checkout, Mission
from harness.figure import Figure, Row
from harness.number_text import TIMES
from harness.paced import Paced
from harness.processes import Processes
from harness.samples import Contender, Tick, flat, in_turns, pair_ratios

CALLS, WARM_UP, SIZE = 300, 20, 64
_HERE = Path(__file__).parent
HOPS = _HERE.with_name("hops")
UNWATCHED, WATCHED = "no observer", "both hosts are observed"


def _mission(processes: Processes, name: str) -> Mission:
    arguments = f"{CALLS}&{WARM_UP}&{SIZE}"
    agents = {
        "hop": (
            f"//Post:near@a?{CALLS // 2}",
            f"//Post:far@b?{CALLS // 2}",
            f"//Traveller:traveller@a?{arguments}",
        ),
        "local": ("//Store:store@a", "//Caller:caller@a?10&200&10"),
    }[name]
    return Mission(processes.folder(), (HOPS / f"{name}.L").read_text(encoding="utf-8"), agents)


def _team(checkout: Checkout, processes: Processes, name: str, *, watched: bool) -> Contender:
    mission = _mission(processes, name)
    children = mission.up(checkout, processes)
    if not watched:
        return Paced(children)
    places = [f"{host}={address}" for host, address in mission.addresses.items()]
    observer = checkout.run(processes, str(_HERE / "watching.py"), *places)
    assert observer.line() == "watching"
    return Paced([*children, observer])


def _rows(checkout: Checkout, rounds: int, tick: Tick) -> Iterator[Row]:
    with Processes() as processes:
        costs = checkout.run(processes, str(_HERE / "event_costs.py")).line(120.0)
        for case, (unit, samples) in json.loads(costs).items():
            yield Row(case, "", unit, samples)
    for name, measured in (("hop", "a hop"), ("local", "a local portal call")):
        yield from _side_by_side(checkout, rounds, tick, name, measured)


def _side_by_side(checkout: Checkout, rounds: int, tick: Tick, name: str, measured: str) -> Iterator[Row]:
    with Processes() as processes:

        def opener(watched: bool) -> Contender:
            return _team(checkout, processes, name, watched=watched)

        samples, errors = in_turns(
            {UNWATCHED: lambda: opener(False), WATCHED: lambda: opener(True)}, rounds, tick
        )
    for case in samples.get(UNWATCHED, {}):
        label = f"{measured}: {case}"
        for contender, of_case in samples.items():
            yield Row(label, contender, samples=flat(of_case[case]))
            label = ""
        yield Row("", "ratio", TIMES, pair_ratios(samples[WATCHED][case], samples[UNWATCHED][case]))
    yield from (Row(measured, contender, error=error) for contender, error in errors.items())


FIGURE = Figure(
    "Events: the cost of recording them, and of an observer",
    {},
    rounds=8,
    own_rows=_rows,
    one_size="events have one size",
    notes=(f"rounds of {CALLS} hops, two hosts as processes; the observer receives telemetry at 5 Hz",),
)
