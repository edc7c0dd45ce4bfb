"""Vehicle kinds of each autopilot: MAV_TYPEs, modes, and the modes used by this driver.

Numbers are those of HEARTBEAT.custom_mode. ArduPilot numbers its modes per vehicle
(https://ardupilot.org/copter/docs/parameters.html#fltmode1, and rover, plane, sub likewise); PX4 has one
table of main and sub modes (https://docs.px4.io/main/en/flight_modes/, px4_custom_mode.h).
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

#: Waiver of motions that an autopilot flies by itself, which continue when this computer fails.
AUTONOMOUS = "autonomous_motion"
#: MAV_AUTOPILOT of the supported autopilots.
ARDUPILOT, PX4 = 3, 12
STACKS: Mapping[int, str] = {ARDUPILOT: "ArduPilot", PX4: "PX4"}
#: Radius in metres of the sphere used by each autopilot, as recorded (ap-rover.c-speed and
#: px4-copter.e-gcs-loss: 6378.4 and 6371.0 km) and as in their sources.
RADII: Mapping[int, float] = {ARDUPILOT: 6378100.0, PX4: 6371000.0}


class Profile(Struct, frozen=True):
    """A kind of vehicle under one autopilot.

    `guided` is the mode for our setpoints, `arming` the mode for arming. `hold`, `land` and `home` are the
    safe states. `own` are modes that the vehicle enters by itself on the ground after a commanded motion, so
    they are not foreign. `retreats` are further modes of its failsafes; in `autonomous` modes it moves by
    itself. `piloted` modes are a pilot's: the ground station failsafe does not act in them.
    """

    autopilot: int
    kind: str
    types: frozenset[int]
    modes: Mapping[int, str]
    guided: str
    arming: str
    hold: str
    land: str
    home: str
    own: frozenset[str] = frozenset()
    retreats: frozenset[str] = frozenset()
    flies: bool = True
    autonomous: frozenset[str] = frozenset()
    piloted: frozenset[str] = frozenset()

    @property
    def by_trajectory(self) -> bool:
        """Whether the vehicle needs a stream of setpoints: PX4 except for fixed wings."""
        return self.px4 and self.kind != "plane"

    @property
    def stack(self) -> str:
        """`ArduPilot`."""
        return STACKS[self.autopilot]

    @property
    def px4(self) -> bool:
        """Whether the autopilot is PX4: byte-wise parameters, NaN for unused values, streamed setpoints."""
        return self.autopilot == PX4

    @property
    def mission(self) -> str:
        """The mode that flies the stored mission."""
        return "AUTO.MISSION" if self.px4 else "AUTO"

    @property
    def fallbacks(self) -> frozenset[str]:
        """The modes of safe states and failsafes."""
        return self.retreats | {self.hold, self.land, self.home}

    def safe(self, state: str) -> str:
        """The mode of a safe state of the manifest."""
        return {"land": self.land, "hold": self.hold, "return": self.home}[state]

    def safe_action(self, state: str) -> str:
        """The action of a vehicle of this kind in a safe state: a rover cannot land, and holds."""
        mode = self.safe(state)
        return {"RTL": "return", "SURFACE": "surface"}.get(mode, "hold" if mode == self.hold else state)

    def mode_name(self, number: int) -> str:
        """`GUIDED`, or `mode 77` for an unknown one."""
        return self.modes.get(number, f"mode {number}")

    def mode_values(self, name: str) -> tuple[float, ...] | None:
        """Parameters 2 and following of DO_SET_MODE; None for an unknown mode."""
        number = next((number for number, known in self.modes.items() if known == name), None)
        if number is None:
            return None
        return (float(number >> 16 & 0xFF), float(number >> 24)) if self.px4 else (float(number),)

    def mode_command(self, name: str) -> tuple[float, ...]:
        """The parameters of DO_SET_MODE for a known mode (MAV_MODE_FLAG_CUSTOM_MODE_ENABLED is 1)."""
        values = self.mode_values(name)
        assert values is not None, "the name is from the table or was looked up in it"
        return (1.0, *values)


# MAV_TYPE: quadrotor, coaxial, helicopter, hexarotor, octorotor, tricopter, dodecarotor
_COPTERS = frozenset({2, 3, 4, 13, 14, 15, 29})
# ground rover, surface boat
_ROVERS = frozenset({10, 11})
# fixed wing, and the kinds that take off vertically
_PLANES = frozenset({1, 19, 20, 21, 22, 23, 24, 25})
_SUBMARINES = frozenset({12})

_COPTER_MODES = {
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
}
#: With bit 4 of FS_OPTIONS (default), the failsafe does not act in these modes (ArduCopter 4.7,
#: Mode::is_autopilot).
_COPTER_PILOTED = frozenset(
    {
        "STABILIZE",
        "ACRO",
        "ALT_HOLD",
        "LOITER",
        "DRIFT",
        "SPORT",
        "FLIP",
        "AUTOTUNE",
        "POSHOLD",
        "BRAKE",
        "FLOWHOLD",
        "SYSTEMID",
        "AUTOROTATE",
        "TURTLE",
    }
)
_ROVER_MODES = {
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
}
_PLANE_MODES = {
    0: "MANUAL",
    1: "CIRCLE",
    2: "STABILIZE",
    3: "TRAINING",
    4: "ACRO",
    5: "FBWA",
    6: "FBWB",
    7: "CRUISE",
    8: "AUTOTUNE",
    10: "AUTO",
    11: "RTL",
    12: "LOITER",
    13: "TAKEOFF",
    14: "AVOID_ADSB",
    15: "GUIDED",
    16: "INITIALISING",
    17: "QSTABILIZE",
    18: "QHOVER",
    19: "QLOITER",
    20: "QLAND",
    21: "QRTL",
    22: "QAUTOTUNE",
    23: "QACRO",
    24: "THERMAL",
}
_SUBMARINE_MODES = {
    0: "STABILIZE",
    1: "ACRO",
    2: "ALT_HOLD",
    3: "AUTO",
    4: "GUIDED",
    7: "CIRCLE",
    9: "SURFACE",
    16: "POSHOLD",
    19: "MANUAL",
    20: "MOTOR_DETECT",
}


def _px4(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


_PX4_MODES = {
    _px4(1): "MANUAL",
    _px4(2): "ALTCTL",
    _px4(3): "POSCTL",
    _px4(3, 1): "POSCTL.ORBIT",
    _px4(3, 2): "POSCTL.SLOW",
    _px4(4, 1): "AUTO.READY",
    _px4(4, 2): "AUTO.TAKEOFF",
    _px4(4, 3): "AUTO.LOITER",
    _px4(4, 4): "AUTO.MISSION",
    _px4(4, 5): "AUTO.RTL",
    _px4(4, 6): "AUTO.LAND",
    _px4(4, 8): "AUTO.FOLLOW_TARGET",
    _px4(4, 9): "AUTO.PRECLAND",
    _px4(4, 10): "AUTO.VTOL_TAKEOFF",
    _px4(5): "ACRO",
    _px4(6): "OFFBOARD",
    _px4(7): "STABILIZED",
    _px4(8): "RATTITUDE",
    _px4(10): "TERMINATION",
}
#: Names of PX4's modes in its texts; some changed in 1.15.
PX4_MODE_TEXTS: Mapping[str, tuple[str, ...]] = {
    "MANUAL": ("Manual",),
    "ALTCTL": ("Altitude",),
    "POSCTL": ("Position",),
    "POSCTL.ORBIT": ("Orbit",),
    "POSCTL.SLOW": ("Position Slow",),
    "AUTO.TAKEOFF": ("Takeoff",),
    "AUTO.LOITER": ("Hold",),
    "AUTO.MISSION": ("Mission",),
    "AUTO.RTL": ("Return", "RTL"),
    "AUTO.LAND": ("Land",),
    "AUTO.FOLLOW_TARGET": ("Follow Target",),
    "AUTO.PRECLAND": ("Precision Landing", "Precision Land"),
    "AUTO.VTOL_TAKEOFF": ("VTOL Takeoff", "Vtol Takeoff"),
    "ACRO": ("Acro",),
    "OFFBOARD": ("Offboard",),
    "STABILIZED": ("Stabilized",),
    "TERMINATION": ("Termination",),
}
_PX4_OWN = frozenset({"AUTO.TAKEOFF", "AUTO.LOITER"})
#: Modes in which a vehicle moves without sticks or setpoints.
_PX4_AUTONOMOUS = frozenset(_PX4_MODES.values()) - frozenset(
    {
        "MANUAL",
        "ALTCTL",
        "POSCTL",
        "POSCTL.SLOW",
        "ACRO",
        "STABILIZED",
        "RATTITUDE",
        "OFFBOARD",
        "TERMINATION",
    }
)

# Failsafe actions other than land, return and hold.
_RETURNS = frozenset({"SMART_RTL", "AUTO_RTL"})
_PLANE_RETREATS = frozenset({"CIRCLE", "QLAND", "QRTL"})
_PX4_RETREATS = frozenset({"AUTO.PRECLAND", "TERMINATION"})


def _of_px4(kind: str, types: frozenset[int], land: str, *, flies: bool) -> Profile:
    hold, home = "AUTO.LOITER", "AUTO.RTL"
    return Profile(
        PX4, kind, types, _PX4_MODES, "OFFBOARD", hold, hold, land, home, _PX4_OWN, _PX4_RETREATS, flies,
        _PX4_AUTONOMOUS,
    )  # fmt: skip


def _of_ardupilot(
    kind: str,
    types: frozenset[int],
    modes: Mapping[int, str],
    hold: str,
    land: str,
    home: str,
    *,
    retreats: frozenset[str] = frozenset(),
    flies: bool = True,
    piloted: frozenset[str] = frozenset(),
) -> Profile:
    return Profile(
        ARDUPILOT, kind, types, modes, "GUIDED", "GUIDED", hold, land, home, retreats=retreats, flies=flies,
        piloted=piloted,
    )  # fmt: skip


_ALL = (
    # BRAKE, not LOITER: LOITER follows the sticks, and without a radio control there are none.
    _of_ardupilot(
        "copter", _COPTERS, _COPTER_MODES, "BRAKE", "LAND", "RTL", retreats=_RETURNS, piloted=_COPTER_PILOTED
    ),
    # A rover has no landing: it stops.
    _of_ardupilot("rover", _ROVERS, _ROVER_MODES, "HOLD", "HOLD", "RTL", retreats=_RETURNS, flies=False),
    # A plane cannot land without a runway: it returns and circles.
    _of_ardupilot("plane", _PLANES, _PLANE_MODES, "LOITER", "RTL", "RTL", retreats=_PLANE_RETREATS),
    _of_ardupilot("submarine", _SUBMARINES, _SUBMARINE_MODES, "POSHOLD", "SURFACE", "SURFACE", flies=False),
    _of_px4("copter", _COPTERS, "AUTO.LAND", flies=True),
    _of_px4("rover", _ROVERS, "AUTO.LOITER", flies=False),
    _of_px4("plane", _PLANES, "AUTO.LAND", flies=True),
)

#: By MAV_AUTOPILOT and the `kind` of the bindings.
PROFILES: Mapping[tuple[int, str], Profile] = {(p.autopilot, p.kind): p for p in _ALL}
KINDS = tuple(dict.fromkeys(profile.kind for profile in _ALL))
