"""Quantiles of samples."""

from __future__ import annotations

from collections.abc import Iterable


def percentile(samples: Iterable[float], percent: float) -> float:
    """The smallest sample that so many percent of them do not exceed. Raises ValueError without samples."""
    ordered = sorted(samples)
    if not ordered:
        raise ValueError("there are no samples")
    return ordered[min(len(ordered) - 1, int(len(ordered) * percent / 100))]


def median(samples: Iterable[float]) -> float:
    """The 50th percentile."""
    return percentile(samples, 50)
