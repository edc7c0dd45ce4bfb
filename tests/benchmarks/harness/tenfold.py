"""The growth of a cost with the size: the factor for ten times the size, from all measured sizes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from harness.samples import Samples, median


class Series(NamedTuple):
    """The rounds of samples by size, of one cost of one contender."""

    case: str
    name: str
    points: Mapping[float, Sequence[Sequence[float]]]


def series(samples: Samples, sizes: Mapping[str, float]) -> list[Series]:
    """Series of samples at several sizes; keys of `sizes` are cases, up to a colon, or contenders."""
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
    """The factor of the cost for ten times the size, in each round.

    Computed from the least-squares line through the medians on logarithmic axes. A round with a cost of zero
    has no such line.
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
