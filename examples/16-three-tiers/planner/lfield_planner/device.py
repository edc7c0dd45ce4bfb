"""The device: instructions, telemetry, and checks of the planner's answers."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Awaitable, Callable, Sequence
from itertools import pairwise
from typing import Any

from lfield.driver import Device

#: Maximum number of sites, seconds between two heartbeats, and a tolerance in metres.
MAX_SITES, HEARTBEAT, TOLERANCE = 12, 1.0, 0.01

Place = Sequence[float]


class PlannerDevice(Device):
    """A planner: a pure sensor, which moves nothing."""

    def __init__(
        self, binding: Any, manifest: Any, clock: Any, reports: Any, ask: Callable[[str], Awaitable[str]]
    ) -> None:
        super().__init__(binding, manifest, clock, reports)
        self._ask = ask
        self._plans = self._failures = 0

    async def publish_contact(self, alive: Callable[[], bool]) -> None:
        """Reports contact and telemetry while the planner runs."""
        while True:
            if alive():
                self.heard()
            self.publish(plans=self._plans, failures=self._failures)
            await asyncio.sleep(HEARTBEAT)

    async def _open(self) -> str:
        self.heard()
        await self.do_tour([], [], [0.0, 0.0], 1.0)
        return "a planner that answers"

    async def do_tour(
        self, sites: list[float], worth: list[float], start: list[float], reach: float
    ) -> list[int]:
        """Sends a request line; waits at most `patience` seconds for the answer line."""
        places = list(zip(sites[::2], sites[1::2], strict=False))
        if len(sites) != 2 * len(worth) or len(start) != 2 or len(places) > MAX_SITES:
            raise self.error(
                f"a tour is of up to {MAX_SITES} sites, {{north, east}} each, a worth for each, and a start"
            )
        if not all(map(math.isfinite, (*sites, *worth, *start, reach))) or min(worth, default=1.0) <= 0.0:
            raise self.error("sites, start and reach must be finite, and the worth of a site above 0")
        request = {"sites": places, "worth": worth, "start": start, "reach": reach}
        self._failures += 1  # subtracted again after success
        try:
            tour = self._read(await self._ask_in_time(json.dumps(request)))
            if error := tour_error(tour, places, start, reach):
                raise self.error(f"its plan is invalid: {error}")
            self._plans, self._failures = self._plans + 1, self._failures - 1
            self.heard()
            return tour
        finally:
            self.publish(plans=self._plans, failures=self._failures)

    async def _ask_in_time(self, request: str) -> str:
        patience = self.binding.option("patience")
        try:
            async with asyncio.timeout(patience):
                return await self._ask(request)
        except TimeoutError:
            raise self.error(
                f"no plan within {patience:g} s; the request was cancelled", timeout=True
            ) from None

    def _read(self, answer: str) -> list[int]:
        try:
            reply = json.loads(answer)
        except ValueError:
            reply = None
        match reply:
            case {"tour": [*tour]} if all(type(site) is int for site in tour):
                return tour
            case {"error": str(reason)}:
                raise self.error(f"it failed: {reason[:200]}")
        raise self.error(f"its answer is invalid: {answer[:80]!r}")


def tour_error(tour: Sequence[int], sites: Sequence[Place], start: Place, reach: float) -> str:
    """The error of a tour from `start` to home, (0, 0), or '' for a valid tour."""
    unknown = next((site for site in tour if not 0 <= site < len(sites)), None)
    if unknown is not None:
        return f"there is no site {unknown}"
    if len(set(tour)) < len(tour):
        return f"it visits a site twice: {list(tour)}"
    path = [start, *(sites[site] for site in tour), (0.0, 0.0)]
    length = sum(math.dist(a, b) for a, b in pairwise(path))
    return "" if length <= reach + TOLERANCE else f"it is {length:.0f} m long, more than {reach:.0f} m"
