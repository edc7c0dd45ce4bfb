"""Uploaded plans of a vehicle: mission and fence.

Item numbers are those of the list: with ArduPilot item 0 is home and is not flown.
"""

from __future__ import annotations

from typing import Protocol

from msgspec import Struct, field

from lfield_sim.autopilot.body.goals import Vector

#: No item was reached yet.
NO_ITEM = 65535
#: FENCE_BREACH.
NO_BREACH, CEILING, BOUNDARY = 0, 2, 3


class MissionItem(Struct, frozen=True):
    """One item: its MAV_CMD, its seven values, and its position in the local frame (None: without one)."""

    command: int
    values: tuple[float, ...]
    place: Vector | None = None


class Mission(Struct):
    """The items, and their progress.

    `started` is the index of the started item, -1 for none; `arrived` is when its position was reached, in
    seconds; `height` is the down to which it returns after it has released a payload; `jumps` counts each
    DO_JUMP; `last_reached` is NO_ITEM before the first. `curve` are the remaining points of a curve, `leg` is
    the start of the previous leg, None when it ended at rest.
    """

    items: list[MissionItem] = field(default_factory=list)
    current: int = 0
    started: int = -1
    arrived: float | None = None
    height: float = 0.0
    jumps: dict[int, int] = field(default_factory=dict)
    last_reached: int = NO_ITEM
    curve: list[Vector] = field(default_factory=list)
    leg: Vector | None = None
    _reached: list[int] = field(default_factory=list)

    @property
    def item(self) -> MissionItem | None:
        """The current item; None past the end."""
        return self.items[self.current] if 0 <= self.current < len(self.items) else None

    def jump(self, index: int) -> bool:
        """Makes an item current; False for an unknown number."""
        if not 0 <= index < len(self.items):
            return False
        self.current, self.started, self.arrived = index, -1, None
        self.curve, self.leg = [], None
        return True

    def restart(self) -> None:
        """Resets the progress for a new mission."""
        self.last_reached = NO_ITEM
        self.jumps.clear()
        self.jump(0)

    def change(self, items: list[MissionItem]) -> bool:
        """Replaces the items in flight; returns whether the current one has changed."""
        before, self.items = self.item, items
        if self.item is None or self.item == before:
            return False
        self.started, self.arrived, self.curve = -1, None, []
        return True

    def reach(self) -> None:
        """Completes the current item."""
        self._reached.append(self.current)
        self.last_reached = self.current
        self.current, self.started, self.arrived = self.current + 1, -1, None

    def add_reached(self, index: int) -> None:
        """Reports a reached item."""
        self._reached.append(index)

    def pop_reached(self) -> list[int]:
        """The items reached since the last call."""
        reached, self._reached = self._reached[-1000:], []
        return reached


class Fence(Protocol):
    """An uploaded fence."""

    def breached(self, place: Vector) -> int:
        """The FENCE_BREACH type of a position in the local frame, 0 for none."""


class NoFence:
    """No fence is uploaded."""

    def breached(self, place: Vector) -> int:
        """The FENCE_BREACH type without a fence: always 0."""
        return NO_BREACH
