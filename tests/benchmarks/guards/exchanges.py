"""Batches of exchanges on a bus; a sample is the mean of a batch."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable

BATCHES, EXCHANGES = 5, 100


def batches(exchange: Callable[[], object]) -> list[float]:
    """Seconds of an exchange."""
    samples = []
    for _ in range(BATCHES):
        start = time.perf_counter()
        for _ in range(EXCHANGES):
            exchange()
        samples.append((time.perf_counter() - start) / EXCHANGES)
    return samples


async def async_batches(exchange: Callable[[], Awaitable[object]]) -> list[float]:
    """Seconds of an exchange that is awaited."""
    samples = []
    for _ in range(BATCHES):
        start = time.perf_counter()
        for _ in range(EXCHANGES):
            await exchange()
        samples.append((time.perf_counter() - start) / EXCHANGES)
    return samples
