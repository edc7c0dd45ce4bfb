"""Findings of `lfield plan check`: a code, the number of the item, and a sentence.

A finding is about the content of a file that was read; a file that is not readable is a MissionFileError.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from msgspec import Struct

#: Codes with their meaning; M9xx are warnings, which do not change the exit status.
FILE_FINDINGS: Mapping[str, str] = {
    "M101": "the plan was made for another kind of vehicle",
    "M102": "the plan was made for another firmware",
    "M103": "the autopilot does not know the command of an item",
    "M104": "an item is invalid, or is not known to stay within the limits",
    "M105": "the plan has more items than the firmware stores, or none",
    "M106": "an item, or the way to it, is beyond the fence of the file",
    "M107": "an item is below home",
    "M108": "the plan of a vehicle on the ground does not begin with a takeoff",
    "M109": "home is unknown, and the limits refer to it",
    "M110": "a zone of the fence is invalid",
    "M111": "a rally point is beyond the limits or the fence",
    "M201": "the area has too few corners",
    "M202": "the area crosses itself",
    "M203": "the area crosses the antimeridian",
    "M204": "the area is at a pole",
    "M205": "the area has a hole",
    "M206": "the area has no extent",
    "M207": "the area is beyond the limits",
    "M208": "the shape has too many corners",
    "M209": "a corner of the area is repeated",
    "M301": "the name of a file, or a value of a survey, must be a literal or constant",
    "M302": "a file that a program names cannot be read",
    "M303": "the strips of a survey have an invalid spacing or heading, or are too many",
    "M901": "home is far from the first item",
    "M902": "not every board with this firmware stores so many items",
    "M903": "heights of an area are not used",
}


class FileFinding(Struct, frozen=True):
    """One finding. `item` is the item's number in ground stations, None for the file as a whole."""

    code: str
    text: str
    item: int | None = None

    @property
    def is_error(self) -> bool:
        """Whether the file must not be used."""
        return not self.code.startswith("M9")

    @property
    def severity(self) -> str:
        """`error` or `warning`."""
        return "error" if self.is_error else "warning"

    def render(self, file: str) -> str:
        """`north.plan: error[M104]: waypoint 7 refused: ...`."""
        return f"{file}: {self.severity}[{self.code}]: {self.text}"

    def as_data(self) -> dict[str, Any]:
        """The finding as JSON data."""
        return {"severity": self.severity, "code": self.code, "item": self.item, "message": self.text}
