"""The team's frame (metres north, east and down of one origin) and the pose of a device's own frame in it.

A vehicle measures positions from the place at which it was switched on or armed. A devices file gives the
pose of that place (`frame`); all positions in a program then refer to the team's origin. `Device` converts
what the manifest marks with a kind of `lfield.manifest`:

    place       north, east, down in metres: three (or two) parameters in a row, or an array of them
    direction   rotated, not translated: velocities
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
    """Origin of the team's frame on the Earth: degrees, and metres above mean sea level."""

    latitude: float
    longitude: float
    altitude: float

    def __str__(self) -> str:
        return f"{self.latitude:.7f}, {self.longitude:.7f} at {self.altitude:.2f} m"


class Frame(Protocol):
    """A device's own frame: conversion of positions to and from the team's frame, and its heading (rad,
    clockwise).
    """

    @property
    def heading(self) -> float:
        """The direction of this frame's north in the team's frame."""

    def to_team(self, place: Vector) -> Vector:
        """The position in the team's frame of a position in this frame."""

    def from_team(self, place: Vector) -> Vector:
        """The position in this frame of a position in the team's frame."""


class Pose(msgspec.Struct, frozen=True):
    """A frame with an offset from the team's origin in metres, rotated by `heading` radians."""

    north: float
    east: float
    down: float = 0.0
    heading: float = 0.0

    def to_team(self, place: Vector) -> Vector:
        """The position in the team's frame of a position in this frame."""
        north, east, down = rotated(place, self.heading)
        return (self.north + north, self.east + east, self.down + down)

    def from_team(self, place: Vector) -> Vector:
        """The position in this frame of a position in the team's frame."""
        offset = (place[0] - self.north, place[1] - self.east, place[2] - self.down)
        return rotated(offset, -self.heading)


class Placement(msgspec.Struct, frozen=True):
    """The pose of an agent according to a devices file.

    Without a `pose` the device must locate itself on the Earth, where the team's frame has its `origin`.
    `number` is the agent's index in the deployment, which separates simulated devices that have no position.
    """

    origin: Origin | None = None
    pose: Pose | None = None
    number: int = 0


def rotated(offset: Vector, heading: float) -> Vector:
    """Rotates a vector into a frame whose north points to `heading`."""
    north, east, down = offset
    cos, sin = math.cos(heading), math.sin(heading)
    return (cos * north - sin * east, sin * north + cos * east, down)


def arguments_from_team(
    parameters: Sequence[Parameter], values: Sequence[object], frame: Frame
) -> list[object]:
    """The arguments of an instruction, converted from the team's frame to the device's own."""
    converted, at = list(values), 0
    while at < len(converted):
        kind, value = parameters[at].frame, converted[at]
        if not kind or isinstance(value, list):
            converted[at] = _array(kind, value, frame, back=True) if isinstance(value, list) else value
            at += 1
        elif kind == "heading":
            converted[at] = _number(value) - frame.heading
            at += 1
        else:
            row = 1
            while at + row < len(converted) and row < 3 and parameters[at + row].frame == kind:
                row += 1
            converted[at : at + row] = _converted(kind, converted[at : at + row], frame, back=True)
            at += row
    return converted


def values_to_team(
    kinds: Mapping[str, str], values: Mapping[str, object], frame: Frame | None
) -> dict[str, object]:
    """Telemetry converted to the team's frame; `kinds` are the quantities that refer to it.

    Quantities are omitted while the pose of the device's own frame is unknown.
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
    """Converts one position or direction of up to three numbers; missing numbers are 0."""
    numbers = [_number(each) for each in row]
    north, east, down = [*numbers, 0.0, 0.0, 0.0][:3]
    offset = (north, east, down)
    if kind == "direction":
        found = rotated(offset, -frame.heading if back else frame.heading)
    else:
        found = frame.from_team(offset) if back else frame.to_team(offset)
    return list(found[: len(numbers)])


def _number(value: object) -> float:
    assert isinstance(value, int | float), "the manifest was checked"
    return float(value)
