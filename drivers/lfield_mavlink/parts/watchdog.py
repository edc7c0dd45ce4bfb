"""The autopilot's own failsafes: what it does when this computer is gone. Set at opening, and read back.

ArduPilot has one for the ground station, which is us: it acts FS_GCS_TIMEOUT seconds after our last
heartbeat, at least 2 s. A velocity setpoint ends by itself after GUID_TIMEOUT. The longer of the two is its
watchdog.
https://ardupilot.org/copter/docs/gcs-failsafe.html, https://ardupilot.org/copter/docs/ac2_guidedmode.html

PX4's watchdog is that of its setpoints, COM_OF_LOSS_T: they are all of its motion that we keep up; what it
does by itself (takeoff, landing, reposition) ends in a hover or on the ground. Its failsafe for the data
link is set too, but its 5 s at least are not counted; it is what ends an orbit, which has no end of its own.
https://docs.px4.io/main/en/config/safety.html
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.link.dialect import SYSTEM
from lfield_mavlink.modes import ARDUPILOT, PX4
from lfield_mavlink.services.parameters import Parameters


@dataclass(frozen=True, slots=True)
class Setting:
    """One parameter of a failsafe.

    `names` are its names by version, newest first. It must be `value` (or that of the binding's safe state),
    have the bits of it (`bits`), or, as a time, be at most what is wanted and at least `least`. Times of one
    `clock` follow one another, so a time leaves room for what comes `after` it; those of different clocks
    run side by side. A setting that is not `needed` may be missing; a time that is missing counts
    `otherwise` seconds.
    """

    names: tuple[str, ...]
    value: float | Mapping[str, float] = 0.0
    bits: bool = False
    clock: Literal["", "link", "setpoint"] = ""
    is_time: bool = False
    least: float = 0.0
    after: float = 0.0
    needed: bool = True
    otherwise: float = 0.0

    def wanted(self, present: float, longest: float, safe_state: str) -> float:
        """What it should be, when it is `present`."""
        if self.is_time:
            most = max(self.least, longest - self.after)
            return min(present, most) if present > 0.0 else most
        value = self.value[safe_state] if isinstance(self.value, Mapping) else self.value
        return float(int(present) | int(value)) if self.bits else value


_STATION = Setting(("MAV_GCS_SYSID", "SYSID_MYGCS"), SYSTEM)
_GCS_TIMEOUT = Setting(("FS_GCS_TIMEOUT",), clock="link", is_time=True, least=2.0)

_COPTER = (
    # Land; brake, or land without a position; return.
    Setting(("FS_GCS_ENABLE",), {"land": 5, "hold": 7, "return": 1}),
    _GCS_TIMEOUT,
    _STATION,
    Setting(("GUID_TIMEOUT",), clock="setpoint", is_time=True, least=0.1),
    # Continue a landing: a failsafe must not turn the safe state into a flight home.
    Setting(("FS_OPTIONS",), 8, bits=True, needed=False),
)
_ROVER = (
    Setting(("FS_GCS_ENABLE",), 1),
    Setting(("FS_ACTION",), {"land": 2, "hold": 2, "return": 1}),
    Setting(("FS_GCS_TIMEOUT",), clock="link", is_time=True, least=2.0, after=1.0),
    # It waits for this after FS_GCS_TIMEOUT; 1 s is the least that is documented.
    Setting(("FS_TIMEOUT",), 1.0, clock="link", needed=False),
    _STATION,
    # A rover's own time for setpoints is 3 s and no parameter.
    Setting(("GUID_TIMEOUT",), clock="setpoint", is_time=True, least=0.1, needed=False, otherwise=3.0),
)
_PLANE = (
    Setting(("FS_GCS_ENABL",), 1),
    Setting(("FS_LONG_ACTN",), 1),
    Setting(("FS_LONG_TIMEOUT",), clock="link", is_time=True, least=1.0),
    _STATION,
)
_SUBMARINE = (
    # Surface; hold the depth; surface.
    Setting(("FS_GCS_ENABLE",), {"land": 4, "hold": 3, "return": 4}),
    Setting(("FS_GCS_TIMEOUT",), clock="link", is_time=True, least=2.0, needed=False, otherwise=5.0),
    _STATION,
)
_PX4 = (
    Setting(("COM_OF_LOSS_T",), clock="setpoint", is_time=True, least=0.25),
    Setting(("COM_OBL_RC_ACT",), {"land": 4, "hold": 5, "return": 3}),
    Setting(("COM_DL_LOSS_T",), is_time=True, least=5.0),
    Setting(("NAV_DLL_ACT",), {"land": 3, "hold": 1, "return": 2}),
)

#: By autopilot and kind of vehicle.
SETTINGS: Mapping[tuple[int, str], Sequence[Setting]] = {
    (ARDUPILOT, "copter"): _COPTER,
    (ARDUPILOT, "rover"): _ROVER,
    (ARDUPILOT, "plane"): _PLANE,
    (ARDUPILOT, "submarine"): _SUBMARINE,
    (PX4, "copter"): _PX4,
    (PX4, "rover"): _PX4,
    (PX4, "plane"): _PX4,
}


class Watchdog:
    """Sets the failsafes that stop the vehicle when this computer is gone."""

    def __init__(self, vehicle: Contact, parameters: Parameters) -> None:
        self._vehicle, self._parameters = vehicle, parameters
        self._accepted = math.inf

    async def set(self, longest: float) -> float:
        """Set it to at most `longest` seconds, or to the least it can; the seconds that it then has.

        Raises DeviceError.
        """
        profile = self._vehicle.profile
        settings = SETTINGS[profile.autopilot, profile.kind]
        times = await asyncio.gather(*(self._set_one(setting, longest) for setting in settings))
        clocks: dict[str, float] = {}
        for setting, seconds in zip(settings, times, strict=True):
            if setting.clock:
                clocks[setting.clock] = clocks.get(setting.clock, 0.0) + seconds
        self._vehicle.publish(gcsFailsafe=True)
        self._accepted = max(clocks.values())
        return self._accepted

    async def check_holds(self) -> None:
        """See that nobody has changed it since it was accepted. Raises DeviceError."""
        accepted = self._accepted
        seconds = await self.set(2.0 * self._vehicle.binding.ttl)
        if seconds > accepted:
            raise self._vehicle.error(
                f"its failsafe for a lost computer was {accepted:g} s and is now {seconds:g} s"
            )

    async def _set_one(self, setting: Setting, longest: float) -> float:
        """Set one parameter if it is not as it should be; what it then is. Raises DeviceError."""
        name, present = await self.find(setting)
        if present is None:
            if not setting.needed:
                return setting.otherwise
            raise self._vehicle.error(
                f"it does not tell {name}: what it does when this computer is gone is not known", timeout=True
            )
        wanted = setting.wanted(present, longest, self._vehicle.binding.safe_state)
        if math.isclose(present, wanted, rel_tol=1e-6):
            return present
        await self._parameters.write(name, wanted)
        self._vehicle.note(f"{name} was {present:g} and is now {wanted:g}")
        return wanted

    async def find(self, setting: Setting) -> tuple[str, float | None]:
        """The parameter under the first of its names that the autopilot knows."""
        for name in setting.names:
            present = await self._parameters.read(name)
            if present is not None and math.isfinite(present):
                return name, present
        return setting.names[0], None
