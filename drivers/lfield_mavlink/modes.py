"""ArduPilot's flight modes by vehicle kind (numbers as in HEARTBEAT.custom_mode), and what we use them for.

https://ardupilot.org/copter/docs/parameters.html#fltmode1, https://ardupilot.org/rover/docs/parameters.html#mode1
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of vehicle: its MAV_TYPEs, its modes, and the mode that is each safe state."""

    name: str
    types: frozenset[int]
    modes: Mapping[int, str]
    hold: str
    safe: Mapping[str, str]

    def mode_name(self, number: int) -> str:
        """`GUIDED`, or `mode 77` for one we do not know."""
        return self.modes.get(number, f"mode {number}")

    def mode_number(self, name: str) -> int:
        """The number of a mode of the table."""
        return next(number for number, known in self.modes.items() if known == name)


COPTER = Kind(
    "copter",
    # quadrotor, coaxial, helicopter, hexarotor, octorotor, tricopter, dodecarotor
    frozenset({2, 3, 4, 13, 14, 15, 29}),
    {
        0: "STABILIZE",
        1: "ACRO",
        2: "ALT_HOLD",
        3: "AUTO",
        4: "GUIDED",
        5: "LOITER",
        6: "RTL",
        7: "CIRCLE",
        9: "LAND",
        11: "DRIFT",
        13: "SPORT",
        14: "FLIP",
        15: "AUTOTUNE",
        16: "POSHOLD",
        17: "BRAKE",
        18: "THROW",
        19: "AVOID_ADSB",
        20: "GUIDED_NOGPS",
        21: "SMART_RTL",
        22: "FLOWHOLD",
        23: "FOLLOW",
        24: "ZIGZAG",
        25: "SYSTEMID",
        26: "AUTOROTATE",
        27: "AUTO_RTL",
        28: "TURTLE",
    },
    # BRAKE and not LOITER: LOITER follows the sticks, and without a radio control there are none.
    "BRAKE",
    {"land": "LAND", "hold": "BRAKE", "return": "RTL"},
)
ROVER = Kind(
    "rover",
    # ground rover, surface boat
    frozenset({10, 11}),
    {
        0: "MANUAL",
        1: "ACRO",
        3: "STEERING",
        4: "HOLD",
        5: "LOITER",
        6: "FOLLOW",
        7: "SIMPLE",
        8: "DOCK",
        9: "CIRCLE",
        10: "AUTO",
        11: "RTL",
        12: "SMART_RTL",
        15: "GUIDED",
        16: "INITIALISING",
    },
    "HOLD",
    {"land": "HOLD", "hold": "HOLD", "return": "RTL"},
)
KINDS = {kind.name: kind for kind in (COPTER, ROVER)}
