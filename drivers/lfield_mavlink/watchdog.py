"""Autopilot parameters that a binding requires: failsafes for a failure of this computer, and the speed
limit.

The parameters are stored in the autopilot: checked when the vehicle is opened and before arming, written by
`lfield setup` only.

ArduPilot's ground station failsafe acts FS_GCS_TIMEOUT seconds after our last heartbeat, at least 2 s (a
rover waits FS_TIMEOUT more). A velocity setpoint ends after GUID_TIMEOUT (on a rover after 3 s, not
configurable). The longer of the two is its watchdog. https://ardupilot.org/copter/docs/gcs-failsafe.html,
https://ardupilot.org/copter/docs/ac2_guidedmode.html

PX4 acts COM_OF_LOSS_T after the last setpoint, independent of ground stations. That is its watchdog if it
moves by setpoints only. Autonomous motions, if waived (a mission, a return), end by the data link failsafe,
which any ground station prevents: COM_DL_LOSS_T, at least 5 s, plus 2 s for detection (6.6 to 7.1 measured).
Then the longer is its watchdog: at least 7 s. https://docs.px4.io/main/en/config/safety.html,
https://docs.px4.io/main/en/advanced_config/parameter_reference.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Literal

from msgspec import Struct

from lfield.driver import DeviceBinding, Setting
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.modes import ARDUPILOT, AUTONOMOUS, PX4
from lfield_mavlink.services.parameters import Parameters
from lfield_mavlink.station_ids import station_of

#: Seconds that PX4 needs beyond COM_DL_LOSS_T to detect the loss of its station.
DETECTION_TIME = 2.0
#: Seconds after which an ArduPilot rover ends a velocity.
ROVER_SETPOINT = 3.0

Values = Mapping[str, float]
#: A value that depends on the binding.
FromBinding = Callable[[DeviceBinding], float]


class Need(Struct, frozen=True):
    """One parameter that a binding requires.

    `names` are its names by version; without a name it is a `fixed_time` of the autopilot. It must
    be `value` (or that of the binding's safe state, or of the binding), or have its bits (`bits`) and none of
    `cleared_bits`. A time (`clock`) is at most the rest of the permitted time, from `minimum` to `maximum`;
    times of one clock are added, and later ones need at least `after`; different clocks run in parallel. A
    speed (`unit` per m/s) is at most the limit of the binding, and required only with a limit. With
    `may_be_zero`, 0 is permitted like any number below the bound. A parameter that is not `required` may be
    missing; it then counts `fixed_time` seconds. `states` are the safe states to which it applies, by default
    all; a time with `whole_seconds` has no fraction of a second.
    """

    names: tuple[str, ...] = ()
    reason: str = ""
    value: float | Values | FromBinding = 0.0
    bits: bool = False
    cleared_bits: int = 0
    clock: Literal["", "link", "setpoint"] = ""
    minimum: float = 0.0
    maximum: float = math.inf
    after: float = 0.0
    whole_seconds: bool = False
    unit: Mapping[str, float] | None = None
    may_be_zero: bool = False
    required: bool = True
    fixed_time: float = 0.0
    states: tuple[str, ...] = ()

    def applies_to(self, binding: DeviceBinding) -> bool:
        """Whether the parameter applies to a binding."""
        if self.unit is not None and "speed" not in binding.limits:
            return False
        return not self.states or binding.safe_state in self.states

    def required_value(self, name: str, present: float, binding: DeviceBinding, remaining: float) -> float:
        """The required value of a parameter with the value `present`; `remaining` is the rest of its
        clock's time.
        """
        if self.unit is not None:
            maximum = binding.limits["speed"] * self.unit[name]
            return present if self._is_within(present, maximum) else 0.0 if self.may_be_zero else maximum
        if self.clock:
            maximum = min(self.maximum, max(self.minimum, remaining - self.after))
            maximum = math.floor(maximum + 1e-6) if self.whole_seconds else maximum
            return present if self._is_within(present, maximum) else maximum
        value = self.value
        if isinstance(value, Mapping):
            value = value[binding.safe_state]
        elif callable(value):
            value = value(binding)
        return float((int(present) | int(value)) & ~self.cleared_bits) if self.bits else value

    def _is_within(self, present: float, maximum: float) -> bool:
        return (present > 0.0 or (self.may_be_zero and present == 0.0)) and present <= maximum * (1.0 + 1e-6)


_FAILURE_ACTION = "its action when this computer fails"
_TIMEOUT = "its time-out for that"
_LIMIT = "the speed limit of the binding"

_STATION = Need(
    ("MAV_GCS_SYSID", "SYSID_MYGCS"),
    "its failsafe depends on this station alone: heartbeats of another one (id 255) do not prevent it. "
    "The other one can command modes, missions and parameters, but its sticks (RC override, MANUAL_CONTROL) "
    "are ignored, and the vehicle cannot be armed without heartbeats of this station ('GCS failsafe on'). "
    "'lfield setup --apply FILE' reverts that",
    station_of,
)
_NO_OTHERS = Need(
    ("MAV_GCS_SYSID_HI",),
    "heartbeats of other stations in a range of ids do not prevent its failsafe",
    0,
    required=False,
)
_SETPOINT = Need(("GUID_TIMEOUT",), "the time-out of a velocity", clock="setpoint", minimum=0.1)

_COPTER = (
    # Land; brake, or land without a position; return.
    Need(("FS_GCS_ENABLE",), _FAILURE_ACTION, {"land": 5, "hold": 7, "return": 1}),
    Need(("FS_GCS_TIMEOUT",), _TIMEOUT, clock="link", minimum=2.0, maximum=2.0),
    _STATION,
    _NO_OTHERS,
    _SETPOINT,
    # Not bit 1, with which ArduPilot continues a mission.
    Need(
        ("FS_OPTIONS",),
        "a landing is never turned into a return, and a mission does not continue",
        8,
        bits=True,
        cleared_bits=2,
        required=False,
    ),
    # In cm/s, from 4.7 on in m/s. Also the speed of a return if its own speed is 0.
    Need(("WP_SPD", "WPNAV_SPEED"), _LIMIT, unit={"WP_SPD": 1.0, "WPNAV_SPEED": 100.0}),
    Need(
        ("RTL_SPEED_MS", "RTL_SPEED"),
        f"{_LIMIT}, on the way home",
        unit={"RTL_SPEED_MS": 1.0, "RTL_SPEED": 100.0},
        may_be_zero=True,
        required=False,
    ),
)
_ROVER = (
    Need(("FS_GCS_ENABLE",), _FAILURE_ACTION, 1),
    Need(("FS_ACTION",), _FAILURE_ACTION, {"land": 2, "hold": 2, "return": 1}),
    # A rover waits for this after FS_GCS_TIMEOUT; 1 s is the documented minimum.
    Need(("FS_TIMEOUT",), _TIMEOUT, clock="link", minimum=1.0, maximum=1.0, after=2.0, required=False),
    Need(("FS_GCS_TIMEOUT",), _TIMEOUT, clock="link", minimum=2.0, maximum=2.0),
    _STATION,
    _NO_OTHERS,
    Need(clock="setpoint", fixed_time=ROVER_SETPOINT),
    Need(("WP_SPEED",), _LIMIT, unit={"WP_SPEED": 1.0}),
    Need(
        ("RTL_SPEED",),
        f"{_LIMIT}, on the way home",
        unit={"RTL_SPEED": 1.0},
        may_be_zero=True,
        required=False,
    ),
)
_PLANE = (
    Need(("FS_GCS_ENABL",), _FAILURE_ACTION, 1),
    Need(("FS_LONG_ACTN",), _FAILURE_ACTION, 1),
    Need(("FS_LONG_TIMEOUT",), _TIMEOUT, clock="link", minimum=1.0),
    _STATION,
    _NO_OTHERS,
)
_SUBMARINE = (
    # Surface; hold the depth; surface.
    Need(("FS_GCS_ENABLE",), _FAILURE_ACTION, {"land": 4, "hold": 3, "return": 4}),
    Need(("FS_GCS_TIMEOUT",), _TIMEOUT, clock="link", minimum=2.0, required=False, fixed_time=5.0),
    _STATION,
    _NO_OTHERS,
)
_PX4 = (
    Need(("COM_OF_LOSS_T",), "its time-out for setpoints", clock="setpoint", minimum=0.25, maximum=1.0),
    Need(("COM_OBL_RC_ACT",), "its action when setpoints end", {"land": 4, "hold": 5, "return": 3}),
    # A hover before the action of any failsafe.
    Need(("COM_FAIL_ACT_T",), "no delay before a failsafe acts", 0.0),
    Need(("COM_RC_OVERRIDE",), "a pilot takes over by the sticks in OFFBOARD", 2, bits=True),
    Need(("COM_DL_LOSS_T",), _TIMEOUT, clock="link", minimum=5.0, after=DETECTION_TIME, whole_seconds=True),
    Need(clock="link", fixed_time=DETECTION_TIME),
    Need(("NAV_DLL_ACT",), _FAILURE_ACTION, {"land": 3, "hold": 1, "return": 2}),
    # Modes in which PX4 ignores the loss of the station: a goal is flown in one of them.
    Need(("COM_DLL_EXCEPT",), "the action applies to every mode", 0, required=False),
)
#: PX4 permanently lowers the other two once the first is below them: so their old values are backed up too.
_PX4_COPTER = tuple(
    Need((name,), _LIMIT, unit={name: 1.0}) for name in ("MPC_XY_VEL_MAX", "MPC_XY_CRUISE", "MPC_VEL_MANUAL")
)

#: By autopilot and kind of vehicle.
NEEDS: Mapping[tuple[int, str], Sequence[Need]] = {
    (ARDUPILOT, "copter"): _COPTER,
    (ARDUPILOT, "rover"): _ROVER,
    (ARDUPILOT, "plane"): _PLANE,
    (ARDUPILOT, "submarine"): _SUBMARINE,
    (PX4, "copter"): (*_PX4, *_PX4_COPTER),
    (PX4, "rover"): (*_PX4, Need(("RO_SPEED_LIM",), _LIMIT, unit={"RO_SPEED_LIM": 1.0})),
    (PX4, "plane"): _PX4,
}


class Watchdog:
    """Checks the parameters that a binding requires."""

    def __init__(self, vehicle: Contact, parameters: Parameters) -> None:
        self._vehicle, self._parameters = vehicle, parameters
        #: The name of each parameter that was answered; empty for a missing one.
        self._names: dict[tuple[str, ...], tuple[str, ...]] = {}

    async def seconds(self, longest: float) -> float:
        """The time-out of the vehicle's watchdog once it is set up for at most `longest` seconds. Raises
        DeviceError.
        """
        return (await self._compare(longest))[1]

    async def settings(self) -> list[Setting]:
        """The required parameters, with present and required values. Raises DeviceError."""
        settings = (await self._compare(2.0 * self._vehicle.binding.ttl))[0]
        self._vehicle.publish(gcsFailsafe=all(setting.is_right for setting in settings))
        return settings

    async def settings_with(self, values: Values) -> list[Setting]:
        """The required parameters as if these values, by name, were stored. Raises DeviceError."""
        return (await self._compare(2.0 * self._vehicle.binding.ttl, values))[0]

    def protects(self, name: str) -> bool:
        """Whether the binding requires a parameter, so that no program may change it."""
        return any(name in need.names for need in self._needs())

    def _needs(self) -> Iterator[Need]:
        profile, binding = self._vehicle.profile, self._vehicle.binding
        return (need for need in NEEDS[profile.autopilot, profile.kind] if need.applies_to(binding))

    async def _compare(
        self, longest: float, values: Values = MappingProxyType({})
    ) -> tuple[list[Setting], float]:
        needs = list(self._needs())
        # A missing parameter is detected by a time-out: request all at once.
        parameters = await asyncio.gather(*map(self._read, needs))
        settings, clocks = list[Setting](), dict[str, float]()
        for need, (name, present) in zip(needs, parameters, strict=True):
            remaining = longest - clocks.get(need.clock, 0.0)
            required = need.fixed_time
            if present is not None:
                present = values.get(name, present)
                required = need.required_value(name, present, self._vehicle.binding, remaining)
                settings.append(Setting(name, present, required, need.reason))
            if need.clock:
                clocks[need.clock] = clocks.get(need.clock, 0.0) + required
        return settings, max(clocks.values()) if self._moves_by_itself else clocks["setpoint"]

    @property
    def _moves_by_itself(self) -> bool:
        """Whether the vehicle moves without setpoints: then its data link failsafe counts too."""
        profile, binding = self._vehicle.profile, self._vehicle.binding
        return not profile.by_trajectory or binding.waives(AUTONOMOUS)

    async def _read(self, need: Need) -> tuple[str, float | None]:
        """The parameter under this autopilot's name for it. Raises DeviceError."""
        names = self._names.get(need.names, need.names)
        name, present = await self._parameters.read_any(names)
        if present is not None and math.isfinite(present):
            self._names[need.names] = (name,)
            return name, present
        if need.required and need.names:
            raise self._vehicle.error(
                f"it does not report {' or '.join(names)}: whether it is set up for its binding is unknown",
                timeout=True,
            )
        self._names[need.names] = ()
        return "", None
