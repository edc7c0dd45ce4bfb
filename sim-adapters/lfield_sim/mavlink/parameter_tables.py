"""The parameters of an autopilot beyond those that the model heeds: names, types and values, as data.

One table for a flavour and kind in the folder `tables`: `name,type,value`. The names and types are those of
the autopilots (https://ardupilot.org/copter/docs/parameters.html,
https://docs.px4.io/main/en/advanced_config/parameter_reference.html); the choice is ours.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from importlib.resources import files


class ParameterType(IntEnum):
    """MAV_PARAM_TYPE, the part that autopilots use."""

    INT8 = 2
    INT16 = 4
    INT32 = 6
    REAL32 = 9

    @property
    def bounds(self) -> tuple[int, int]:
        """The least and the greatest value of an integer type."""
        bits = {ParameterType.INT8: 7, ParameterType.INT16: 15}.get(self, 31)
        return -(1 << bits), (1 << bits) - 1


@dataclass(frozen=True, slots=True)
class ParameterRow:
    """The type of a parameter, and what it is when nothing else is said."""

    type: ParameterType
    value: float


@cache
def parameter_table(flavour: str, kind: str) -> Mapping[str, ParameterRow]:
    """The table of a flavour (`ardupilot`, `px4`) and a kind of vehicle (`copter`, `rover`), by name."""
    text = (files(__package__) / "tables" / f"{flavour}_{kind}.csv").read_text(encoding="ascii")
    return {
        row["name"]: ParameterRow(ParameterType[row["type"].upper()], float(row["value"]))
        for row in csv.DictReader(text.splitlines())
    }
