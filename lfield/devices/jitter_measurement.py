"""Measures the scheduling jitter of this computer at startup: the shell of `scheduling_jitter`."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

from lfield.clock import Clock
from lfield.devices.scheduling_jitter import JitterLimit, JitterMonitor
from lfield.driver.binding import SIMULATED, DeviceBinding
from lfield.errors import DevicesError

#: Seconds per measurement, and between two of its timers.
SPAN, STEP = 1.0, 0.01
#: The maximum number of measurements until one is good enough. A computer that has just booted, or that
#: starts several hosts, is late once; a computer that is too slow for its bindings is late each time.
TRIES = 3


async def measure_jitter(limit: JitterLimit, clock: Clock) -> float:
    """Jitter of this loop's timers in seconds: the maximum of the best measurement."""
    best = await _longest(limit, clock)
    for _ in range(TRIES - 1):
        if best <= limit.max_jitter:
            break
        best = min(best, await _longest(limit, clock))
    return best


async def _longest(limit: JitterLimit, clock: Clock) -> float:
    lateness = JitterMonitor(limit)
    start = clock.monotonic()
    while (now := clock.monotonic()) < start + SPAN:
        await asyncio.sleep(STEP)
        lateness.sample(now + STEP, clock.monotonic())
    return lateness.longest


async def require_timely(limit: JitterLimit, devices: Iterable[DeviceBinding], clock: Clock) -> None:
    """Raises DevicesError if this computer's jitter is too large for its bindings; simulated devices have no
    requirement.
    """
    if all(device.endpoint.startswith(SIMULATED) for device in devices):
        return
    late = await measure_jitter(limit, clock)
    if late > limit.max_jitter:
        raise DevicesError([f"{limit.report(late)}: {limit.remedy(late)}"])
