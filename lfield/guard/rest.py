"""Which devices of a guard have come to rest in their safe states, and when its stop is over.

A safe state that is confirmed is only begun: a vehicle that lands is in the air for a while. It is looked at
until it is at rest, as long as it is held. A stop is over when every device has been seen at rest, or its
own time is over, or somebody wants the end now; whether the host is there to hear of it changes nothing. Only
a bus that has been made quiet is not watched any longer: then the end comes with the safe states.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

#: Seconds between two looks at a device, and between two words about it on its way.
LOOK, TELL = 0.25, 0.5

#: What is said of a device that was not open in time, and of one whose safe state was commanded.
UNFINISHED = "it was still being set up"
UNSEEN = "its safe state was not seen"


@dataclass(slots=True)
class _Way:
    """A device: how long its stop may take, in seconds, and what is known of it.

    `confirmed_at` is None before its safe state was confirmed, `moving` before it was looked at in it. `told`
    is what the host knows.
    """

    within: float
    confirmed_at: float | None = None
    moving: str | None = None
    look_at: float | None = None
    told: str | None = None
    told_at: float = 0.0


class Rest:
    """The ways of a guard's devices to rest; `within` is how long each may take when stopping, in seconds."""

    def __init__(self, within: Mapping[str, float]) -> None:
        self._ways = {name: _Way(seconds) for name, seconds in within.items()}
        self._stopped_at: float | None = None
        self._alone = self._quiet = self._at_once = False

    # --- events ---------------------------------------------------------------------------------------

    def held(self, name: str) -> None:
        """A device is on its way into its safe state, or free: nothing is known of it."""
        way = self._ways[name]
        way.confirmed_at, way.moving, way.look_at, way.told = None, None, None, None

    def confirmed(self, name: str, now: float) -> None:
        """It has been seen in its safe state."""
        way = self._ways[name]
        way.confirmed_at, way.look_at = now, now

    def looked(self, name: str, moving: str, now: float) -> bool:
        """What it still does, '' for nothing; whether the host should be told."""
        way = self._ways[name]
        if way.confirmed_at is None:
            return False
        way.moving = moving
        due = way.told is None or not moving or now >= way.told_at + TELL
        if moving == way.told or not due:
            return False
        way.told, way.told_at = moving, now
        return True

    def stop(self, now: float) -> None:
        """The host wants to end."""
        if self._stopped_at is None:
            self._stopped_at = now

    def alone(self) -> None:
        """The host is gone."""
        self._alone = True

    def quiet(self, on: bool) -> None:
        """The bus has been made quiet, or not any more: what is on it may fall silent, too."""
        self._quiet = on

    def at_once(self) -> None:
        """Somebody does not want to wait any longer."""
        self._at_once = True

    # --- questions ------------------------------------------------------------------------------------

    def to_look_at(self, now: float) -> list[str]:
        """The devices to be looked at now; each is then due again after LOOK."""
        due = [name for name, way in self._ways.items() if way.look_at is not None and now >= way.look_at]
        for name in due:
            self._ways[name].look_at = now + LOOK
        return due

    def is_over(self, now: float) -> bool:
        """Whether the stop is over."""
        if self._stopped_at is None:
            return False
        return self._at_once or all(self._settled(way, now) for way in self._ways.values())

    def under_way_until(self) -> float:
        """When those that are confirmed and not at rest have had their time; minus infinity without any."""
        ends = (
            way.confirmed_at + way.within
            for way in self._ways.values()
            if way.confirmed_at is not None and way.moving != ""
        )
        return max(ends, default=-math.inf)

    def unsafe(self) -> dict[str, str]:
        """The devices that have not been seen at rest in their safe states, each with what is known."""
        found = {}
        for name, way in self._ways.items():
            if way.confirmed_at is None:
                found[name] = UNSEEN
            elif not self._rests(way):
                found[name] = f"it is in its safe state and not at rest: {way.moving or 'not looked at'}"
        return found

    def due(self) -> float | None:
        """When something is to be done again, on the clock of the events."""
        times = [way.look_at for way in self._ways.values() if way.look_at is not None]
        if self._stopped_at is not None:
            waited = [way.within for way in self._ways.values() if not self._rests(way)]
            times += [self._stopped_at + max(waited)] if waited else []
        return min(times, default=None)

    def _rests(self, way: _Way) -> bool:
        return way.confirmed_at is not None and (way.moving == "" or (self._alone and self._quiet))

    def _settled(self, way: _Way, now: float) -> bool:
        assert self._stopped_at is not None
        return self._rests(way) or now >= self._stopped_at + way.within
