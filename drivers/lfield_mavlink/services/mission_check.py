"""Checks where the items of a mission lead against the limits of a binding, by kind of item. Pure.

`mission_rules` assigns commands to kinds. https://mavlink.io/en/messages/common.html#mav_commands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from msgspec import Struct
from msgspec.structs import replace

from lfield.driver import DeviceError
from lfield_mavlink.geodesy import Place, Vector
from lfield_mavlink.limits import Limits
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.services.mission_commands import JUMPS, PLACED, has_command, is_flown
from lfield_mavlink.services.mission_paths import arc_corners, spline_corners
from lfield_mavlink.services.plan_items import Item, command_name

#: MISSION_ITEM_INT.x or y for "at the vehicle's position".
HERE = 0x7FFFFFFF


class Climb(Struct, frozen=True):
    """The height of a return: `height` above its destination, after a climb by at least `minimum`; metres,
    with parameter names.
    """

    height: float
    name: str
    minimum: float = 0.0
    minimum_name: str = ""


class Situation(Struct, frozen=True):
    """Data of the vehicle for the check of its mission.

    `home` and `position` (metres of home) are None while unknown. `loiter` is the default radius of a circle
    in metres, `climb` the height of a return; None if unknown. `rally` are its rally points. `starts_here`:
    the mission starts now at the vehicle's position. `first_number` is the number of the first item in
    messages and jumps; None for a vehicle: messages count from 0, jumps as its autopilot does.
    """

    kind: str
    px4: bool
    home: Place | None
    position: Vector | None
    loiter: float | None = None
    climb: Climb | None = None
    rally: Sequence[Item] = ()
    starts_here: bool = False
    first_number: int | None = None

    @property
    def first_target(self) -> int:
        """The number of the first item in jumps."""
        if self.first_number is not None:
            return self.first_number
        return 0 if self.px4 else 1


class MissionCheck:
    """Checks one mission against the limits. `error` creates the exception for a reason."""

    def __init__(
        self,
        subject: str,
        items: Sequence[Item],
        limits: Limits,
        error: Callable[[str], DeviceError],
        situation: Situation,
    ) -> None:
        self._prefix = f"{subject}: " if subject else ""
        self._items, self._limits, self._error = items, limits, error
        self._situation = situation
        self._path: list[tuple[int, Vector]] | None = None

    # -- structure ----------------------------------------------------------------------------------------

    def structure(self, number: int, item: Item) -> None:
        """Raises DeviceError when an item is invalid regardless of limits."""
        if item.command in PLACED:
            self._check_place(number, item)
        first = self._situation.first_target
        jumps = (dialect.MAV_CMD_DO_JUMP, dialect.MAV_CMD_DO_SET_MISSION_CURRENT)
        target = item.parameters[0]
        # NaN is in no range.
        if item.command in jumps and not (first <= target < len(self._items) + first and target % 1 == 0):
            raise self._error_for(
                number, item, f"there is no item {item.parameters[0]:g} as target of the jump"
            )
        if item.command == dialect.MAV_CMD_DO_JUMP_TAG and not any(
            other.command == dialect.MAV_CMD_JUMP_TAG and other.parameters[0] == item.parameters[0]
            for other in self._items
        ):
            raise self._error_for(
                number, item, f"there is no tag {item.parameters[0]:g} as target of the jump"
            )

    def _check_place(self, number: int, item: Item) -> None:
        is_beyond = (item.x != HERE and abs(item.x) > 900_000_000) or (
            item.y != HERE and abs(item.y) > 1_800_000_000
        )
        if (item.x == HERE) != (item.y == HERE):
            raise self._error_for(number, item, "one of latitude and longitude is missing")
        if is_beyond or math.isinf(item.z):
            raise self._error_for(
                number,
                item,
                f"{item.x / 1e7:g}, {item.y / 1e7:g} at {item.z:g} m is not a position on the Earth",
            )

    # -- rules: `mission_rules` maps commands to them --------------------------------------------------

    def allow(self, number: int, item: Item) -> None:
        """Permits an item without motion."""

    def refuse(self, number: int, item: Item) -> None:
        """Refuses an item with an unknown effect, or that gives control to another controller without
        limits.
        """
        raise self._error_for(
            number, item, "its position, height, speed or home is not known to stay within the limits"
        )

    def goal(self, number: int, item: Item) -> None:
        """Checks a target position."""
        self._check_goal(number, item)

    def waypoint(self, number: int, item: Item) -> None:
        """Checks a target position, or one passed at a distance (parameter 3)."""
        self._check_goal(number, item, 0.0 if math.isnan(item.parameters[2]) else abs(item.parameters[2]))

    def land(self, number: int, item: Item) -> None:
        """Checks a landing; it may go around at a height above home (parameter 1 of NAV_LAND)."""
        self._check_goal(number, item, sinks=True)
        self._check_height(number, item, item.parameters[0])

    def vtol_land(self, number: int, item: Item) -> None:
        """Checks a landing from a height in parameter 3, in the frame of the item."""
        self._check_goal(number, item, sinks=True)
        approach = item.parameters[2]
        if approach and not math.isnan(approach):
            self._check_height(number, item, self._above_home(item, approach))

    def loiter(self, number: int, item: Item) -> None:
        """Checks a circle for fixed wings, and for all vehicles with LOITER_TURNS."""
        self._check_goal(number, item, self._circle(item, item.parameters[2]))

    def loiter_to_height(self, number: int, item: Item) -> None:
        """Checks a circle with a change of height."""
        self._check_goal(number, item, self._circle(item, item.parameters[1]))

    def orbit(self, number: int, item: Item) -> None:
        """Checks a circle with a radius (parameter 1) and a speed (parameter 2)."""
        self._check_goal(number, item, abs(item.parameters[0]))
        self._check_speed(number, item, item.parameters[1])

    def reposition(self, number: int, item: Item) -> None:
        """Checks a goal with a speed (parameter 1; -1 keeps it); fixed wings circle it (parameter 3)."""
        self._check_goal(number, item, self._circle(item, item.parameters[2]))
        if item.parameters[0] != -1.0:
            self._check_speed(number, item, item.parameters[0])

    def climb_on(self, number: int, item: Item) -> None:
        """Checks a climb straight ahead up to a height: the distance is unknown."""
        if self._limits.bounds_radius:
            self.refuse(number, item)
        self._check_height(number, item, self._above_home(item, item.z))

    def height(self, number: int, item: Item) -> None:
        """Checks a height in parameter 7."""
        self._check_height(number, item, self._above_home(item, item.z))

    def change_altitude(self, number: int, item: Item) -> None:
        """Checks a height in parameter 1, in the frame of parameter 2."""
        height, frame = item.parameters[:2]
        framed = Item(item.command, int(frame) if 0 <= frame < 256 else -1, 0, 0)
        self._check_height(number, item, self._above_home(framed, height))

    def spline(self, number: int, item: Item) -> None:
        """Checks a curve that extends beyond its positions."""
        self._check_goal(number, item)
        for start, before in self._curve_starts(number, item):
            goal, after = self._position(item), self._next_position(number)
            for corner in spline_corners(before, start, goal, after):
                self._limits.check_goal(
                    f"{self._prefix}the curve of item {self._item_number(number)}", corner
                )

    def arc(self, number: int, item: Item) -> None:
        """Checks an arc from the previous position to this one; parameter 1 is its angle in degrees."""
        self._check_goal(number, item)
        for start, _ in self._curve_starts(number, item):
            corners = arc_corners(start, self._position(item), item.parameters[0])
            if corners is None:
                raise self._error_for(number, item, f"there is no arc of {item.parameters[0]:g} degrees")
            for corner in corners:
                self._limits.check_goal(f"{self._prefix}the arc of item {self._item_number(number)}", corner)

    def speed(self, number: int, item: Item) -> None:
        """Checks airspeed (0) and ground speed (1), not climb (2) and descent (3).

        A rover uses each of them as its speed. -1 keeps the speed. A throttle (parameter 3) gives an unknown
        speed to vehicles other than copters.
        """
        kind, speed, throttle = item.parameters[:3]
        climbs = kind in (2.0, 3.0)
        if (climbs and self._situation.kind != "rover") or not self._limits.bounds_speed:
            return
        if not (climbs or kind in (0.0, 1.0)) or (throttle > 0.0 and self._situation.kind != "copter"):
            self.refuse(number, item)
        if speed != -1.0:
            self._check_speed(number, item, speed)

    def set_home(self, number: int, item: Item) -> None:
        """Refuses a change of home, since the limits are relative to it."""
        if self._limits.bound_places:
            raise self._error_for(number, item, "it changes home, which the limits refer to")

    def return_home(self, number: int, item: Item) -> None:
        """Checks a return to home, or to a rally point, at the autopilot's own height."""
        if self._limits.bounds_heights and self._situation.kind != "rover":
            climb = self._situation.climb
            if climb is None:
                raise self._error_for(number, item, "the height of its return is not known")
            self._limits.check_return(
                f"{self._prefix}item {self._item_number(number)}", climb.height, climb.name
            )
            if climb.minimum:
                highest = max((-place[2] for _, place in self._places()), default=0.0)
                self._limits.check_return(
                    f"{self._prefix}item {self._item_number(number)}",
                    highest + climb.minimum,
                    climb.minimum_name,
                )
        for index, point in enumerate(self._situation.rally):
            self.rally_point(index, point)

    def rally_point(self, number: int, item: Item) -> None:
        """Checks a destination of a return; PX4's heights of a return are relative to its destination."""
        if self._situation.px4 and self._situation.climb is not None:
            item = replace(item, z=item.z + self._situation.climb.height)
        self._check_goal(number, item, subject=f"{self._prefix}rally point {number}")

    def fence(self, number: int, item: Item) -> None:
        """Refuses to disable the autopilot's own fence, the protection for a failure of this computer."""
        if not item.parameters[0] >= 1.0:
            raise self._error_for(number, item, "it disables the autopilot's own fence")

    def guided_limits(self, number: int, item: Item) -> None:
        """Checks bounds for an external controller: a height above sea level (3), a distance (4), 0 for
        none.
        """
        highest, farthest = item.parameters[2:4]
        if highest and self._situation.home is not None:
            self._check_height(number, item, highest - self._situation.home.altitude)
        if farthest:
            self._limits.check_goal(f"{self._prefix}item {self._item_number(number)}", (farthest, 0.0, 0.0))

    # -- steps --------------------------------------------------------------------------------------------

    def _check_goal(
        self, number: int, item: Item, extent: float = 0.0, *, sinks: bool = False, subject: str = ""
    ) -> None:
        if not self._limits.bound_places:
            return
        height = 0.0
        if self._limits.bounds_heights and self._situation.kind != "rover":
            item_height = self._above_home(item, item.z)
            if item_height is None and not sinks:
                raise self._error_for(number, item, "the height of this item is not known")
            height = 0.0 if item_height is None else item_height
        offset = self._offset(number, item)
        if offset is None and extent and self._limits.bounds_radius:
            raise self._error_for(number, item, "it circles its position at that time, which is not known")
        north, east = offset or (0.0, 0.0)
        label = subject or f"{self._prefix}waypoint {self._item_number(number)}"
        self._limits.check_goal(label, (north, east, -height), extent if self._limits.bounds_radius else 0.0)

    def _offset(self, number: int, item: Item) -> tuple[float, float] | None:
        """Metres north and east of home; None for the vehicle's position at that time."""
        home = self._home
        if not (item.above_home or item.above_sea or item.above_terrain):
            raise self._error_for(number, item, f"the position of an item in frame {item.frame} is not known")
        if HERE in (item.x, item.y) or (not self._situation.px4 and not (item.x or item.y)):
            return None
        north, east, _ = home.vector_to(Place(item.x / 1e7, item.y / 1e7, home.altitude))
        return north, east

    def _item_number(self, number: int) -> int:
        """The number of an item in messages."""
        return number + (self._situation.first_number or 0)

    @property
    def _home(self) -> Place:
        if self._situation.home is None:
            raise self._error(f"{self._prefix}the home position is unknown; call waitReady()")
        return self._situation.home

    def _above_home(self, item: Item, height: float) -> float | None:
        """A height in the frame of an item as metres above home; None if unknown."""
        if not math.isfinite(height):
            return None
        if item.above_home:
            return height
        return height - self._home.altitude if item.above_sea else None

    def _check_height(self, number: int, item: Item, height: float | None) -> None:
        if not self._limits.bounds_heights or self._situation.kind == "rover":
            return
        if height is None:
            raise self._error_for(number, item, "the height of this item is not known")
        if not math.isnan(height):
            self._limits.check_goal(f"{self._prefix}item {self._item_number(number)}", (0.0, 0.0, -height))

    def _check_speed(self, number: int, item: Item, speed: float) -> None:
        if not self._limits.bounds_speed:
            return
        if not speed >= 0.0:
            raise self._error_for(number, item, f"{speed:g} is not known to be within the speed limit")
        self._limits.check_speed(f"{self._prefix}item {self._item_number(number)}", speed)

    def _circle(self, item: Item, radius: float) -> float:
        """The radius flown around an item; a copter stays on the spot except for LOITER_TURNS."""
        if self._situation.kind == "copter" and item.command != dialect.MAV_CMD_NAV_LOITER_TURNS:
            return 0.0
        if self._situation.kind == "rover" and item.command != dialect.MAV_CMD_NAV_LOITER_TURNS:
            return 0.0
        if radius and not math.isnan(radius):
            return abs(radius)
        return math.inf if self._situation.loiter is None else self._situation.loiter

    # -- curves -------------------------------------------------------------------------------------------

    def _position(self, item: Item) -> Vector:
        """The position of a checked item; without a height if heights are not limited."""
        offset = self._offset(0, item)
        height = self._above_home(item, item.z) or 0.0
        north, east = offset or (self._situation.position or (0.0, 0.0, 0.0))[:2]
        return (north, east, -height)

    def _places(self) -> list[tuple[int, Vector]]:
        """The target positions in order."""
        if self._path is None:
            self._path = [
                (number, self._position(item))
                for number, item in enumerate(self._items)
                if item.command in PLACED and is_flown(item.command)
            ]
        return self._path

    def _curve_starts(self, number: int, item: Item) -> list[tuple[Vector, Vector | None]]:
        """Possible starting points of a curve, each with the previous position. Raises DeviceError if
        unknown.
        """
        if not self._limits.bound_places:
            return []
        if has_command(self._items, *JUMPS):
            raise self._error_for(number, item, "a curve in a mission with jumps may start anywhere")
        before = [place for index, place in self._places() if index < number]
        starts: list[tuple[Vector, Vector | None]] = []
        if before:
            starts.append((before[-1], before[-2] if len(before) > 1 else self._situation.position))
        if self._situation.position is not None:
            starts.append((self._situation.position, None))
        elif self._situation.starts_here:
            raise self._error_for(number, item, "the position where its curve may start is unknown")
        return starts

    def _next_position(self, number: int) -> Vector | None:
        return next((place for index, place in self._places() if index > number), None)

    def _error_for(self, number: int, item: Item, reason: str) -> DeviceError:
        return self._error(
            f"{self._prefix}item {self._item_number(number)}, {command_name(item.command)}, refused: {reason}"
        )
