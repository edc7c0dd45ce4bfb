"""The planner: selects and orders sites with the optimiser HiGHS.

This module is independent of lfield. Any program that answers each line with a line can replace the planner.
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

    The tour has the maximum total worth and, among such tours, the minimum length. The mixed-integer program
    has a variable for each leg, and a variable for the position of each site in the tour, which excludes
    subtours (Miller, Tucker and Zemlin). Raises ValueError if there is no such path.
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
        arrivals = sum(chosen for (_, b), chosen in legs.items() if b == site)
        departures = sum(chosen for (a, _), chosen in legs.items() if a == site)
        solver.addConstr(arrivals == departures)
        solver.addConstr(arrivals <= 1)
    for (a, b), chosen in legs.items():
        solver.addConstr(turn[b] >= turn[a] + 1 - (home + 1) * (1 - chosen))
    total_worth = sum(worth[b] * chosen for (_, b), chosen in legs.items() if b < first)
    # The total length has less weight than the smallest worth of a site.
    solver.maximize(total_worth - 0.5 * min(worth, default=1.0) / max(reach, 1.0) * length)
    if solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        raise ValueError(f"there is no way home of {reach:.1f} m")
    successor = {a: b for (a, b), chosen in legs.items() if solver.val(chosen) > 0.5}
    tour = [successor[first]]
    while tour[-1] != home:
        tour.append(successor[tour[-1]])
    tour.pop()
    # From home, both directions are equivalent: choose one independently of the optimiser's version.
    return min(tour, tour[::-1]) if math.dist(start, places[home]) < TOLERANCE else tour


def _silent() -> highspy.Highs:
    solver = highspy.Highs()  # type: ignore[no-untyped-call]  # has no types
    for option, value in (
        ("output_flag", False),
        ("threads", 1),
        ("time_limit", TIME_LIMIT),
        ("mip_rel_gap", 0.0),
    ):
        solver.setOptionValue(option, value)
    return solver


def answer(line: str) -> str:
    """The answer to a request, each a line of JSON: {"tour": [2, 0]} or {"error": "..."}."""
    try:
        request = json.loads(line)
        tour = plan(request["sites"], request["worth"], request["start"], request["reach"])
        return json.dumps({"tour": tour})
    except Exception as error:  # report it to the client and continue
        return json.dumps({"error": f"{type(error).__name__}: {error}"})
