"""The path of a mission: its positions, legs, length, and an estimate of its duration. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from msgspec import Struct

from lfield.driver import LocalPlane, PlanPoint
from lfield_mavlink.files.plan_file import NumberedItem, PlanFile
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.services.mission_check import HERE
from lfield_mavlink.services.mission_commands import LANDINGS, PLACED, TAKEOFFS, is_flown
from lfield_mavlink.services.plan_items import Item, command_name

#: m/s of a plan without speeds: QGroundControl's defaults of hover and cruise.
HOVER, CRUISE = 5.0, 15.0
#: Commands that wait parameter 1 seconds.
_WAITS = frozenset(
    {dialect.MAV_CMD_NAV_LOITER_TIME, dialect.MAV_CMD_NAV_DELAY, dialect.MAV_CMD_CONDITION_DELAY}
)
_RETURN, _SPEED = dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH, dialect.MAV_CMD_DO_CHANGE_SPEED


class PlanLeg(Struct, frozen=True):
    """A straight line to an item from the previous item, or from home."""

    start: PlanPoint
    end: PlanPoint


class PlanPath:
    """The path of a plan. `px4`: latitude and longitude 0 are a position."""

    def __init__(self, plan: PlanFile, *, px4: bool) -> None:
        self._plan, self._px4 = plan, px4
        home = plan.home
        self.home = None if home is None else PlanPoint(0, (home.latitude, home.longitude), 0.0, "home")
        #: By item number.
        self._by_item: dict[int, PlanPoint] = {}
        self.points = list(self._positions())
        origin = self.home or next(iter(self.points), None)
        self.plane = LocalPlane(*(origin.position if origin is not None else (0.0, 0.0)))

    def _positions(self) -> Iterator[PlanPoint]:
        previous = self.home
        for numbered in self._plan.items:
            item = numbered.item
            if not is_flown(item.command) or not (item.command in PLACED or item.command == _RETURN):
                continue
            point = self._point(numbered, previous)
            if point is not None:
                self._by_item[numbered.number] = previous = point
                yield point

    def _point(self, numbered: NumberedItem, previous: PlanPoint | None) -> PlanPoint | None:
        item, meaning = numbered.item, _meaning(numbered.item)
        if item.command == _RETURN:
            return (
                None if self.home is None else PlanPoint(numbered.number, self.home.position, None, meaning)
            )
        height = self.height(item)
        if HERE in (item.x, item.y) or (not self._px4 and not (item.x or item.y)):
            return (
                None if previous is None else PlanPoint(numbered.number, previous.position, height, meaning)
            )
        return PlanPoint(numbered.number, (item.x / 1e7, item.y / 1e7), height, meaning)

    def height(self, item: Item) -> float | None:
        """Metres above home; None if unknown."""
        if not math.isfinite(item.z):
            return None
        if item.above_home:
            return item.z
        if item.above_sea and self._plan.home is not None:
            return item.z - self._plan.home.altitude
        return None

    @property
    def legs(self) -> Iterator[PlanLeg]:
        """The legs in order, then those of the jumps."""
        previous = self.home
        for point in self.points:
            if previous is not None:
                yield PlanLeg(previous, point)
            previous = point
        yield from self._jumps()

    def _jumps(self) -> Iterator[PlanLeg]:
        numbers = sorted(self._by_item)
        for numbered in self._plan.items:
            if numbered.item.command != dialect.MAV_CMD_DO_JUMP:
                continue
            earlier = [number for number in numbers if number < numbered.number]
            later = [number for number in numbers if number >= numbered.item.parameters[0]]
            if earlier and later:
                yield PlanLeg(self._by_item[earlier[-1]], self._by_item[later[0]])

    def metres(self, leg: PlanLeg) -> float:
        """The length of a leg; an unknown height counts as unchanged."""
        start, end = self.plane.points([leg.start.position, leg.end.position])
        rise = 0.0
        if leg.start.height is not None and leg.end.height is not None:
            rise = leg.end.height - leg.start.height
        return math.hypot(end[0] - start[0], end[1] - start[1], rise)

    def length(self) -> float:
        """Metres of the whole path, without jumps."""
        return sum(self.metres(leg) for leg in self._direct_legs())

    def duration(self, kind: str, limit: float) -> float:
        """An estimate in seconds at the speeds of the file: without acceleration, wind and jumps."""
        plan = self._plan
        planned = plan.hover_speed if kind == "copter" else plan.cruise_speed
        speed = planned if planned and planned > 0.0 else HOVER if kind == "copter" else CRUISE
        legs = {leg.end.item: leg for leg in self._direct_legs()}
        seconds = 0.0
        for numbered in plan.items:
            first, second = numbered.item.parameters[:2]
            if numbered.item.command == _SPEED and first in (0.0, 1.0) and second > 0.0:
                speed = second
            if numbered.number in legs:
                seconds += self.metres(legs[numbered.number]) / min(speed, limit)
            if numbered.item.command in _WAITS or (
                kind == "copter" and numbered.item.command == dialect.MAV_CMD_NAV_WAYPOINT
            ):
                seconds += first if 0.0 < first < math.inf else 0.0
        return seconds

    def _direct_legs(self) -> Iterator[PlanLeg]:
        previous = self.home
        for point in self.points:
            if previous is not None:
                yield PlanLeg(previous, point)
            previous = point

    def highest(self) -> tuple[float, int] | None:
        """Metres above home, and the item."""
        heights = [(point.height, point.item) for point in self.points if point.height is not None]
        return max(heights, default=None, key=lambda entry: entry[0])

    def farthest(self) -> tuple[float, int] | None:
        """Metres from home, and the item; None without a home."""
        if self.home is None or not self.points:
            return None
        return max(((self.from_home(point), point.item) for point in self.points), key=lambda entry: entry[0])

    def from_home(self, point: PlanPoint) -> float:
        """Metres from home, or from the first item without a home."""
        return math.hypot(*self.plane.point(point.position))


def lands(item: Item) -> bool:
    """Whether an item is a landing, which may be below home."""
    return item.command in LANDINGS


def _meaning(item: Item) -> str:
    if item.command in TAKEOFFS:
        return "takeoff"
    if item.command in LANDINGS:
        return "land"
    if item.command == _RETURN:
        return "return"
    return (
        "" if item.command == dialect.MAV_CMD_NAV_WAYPOINT else command_name(item.command).partition(" ")[0]
    )


def placed_items(items: Sequence[NumberedItem]) -> Iterator[NumberedItem]:
    """Items that the vehicle moves to."""
    return (
        numbered for numbered in items if numbered.item.command in PLACED and is_flown(numbered.item.command)
    )
