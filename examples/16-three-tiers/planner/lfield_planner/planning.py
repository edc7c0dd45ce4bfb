"""The planner: selects and orders sites by the optimiser HiGHS.

Independent of lfield: any program that answers a line by a line can replace it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

import highspy

Place = Sequence[float]

#: Time limit of the optimiser in seconds, and a tolerance in metres.
TIME_LIMIT, TOLERANCE = 60.0, 1e-6


def plan(sites: Sequence[Place], worth: Sequence[float], start: Place, reach: float) -> list[int]:
    """The sites to visit on a path of at most `reach` metres from `start` that ends at home, (0, 0).

    It maximises their total worth, then minimises the length. A mixed-integer program with a variable per
    leg, and one for the position of each site in the tour, which excludes subtours (Miller, Tucker and
    Zemlin). Raises ValueError when there is no such path.
    """
    first, home = len(sites), len(sites) + 1
    places = [*sites, start, (0.0, 0.0)]
    solver = _silent()
    legs = {(a, b): solver.addBinary() for a in range(home) for b in (*range(first), home) if a != b}
    turn = [solver.addVariable(0, home) for _ in places]
    length = sum(math.dist(places[a], places[b]) * chosen for (a, b), chosen in legs.items())
    solver.addConstr(length <= reach)
    solver.addConstr(sum(legs[first, b] for b in (*range(first), home)) == 1)
    for site in range(first):
        comes = sum(chosen for (_, b), chosen in legs.items() if b == site)
        goes = sum(chosen for (a, _), chosen in legs.items() if a == site)
        solver.addConstr(comes == goes)
        solver.addConstr(comes <= 1)
    for (a, b), chosen in legs.items():
        solver.addConstr(turn[b] >= turn[a] + 1 - (home + 1) * (1 - chosen))
    gained = sum(worth[b] * chosen for (_, b), chosen in legs.items() if b < first)
    # The total length weighs less than the least worth of a site.
    solver.maximize(gained - 0.5 * min(worth, default=1.0) / max(reach, 1.0) * length)
    if solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        raise ValueError(f"there is no way home of {reach:.1f} m")
    found = {a: b for (a, b), chosen in legs.items() if solver.val(chosen) > 0.5}
    tour = [found[first]]
    while tour[-1] != home:
        tour.append(found[tour[-1]])
    tour.pop()
    # From home, both directions are equivalent: choose one independently of the optimiser's version.
    return min(tour, tour[::-1]) if math.dist(start, places[home]) < TOLERANCE else tour


def _silent() -> highspy.Highs:
    solver = highspy.Highs()  # type: ignore[no-untyped-call]
    for option, value in (
        ("output_flag", False),
        ("threads", 1),
        ("time_limit", TIME_LIMIT),
        ("mip_rel_gap", 0.0),
    ):
        solver.setOptionValue(option, value)
    return solver


def answer(line: str) -> str:
    """The answer to a request, a line of JSON each: {"tour": [2, 0]} or {"error": "..."}."""
    try:
        asked = json.loads(line)
        return json.dumps({"tour": plan(asked["sites"], asked["worth"], asked["start"], asked["reach"])})
    except Exception as error:  # report it to the client and continue
        return json.dumps({"error": f"{type(error).__name__}: {error}"})
