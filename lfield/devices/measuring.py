"""Measures how late this computer is, before anything depends on it: the shell beside `lateness`."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

from lfield.clock import Clock
from lfield.devices.lateness import Lateness, Limit
from lfield.driver.binding import SIMULATED, DeviceBinding
from lfield.errors import DevicesError

#: Seconds that a measurement takes, and between two of its timers.
SPAN, STEP = 1.0, 0.01
#: So many measurements are made until one is good enough. A computer that has just been started, or several
#: hosts that start on one desk, are late once; one that cannot keep its bindings is late each time.
TRIES = 3


async def measured(limit: Limit, clock: Clock) -> float:
    """By how much timers of this loop come late, in seconds: the longest of the best measurement."""
    best = await _longest(limit, clock)
    for _ in range(TRIES - 1):
        if best <= limit.allowed:
            break
        best = min(best, await _longest(limit, clock))
    return best


async def _longest(limit: Limit, clock: Clock) -> float:
    lateness = Lateness(limit)
    begun = clock.monotonic()
    while (now := clock.monotonic()) < begun + SPAN:
        await asyncio.sleep(STEP)
        lateness.sample(now + STEP, clock.monotonic())
    return lateness.longest


async def insist(limit: Limit, devices: Iterable[DeviceBinding], clock: Clock) -> None:
    """Raise DevicesError if this computer is too late for what its bindings say; fakes ask for nothing."""
    if all(device.endpoint.startswith(SIMULATED) for device in devices):
        return
    late = await measured(limit, clock)
    if late > limit.allowed:
        raise DevicesError([f"{limit.told(late)}: {limit.cure(late)}"])
