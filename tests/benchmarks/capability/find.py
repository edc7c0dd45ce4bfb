"""A find of a capability from L, with a condition of five parts that all agents of a team fulfil."""

from __future__ import annotations

import random
from pathlib import Path

from harness.checkout import Checkout, Mission
from harness.figure import Figure, Opener
from harness.paced import Paced
from harness.processes import Processes
from harness.samples import Contender

QUERIES = 5

_REGISTRY = """
registry: 1
providers:
  Crane: {attributes: {environment: [terrestrial], battery: 0.9}, serves: {Lift: {}}}
agents:
"""


def asking(count: int) -> Opener:
    """A team of so many cranes on one host."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        chance = random.Random(1)
        mission = Mission(
            processes.folder(),
            Path(__file__).with_suffix(".L").read_text(encoding="utf-8"),
            [*(f"//Crane:crane{i}@here" for i in range(count)), f"//Boss:boss@here?{QUERIES}"],
        )
        own = "  crane%d: {payload: %.2f, reach: %.2f, mass: %.2f}\n"
        draws = [(i, chance.uniform(2, 9), chance.uniform(1, 3), chance.uniform(5, 50)) for i in range(count)]
        registry = _REGISTRY + "".join(own % drawn for drawn in draws)
        mission.deploy.with_suffix(".capabilities.yaml").write_text(registry, encoding="utf-8")
        return Paced(mission.up(checkout, processes))

    return opener


FIGURE = Figure(
    "A find of a capability from L",
    {f"among {count} agents": asking(count) for count in (250, 1000)},
    sizes={f"among {count} agents": count for count in (250, 1000)},
    targets={"among 1000 agents": "5.00 ms"},
    notes=(f"rounds of {QUERIES} queries, a condition of 5 parts that all agents fulfil",),
    between=("among 250 agents",),
)
