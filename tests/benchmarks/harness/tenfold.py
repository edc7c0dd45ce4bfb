"""How a cost grows with the size of what it is for: per ten times as much, by all sizes that were taken."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from harness.samples import Samples, median


class Series(NamedTuple):
    """Whose cost it is, and of what: the rounds of samples by size."""

    case: str
    name: str
    points: Mapping[float, Sequence[Sequence[float]]]


def series(samples: Samples, sizes: Mapping[str, float]) -> list[Series]:
    """Series of samples at several sizes; `sizes` are of cases, up to a colon, or of contenders."""
    found: dict[tuple[str, str], dict[float, Sequence[Sequence[float]]]] = {}
    for name, of_contender in samples.items():
        for case, rounds in of_contender.items():
            of_case, _, what = case.partition(": ")
            if of_case in sizes:
                found.setdefault((what, name), {})[sizes[of_case]] = rounds
            elif name in sizes:
                found.setdefault((case, ""), {})[sizes[name]] = rounds
    return [Series(case, name, points) for (case, name), points in found.items() if len(points) > 1]


def tenfold(points: Mapping[float, Sequence[Sequence[float]]]) -> list[float]:
    """By how much the cost is multiplied where the size is ten times as much, in each round.

    It is the line through the medians where both axes are logarithmic (least squares). A round that cost
    nothing at some size has no such line.
    """
    found = []
    for rounds in zip(*points.values(), strict=False):
        costs = [median(samples) for samples in rounds if samples]
        if len(costs) == len(points) and min(costs) > 0:
            found.append(10 ** _slope([math.log10(size) for size in points], [math.log10(c) for c in costs]))
    return found


def _slope(xs: Sequence[float], ys: Sequence[float]) -> float:
    x, y = sum(xs) / len(xs), sum(ys) / len(ys)
    return sum((a - x) * (b - y) for a, b in zip(xs, ys, strict=True)) / sum((a - x) ** 2 for a in xs)
