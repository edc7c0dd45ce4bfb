"""What was uploaded to a vehicle: the mission it flies, and the fence it keeps to.

The numbers of a mission's items are those of the list: with ArduPilot item 0 is home and is not flown.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from lfield_sim.autopilot.body.goals import Vector

#: Of a mission none of whose items was reached yet.
NO_ITEM = 65535
#: FENCE_BREACH.
NO_BREACH, CEILING, BOUNDARY = 0, 2, 3


@dataclass(frozen=True, slots=True)
class MissionItem:
    """One item: its MAV_CMD, its seven values, and its place in the local frame (None: it has none)."""

    command: int
    values: tuple[float, ...]
    place: Vector | None = None


@dataclass(slots=True)
class Mission:
    """The items and how far they are flown.

    `begun` is the index whose flight has begun, -1 for none; `arrived` is when its place was reached, in
    seconds; `height` is the down to which it returns after it has put down a payload; `jumps` counts how
    often each DO_JUMP was taken; `last_reached` is NO_ITEM before the first. `curve` are the points of a
    curve that are still to be flown, `leg` is where the leg before began, None when it ended at rest.
    """

    items: list[MissionItem] = field(default_factory=list)
    current: int = 0
    begun: int = -1
    arrived: float | None = None
    height: float = 0.0
    jumps: dict[int, int] = field(default_factory=dict)
    last_reached: int = NO_ITEM
    curve: list[Vector] = field(default_factory=list)
    leg: Vector | None = None
    _reached: list[int] = field(default_factory=list)

    @property
    def item(self) -> MissionItem | None:
        """What is being flown; None past the end."""
        return self.items[self.current] if 0 <= self.current < len(self.items) else None

    def jump(self, index: int) -> bool:
        """Make an item the current one; False when there is none of this number."""
        if not 0 <= index < len(self.items):
            return False
        self.current, self.begun, self.arrived = index, -1, None
        self.curve, self.leg = [], None
        return True

    def begin_again(self) -> None:
        """It is a new one."""
        self.last_reached = NO_ITEM
        self.jumps.clear()
        self.jump(0)

    def change(self, items: list[MissionItem]) -> bool:
        """Other items take their place while it is flown; whether the one under way is another one."""
        before, self.items = self.item, items
        if self.item is None or self.item == before:
            return False
        self.begun, self.arrived, self.curve = -1, None, []
        return True

    def reach(self) -> None:
        """The current item is done; on to the next."""
        self._reached.append(self.current)
        self.last_reached = self.current
        self.current, self.begun, self.arrived = self.current + 1, -1, None

    def tell(self, index: int) -> None:
        """Say that an item was reached, whatever is flown."""
        self._reached.append(index)

    def take_reached(self) -> list[int]:
        """Which items were reached since the last call."""
        reached, self._reached = self._reached[-1000:], []
        return reached


class Fence(Protocol):
    """Where a vehicle may be, as far as it was uploaded."""

    def breached(self, place: Vector) -> int:
        """A FENCE_BREACH type, 0 for none, of a place in the local frame."""


class NoFence:
    """No fence was uploaded."""

    def breached(self, place: Vector) -> int:
        """Never."""
        return NO_BREACH
