"""The team's frame: metres north, east and down of one origin, and where a device's own frame lies in it.

A vehicle reckons from where it was switched on or armed, each from a place of its own. A devices file says
where these lie (`frame`), and then all that a program hears and says of places is about the team's origin:
`Device` converts at its edge what the manifest marks, by a kind of `lfield.manifest`:

    place       north, east, down in metres: as three (or two) parameters in a row, or as an array of them
    direction   the same turned and not shifted: velocities
    heading     radians clockwise from north; the last element of an array
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol

import msgspec

from lfield.manifest import Parameter

Vector = tuple[float, float, float]
"""North, east, down in metres, or in m/s."""


class Origin(msgspec.Struct, frozen=True):
    """Where on the Earth the team's frame begins: degrees, and metres above mean sea level."""

    latitude: float
    longitude: float
    altitude: float

    def __str__(self) -> str:
        return f"{self.latitude:.7f}, {self.longitude:.7f} at {self.altitude:.2f} m"


class Frame(Protocol):
    """A frame in the team's: places there and back, and how its north is turned (rad, clockwise)."""

    @property
    def heading(self) -> float:
        """Where its own north points in the team's frame."""

    def to_team(self, place: Vector) -> Vector:
        """A place of its own in the team's frame."""

    def from_team(self, place: Vector) -> Vector:
        """A place of the team's frame in its own."""


class Pose(msgspec.Struct, frozen=True):
    """A frame whose origin is so many metres from the team's, its north turned by `heading` radians."""

    north: float
    east: float
    down: float = 0.0
    heading: float = 0.0

    def to_team(self, place: Vector) -> Vector:
        """A place of its own in the team's frame."""
        north, east, down = turned(place, self.heading)
        return (self.north + north, self.east + east, self.down + down)

    def from_team(self, place: Vector) -> Vector:
        """A place of the team's frame in its own."""
        way = (place[0] - self.north, place[1] - self.east, place[2] - self.down)
        return turned(way, -self.heading)


class Placement(msgspec.Struct, frozen=True):
    """What a devices file says of where one agent is.

    With a `pose` its own frame lies there; without one it must find itself on the Earth, where the team's
    frame has its `origin`. `number` is the agent's in the deployment: fakes that nobody has put anywhere
    stand apart by it.
    """

    origin: Origin | None = None
    pose: Pose | None = None
    number: int = 0


def turned(way: Vector, heading: float) -> Vector:
    """A way in a frame whose north points to `heading`, as whoever has that heading sees it."""
    north, east, down = way
    cos, sin = math.cos(heading), math.sin(heading)
    return (cos * north - sin * east, sin * north + cos * east, down)


def arguments_from_team(
    parameters: Sequence[Parameter], values: Sequence[object], frame: Frame
) -> list[object]:
    """The arguments of an instruction, those about the team's frame as the device's own has them."""
    found, at = list(values), 0
    while at < len(found):
        kind, value = parameters[at].frame, found[at]
        if not kind or isinstance(value, list):
            found[at] = _array(kind, value, frame, back=True) if isinstance(value, list) else value
            at += 1
        elif kind == "heading":
            found[at] = _number(value) - frame.heading
            at += 1
        else:
            row = 1
            while at + row < len(found) and row < 3 and parameters[at + row].frame == kind:
                row += 1
            found[at : at + row] = _converted(kind, found[at : at + row], frame, back=True)
            at += row
    return found


def values_to_team(
    kinds: Mapping[str, str], values: Mapping[str, object], frame: Frame | None
) -> dict[str, object]:
    """Telemetry as the team has it; `kinds` are the quantities that are about its frame.

    As long as it is not known where the device's own frame lies, those are left out.
    """
    if frame is None:
        return {name: value for name, value in values.items() if name not in kinds}
    return {n: _value(kinds[n], v, frame) if n in kinds else v for n, v in values.items()}


def _value(kind: str, value: object, frame: Frame) -> object:
    if isinstance(value, Sequence) and not isinstance(value, str):
        return _array(kind, list(value), frame, back=False)
    return (_number(value) + frame.heading) % math.tau if kind == "heading" else value


def _array(kind: str, values: list[object], frame: Frame, *, back: bool) -> list[object]:
    if kind == "heading":
        turn = -frame.heading if back else frame.heading
        return [*values[:-1], math.remainder(_number(values[-1]) + turn, math.tau)] if values else values
    if not kind:
        return values
    row = 2 if len(values) == 2 else 3
    rows = (values[at : at + row] for at in range(0, len(values), row))
    return [number for each in rows for number in _converted(kind, each, frame, back=back)]


def _converted(kind: str, row: Sequence[object], frame: Frame, *, back: bool) -> list[float]:
    """One place or direction of up to three numbers; what it does not say is 0."""
    numbers = [_number(each) for each in row]
    north, east, down = [*numbers, 0.0, 0.0, 0.0][:3]
    way = (north, east, down)
    if kind == "direction":
        found = turned(way, -frame.heading if back else frame.heading)
    else:
        found = frame.from_team(way) if back else frame.to_team(way)
    return list(found[: len(numbers)])


def _number(value: object) -> float:
    assert isinstance(value, int | float), "the manifest says so, and was checked"
    return float(value)
