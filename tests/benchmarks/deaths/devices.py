"""The devices that are tried: their fakes and bindings, and what their own logs show when they are safe."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

#: What a device's own log says is so, by name (see lfield_sim.state_log).
Facts = Mapping[str, str]

SETPOINTS, MOVE = "setpoints", "move"
#: ODrive's Error.WATCHDOG_TIMER_EXPIRED.
_WATCHDOG_EXPIRED = 0x1000000


@dataclass(frozen=True)
class Device:
    """One kind of device.

    `fake` are the words of its fake, `field` its field in the `resource` of moves.L that moves it, `binding`
    what its binding says beside the endpoint. `safe` compares what was so when the death came with what is
    so: a new goal is what tells a servo that holds from one that goes on. `own` says whether its own watchdog
    has acted.
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

    @property
    def bindings(self) -> str:
        """The devices file of the agent `a`, with places for endpoint and silence."""
        return (
            f'agents: {{a: {{devices: {{{self.field}: {{endpoint: "%s", {self.binding}}}}}}}}}\nsilence: %g\n'
        )


def _still(now: Facts) -> bool:
    return now["moving"] == "no"


#: What 'lfield setup' leaves in them for a binding that lands, written so that older fakes take it too.
SET_UP = ("FS_GCS_ENABLE=5", "FS_GCS_TIMEOUT=2", "GUID_TIMEOUT=1", "FS_OPTIONS=24")
SET_UP_PX4 = ("COM_OBL_RC_ACT=4", "COM_FAIL_ACT_T=0", "COM_DL_LOSS_T=5", "NAV_DLL_ACT=3")


def _copter(name: str, flavour: str, land: str, ttl: float, *more: str) -> Device:
    # Low and brisk, so that a landing takes no longer than it must; a battery that lasts for all trials.
    words = f"mavlink --listen udp:127.0.0.1:0 --flavour {flavour} --climb 5 --descend 2.4 --land 1.9"
    kept = [word for setting in more for word in ("--param", setting)]
    return Device(
        name,
        [*f"{words} --acceleration 10 --capacity 900000".split(), *kept],
        "Copter",
        "fc",
        f"driver: mavlink, safe_state: land, ttl: {ttl}",
        safe=lambda _, now: now["mode"] == land or now["airborne"] == "no",
        at_rest=lambda now: now["armed"] == "no" and now["airborne"] == "no",
        own=lambda now: now["failsafe"] == "yes",
    )


#: With times to live for which each device's own watchdog can be set (an ODrive's is in its configuration).
DEVICES = (
    _copter("ArduCopter", "ardupilot", "LAND", 1.0, *SET_UP),
    _copter("PX4", "px4", "AUTO.LAND", 3.5, *SET_UP_PX4, "COM_DISARM_LAND=0.1"),
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
        # Without a brake it coasts when it is off: with some friction that takes a second, not half a minute.
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
        # Only setpoints feed its watchdog: it would end a long move by itself.
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
