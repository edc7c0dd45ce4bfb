"""Parameters of a vehicle configured for a computer: failsafes for its failure, a speed limit.

Factory settings contain none of these. The values give the shortest time-outs of the autopilots' manuals:
https://ardupilot.org/copter/docs/gcs-failsafe.html, https://docs.px4.io/main/en/config/safety.html.
"""

from __future__ import annotations

from collections.abc import Mapping

from lfield_sim.autopilot.autopilot import FLAVOURS

#: Failsafe actions, in order of preference.
STATES = ("land", "hold", "return")

Values = Mapping[str, float]
_COPTER_ACTIONS: Values = {"land": 5, "hold": 7, "return": 1}
_ROVER_ACTIONS: Values = {"land": 2, "hold": 2, "return": 1}
_PX4_ACTIONS: Values = {"land": 3, "hold": 1, "return": 2}
_PX4_STREAM_ACTIONS: Values = {"land": 4, "hold": 5, "return": 3}
#: Speed parameters, with their value per m/s.
_SPEEDS: Mapping[tuple[str, str], Values] = {
    ("ardupilot", "copter"): {"WPNAV_SPEED": 100.0},
    ("ardupilot", "rover"): {"WP_SPEED": 1.0},
    ("px4", "copter"): {"MPC_XY_VEL_MAX": 1.0, "MPC_XY_CRUISE": 1.0, "MPC_VEL_MANUAL": 1.0},
    ("px4", "rover"): {"RO_SPEED_LIM": 1.0},
}


def station(system: int) -> int:
    """lfield's default system id as the ground station of a vehicle."""
    return (system + 126) % 254 + 1


def setup_parameters(
    flavour: str,
    kind: str,
    state: str = STATES[0],
    ttl: float = 0.5,
    speed: float | None = None,
    *,
    station: int,
) -> dict[str, float]:
    """Parameters for the action `state` when its computer fails, with the shortest time-out.

    The setpoints end within twice `ttl` seconds; the vehicle is limited to `speed`, in m/s. `station` is the
    system id of its computer.
    """
    parameters = _failsafes(flavour, kind, state, 2.0 * ttl)
    if flavour == "ardupilot":
        parameters |= {"MAV_GCS_SYSID": station, "MAV_GCS_SYSID_HI": 0}
    defaults = FLAVOURS[flavour][kind].parameters
    for name, unit in _SPEEDS[flavour, kind].items() if speed is not None else ():
        assert speed is not None
        parameters[name] = min(speed * unit, defaults.get(name, speed * unit))
    return parameters


def _failsafes(flavour: str, kind: str, state: str, longest: float) -> dict[str, float]:
    if flavour == "px4":
        return {
            "COM_OF_LOSS_T": max(0.25, min(1.0, longest)),
            "COM_OBL_RC_ACT": _PX4_STREAM_ACTIONS[state],
            "COM_FAIL_ACT_T": 0.0,
            # The default, and sticks take over in OFFBOARD.
            "COM_RC_OVERRIDE": 1 | 2,
            "COM_DL_LOSS_T": 5.0,
            "NAV_DLL_ACT": _PX4_ACTIONS[state],
        }
    if kind == "rover":
        return {
            "FS_GCS_ENABLE": 1,
            "FS_ACTION": _ROVER_ACTIONS[state],
            "FS_GCS_TIMEOUT": 2.0,
            "FS_TIMEOUT": 1.0,
        }
    return {
        "FS_GCS_ENABLE": _COPTER_ACTIONS[state],
        "FS_GCS_TIMEOUT": 2.0,
        "GUID_TIMEOUT": max(0.1, min(3.0, longest)),
        # The default, and a landing is not turned into a return.
        "FS_OPTIONS": 16 | 8,
    }
