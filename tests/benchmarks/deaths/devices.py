"""The tested devices: their fakes and bindings, and the log values that mean safe and at rest."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

#: The values of a device's log by name (see lfield_sim.state_log).
Facts = Mapping[str, str]

SETPOINTS, MOVE = "setpoints", "move"
#: ODrive's Error.WATCHDOG_TIMER_EXPIRED.
_WATCHDOG_EXPIRED = 0x1000000


@dataclass(frozen=True)
class Device:
    """One type of device.

    `fake` has the arguments of the fake, `field` is the device's field in the `resource` of moves.L,
    `binding` has the options of the binding except the endpoint. `safe` compares the values at the failure
    with the current ones: only a new goal distinguishes a holding servo from a moving one. `own` returns true
    if the device's own watchdog has acted. The device must be safe within `bound` seconds after a failure of
    its guard. With `station` it also receives the heartbeats of a ground station on another link.
    """

    name: str
    fake: Sequence[str]
    resource: str
    field: str
    binding: str
    safe: Callable[[Facts, Facts], bool]
    at_rest: Callable[[Facts], bool]
    own: Callable[[Facts], bool]
    ways: Sequence[str] = (SETPOINTS, MOVE)
    bound: float = math.inf
    station: bool = False

    @property
    def bindings(self) -> str:
        """The devices file of the agent `a`, a format string for endpoint and silence."""
        return (
            f'agents: {{a: {{devices: {{{self.field}: {{endpoint: "%s", {self.binding}}}}}}}}}\nsilence: %g\n'
        )


def _still(now: Facts) -> bool:
    return now["moving"] == "no"


#: Parameters that 'lfield setup' writes for a binding with safe state `land`; ground station 128.
SET_UP = ("FS_GCS_ENABLE=5", "FS_GCS_TIMEOUT=2", "GUID_TIMEOUT=1", "FS_OPTIONS=24", "MAV_GCS_SYSID=128")
SET_UP_ROVER = ("FS_GCS_ENABLE=1", "FS_ACTION=2", "FS_GCS_TIMEOUT=2", "FS_TIMEOUT=1", "MAV_GCS_SYSID=128")
SET_UP_PX4 = (
    "COM_OBL_RC_ACT=4", "COM_FAIL_ACT_T=0", "COM_DL_LOSS_T=5", "NAV_DLL_ACT=3", "COM_OF_LOSS_T=1",
    "COM_RC_OVERRIDE=3",
)  # fmt: skip


def _copter(
    name: str, flavour: str, land: str, ttl: float, bound: float, *more: str, station: bool = False
) -> Device:
    # High speeds keep landings short; the battery lasts for all trials.
    command = f"mavlink --listen udp:127.0.0.1:0 --flavour {flavour} --climb 5 --descend 2.4 --land 1.9"
    arguments = [argument for setting in more for argument in ("--param", setting)]
    return Device(
        name,
        [*f"{command} --acceleration 10 --capacity 900000".split(), *arguments],
        "Copter",
        "fc",
        f"driver: mavlink, safe_state: land, ttl: {ttl}",
        safe=lambda _, now: now["mode"] == land or now["airborne"] == "no",
        at_rest=lambda now: now["armed"] == "no" and now["airborne"] == "no",
        own=lambda now: now["failsafe"] == "yes",
        bound=bound,
        station=station,
    )


def _rover(name: str, *, station: bool = False) -> Device:
    arguments = [argument for setting in SET_UP_ROVER for argument in ("--param", setting)]
    return Device(
        name,
        ["mavlink", "--listen", "udp:127.0.0.1:0", "--kind", "rover", "--capacity", "900000", *arguments],
        "Rover",
        "fc",
        "driver: mavlink, kind: rover, safe_state: land, ttl: 1.5",
        safe=lambda _, now: now["mode"] == "HOLD",
        at_rest=_still,
        own=lambda now: now["failsafe"] == "yes",
        bound=4.0,
        station=station,
    )


#: Each ttl is possible for the device's own watchdog (an ODrive has it in its configuration).
DEVICES = (
    _copter("ArduCopter", "ardupilot", "LAND", 1.0, 3.0, *SET_UP),
    _copter("ArduCopter beside a station", "ardupilot", "LAND", 1.0, 3.0, *SET_UP, station=True),
    _rover("Rover"),
    _rover("Rover beside a station", station=True),
    _copter("PX4", "px4", "AUTO.LAND", 0.5, 2.0, *SET_UP_PX4, "COM_DISARM_LAND=0.1"),
    _copter(
        "PX4 beside a station", "px4", "AUTO.LAND", 0.5, 2.0, *SET_UP_PX4, "COM_DISARM_LAND=0.1", station=True
    ),
    Device(
        "CiA 402",
        ("can", "--device", "cia402:5"),
        "Axis",
        "axis",
        "driver: can, protocol: cia402, node: 5, counts: 16384, safe_state: brake, ttl: 0.5, "
        "waivers: [no_homing]",
        safe=lambda _, now: now["state"] != "OPERATION_ENABLED",
        at_rest=_still,
        own=lambda now: now["master_lost"] == "yes",
    ),
    Device(
        "ODrive",
        # An ODrive without a brake coasts when it is off: friction stops it in a second, not in half a
        # minute.
        ("can", "--device", "odrive:3,watchdog=1,friction=0.05"),
        "Axis",
        "axis",
        "driver: can, protocol: odrive, node: 3, safe_state: brake, ttl: 0.5, "
        "waivers: [device_watchdog, no_homing]",
        safe=lambda _, now: (
            now["state"] != "CLOSED_LOOP_CONTROL" or (now["control"] == "VELOCITY" and now["goal"] == "0")
        ),
        at_rest=_still,
        own=lambda now: bool(int(now["errors"]) & _WATCHDOG_EXPIRED),
        # Only setpoints feed the watchdog of an ODrive: it would end a long move.
        ways=(SETPOINTS,),
    ),
    Device(
        "Dynamixel",
        ("dynamixel", "--servo", "1:XM430-W350", "--baud", "1000000"),
        "Servo",
        "motor",
        "driver: dynamixel, id: 1, safe_state: torque_hold, ttl: 0.5",
        safe=lambda before, now: (
            now["goals"] != before["goals"] or now["torque"] == "no" or now["watchdog_bit"] == "yes"
        ),
        at_rest=_still,
        own=lambda now: now["watchdog_bit"] == "yes",
        ways=(MOVE,),
    ),
)
