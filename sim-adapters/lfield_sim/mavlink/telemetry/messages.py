"""What the fake can send, by message id."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.mavlink.geo import Place
from lfield_sim.mavlink.telemetry import condition, equipment, motion, targets

Builder = Callable[[Autopilot, Place], Any]

#: Everything that can be asked for, once (512) or as a stream (511).
MESSAGES: Mapping[int, Builder] = {
    0: condition.heartbeat,
    1: condition.sys_status,
    2: condition.system_time,
    4: condition.ping,
    24: motion.gps_raw_int,
    26: motion.scaled_imu,
    27: motion.raw_imu,
    30: motion.attitude,
    31: motion.attitude_quaternion,
    32: motion.local_position_ned,
    33: motion.global_position_int,
    36: equipment.servo_output_raw,
    49: motion.gps_global_origin,
    65: condition.rc_channels,
    74: motion.vfr_hud,
    85: targets.position_target_local_ned,
    87: targets.position_target_global_int,
    105: motion.highres_imu,
    111: condition.timesync,
    147: condition.battery_status,
    148: condition.autopilot_version,
    158: equipment.mount_status,
    162: condition.fence_status,
    168: motion.wind,
    180: equipment.camera_feedback,
    193: condition.ekf_status_report,
    230: condition.estimator_status,
    231: motion.wind_cov,
    242: condition.home_position,
    245: condition.extended_sys_state,
    263: equipment.camera_image_captured,
    280: equipment.gimbal_manager_information,
    281: equipment.gimbal_manager_status,
    285: equipment.gimbal_device_attitude_status,
    331: motion.odometry,
    436: condition.current_mode,
    376: equipment.relay_status,
    9005: equipment.winch_status,
}

#: What cannot be told without a position: nothing of it is streamed while GPS is lost.
POSITIONS = frozenset({32, 168, 231, 331})

#: What REQUEST_DATA_STREAM (66) means by a stream number; 0 is all of them.
DATA_STREAMS: Mapping[int, tuple[int, ...]] = {
    1: (24, 27),
    2: (1, 24, 42, 162),
    3: (36, 65),
    6: (32, 33),
    10: (30,),
    11: (74,),
    12: (2, 147, 168, 193),
}
