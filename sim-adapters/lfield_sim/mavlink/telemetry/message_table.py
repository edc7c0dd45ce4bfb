"""The messages of the simulated vehicle, by message id."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.telemetry import (
    condition_messages,
    equipment_messages,
    motion_messages,
    target_messages,
)

Builder = Callable[[Autopilot, GeoOrigin], Any]

#: Messages available on request (512) or as a stream (511).
MESSAGES: Mapping[int, Builder] = {
    0: condition_messages.heartbeat,
    1: condition_messages.sys_status,
    2: condition_messages.system_time,
    4: condition_messages.ping,
    24: motion_messages.gps_raw_int,
    26: motion_messages.scaled_imu,
    27: motion_messages.raw_imu,
    30: motion_messages.attitude,
    31: motion_messages.attitude_quaternion,
    32: motion_messages.local_position_ned,
    33: motion_messages.global_position_int,
    36: equipment_messages.servo_output_raw,
    49: motion_messages.gps_global_origin,
    65: condition_messages.rc_channels,
    74: motion_messages.vfr_hud,
    85: target_messages.position_target_local_ned,
    87: target_messages.position_target_global_int,
    105: motion_messages.highres_imu,
    111: condition_messages.timesync,
    147: condition_messages.battery_status,
    148: condition_messages.autopilot_version,
    162: condition_messages.fence_status,
    168: motion_messages.wind,
    180: equipment_messages.camera_feedback,
    193: condition_messages.ekf_status_report,
    230: condition_messages.estimator_status,
    231: motion_messages.wind_cov,
    242: condition_messages.home_position,
    245: condition_messages.extended_sys_state,
    331: motion_messages.odometry,
    436: condition_messages.current_mode,
    376: equipment_messages.relay_status,
    9005: equipment_messages.winch_status,
}

#: Messages that need a position: not streamed while GPS is lost.
POSITIONS = frozenset({32, 168, 231, 331})

#: Messages of REQUEST_DATA_STREAM (66) by stream number; 0 is all of them.
DATA_STREAMS: Mapping[int, tuple[int, ...]] = {
    1: (24, 27),
    2: (1, 24, 42, 162),
    3: (36, 65),
    6: (32, 33),
    10: (30,),
    11: (74,),
    12: (2, 147, 168, 193, 285),
}
