"""How the cost of a find, and of a query, grows with the team: time, and the bytes of the coordinator.

What is asked for is offered directly, by an equivalence, by compositions of two and of three, or by teams of
two; or it is all proxies of a type. `growth` is how many times as much ten times as many agents cost.
"""

from __future__ import annotations

import gc
import math
from collections.abc import Callable, Iterator
from itertools import pairwise

from capability.growing_team import PROXIES, TEAMS, FirstHost, growing_mission
from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.number_text import TIMES
from harness.processes import Processes
from harness.samples import Contender

SIZES = 10, 100, 1_000, 3_000
_SAID = {
    PROXIES: "proxies",
    "Direct": "direct",
    "Equal": "equivalent",
    "Pair": "composed of two",
    "Trio": "composed of three",
    TEAMS: "teams of two",
}


def growing(kind: str, *, lively: bool, choosy: bool) -> Opener:
    """One question to teams of all sizes."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        hosts = {size: FirstHost(growing_mission(kind, size, lively), lively, choosy) for size in SIZES}
        for host in hosts.values():
            host.find()
        return lambda: dict(_measured(hosts, kind))

    return opener


def _measured(hosts: dict[int, FirstHost], kind: str) -> Iterator[tuple[str, list[float]]]:
    yield from _grown("find", {size: _undisturbed(host.find) for size, host in hosts.items()})
    yield from _grown("memory", {size: host.memory() / 1024 for size, host in hosts.items()})
    if kind != PROXIES:
        asked = {size: _undisturbed(lambda h=host: h.query(kind)) for size, host in hosts.items()}
        yield from _grown("query", asked)


def _undisturbed(ask: Callable[[], float]) -> float:
    """The best of three."""
    gc.collect()
    return min(ask() for _ in range(3))


def _grown(verb: str, took: dict[int, float]) -> Iterator[tuple[str, list[float]]]:
    """What it took at each size, and how that grows."""
    for size, cost in took.items():
        yield _case(verb, size), [cost]
    for few, many in pairwise(SIZES):
        yield _growth(verb, few, many), [(took[many] / took[few]) ** (1 / math.log10(many / few))]


def _case(what: str, size: int) -> str:
    return f"{_team(size)}: {what}"


def _team(size: int) -> str:
    return f"{size:,} agents"


def _growth(verb: str, few: int, many: int) -> str:
    return f"{verb}, growth from {few:,} to {many:,}"


_GROWTHS = [_growth(verb, few, many) for verb in ("find", "memory", "query") for few, many in pairwise(SIZES)]

FIGURE = Figure(
    "Finding and asking in a team that grows",
    {
        f"{said}, {'lively' if lively else 'still'}{', a condition' if choosy else ''}": growing(
            kind, lively=lively, choosy=choosy
        )
        for kind, said in _SAID.items()
        for lively in (False, True)
        for choosy in (False, True)
        if kind != PROXIES or not (lively or choosy)
    },
    rounds=3,
    units=dict.fromkeys(_GROWTHS, TIMES) | {_case("memory", size): "KiB" for size in SIZES},
    sizes={_team(size): size for size in SIZES},
    targets=dict.fromkeys(_GROWTHS, "15x") | {_case("find", 1_000): "5.00 ms"},
    notes=(
        "growth from one size to the next: per ten times as many agents, also from 1,000 to 3,000",
        "memory: all that lives in the block of the coordinator after the find, the answer with it",
        "query: what `lfield query` does once the hosts have answered, why others are not offered too",
        "times are of the processor, in one process: what else runs here does not count",
    ),
)
