"""Permitted MAV_CMDs in missions within limits, and their rules: a table, and the check.

With limits a command without a rule is refused, since its effect is unknown. Without limits only invalid
items are refused: an impossible position, a jump to a missing item.

https://mavlink.io/en/messages/common.html#mav_commands; ArduPilot:
https://ardupilot.org/copter/docs/mission-command-list.html; PX4: https://docs.px4.io/main/en/flying/missions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from lfield.driver import DeviceError
from lfield_mavlink.limits import Limits
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.services.mission_check import MissionCheck, Situation
from lfield_mavlink.services.mission_commands import JUMPS
from lfield_mavlink.services.plan_items import Item

Rule = Callable[[MissionCheck, int, Item], None]
_C = MissionCheck

#: Items with a position, by rule.
_PLACED: Mapping[int, Rule] = {
    dialect.MAV_CMD_NAV_WAYPOINT: _C.waypoint,
    dialect.MAV_CMD_NAV_LOITER_UNLIM: _C.loiter,
    dialect.MAV_CMD_NAV_LOITER_TURNS: _C.loiter,
    dialect.MAV_CMD_NAV_LOITER_TIME: _C.loiter,
    dialect.MAV_CMD_NAV_LOITER_TO_ALT: _C.loiter_to_height,
    dialect.MAV_CMD_NAV_LAND: _C.land,
    dialect.MAV_CMD_NAV_VTOL_LAND: _C.vtol_land,
    dialect.MAV_CMD_NAV_TAKEOFF: _C.goal,
    dialect.MAV_CMD_NAV_VTOL_TAKEOFF: _C.goal,
    dialect.MAV_CMD_NAV_PAYLOAD_PLACE: _C.goal,
    dialect.MAV_CMD_NAV_SPLINE_WAYPOINT: _C.spline,
    dialect.MAV_CMD_NAV_ARC_WAYPOINT: _C.arc,
    dialect.MAV_CMD_DO_ORBIT: _C.orbit,
    dialect.MAV_CMD_DO_REPOSITION: _C.reposition,
}
#: Items without motion: waits, marks, jumps (all items are checked), cameras, gimbals, outputs, payload.
_ALLOWED = (
    dialect.MAV_CMD_NAV_DELAY,
    dialect.MAV_CMD_NAV_ROI,
    dialect.MAV_CMD_CONDITION_DELAY,
    dialect.MAV_CMD_CONDITION_DISTANCE,
    dialect.MAV_CMD_CONDITION_YAW,
    dialect.MAV_CMD_CONDITION_GATE,
    *JUMPS,
    dialect.MAV_CMD_JUMP_TAG,
    dialect.MAV_CMD_DO_LAND_START,
    dialect.MAV_CMD_DO_RETURN_PATH_START,
    dialect.MAV_CMD_DO_PAUSE_CONTINUE,
    dialect.MAV_CMD_DO_SET_REVERSE,
    dialect.MAV_CMD_DO_SET_RESUME_REPEAT_DIST,
    dialect.MAV_CMD_DO_SET_RELAY,
    dialect.MAV_CMD_DO_REPEAT_RELAY,
    dialect.MAV_CMD_DO_SET_SERVO,
    dialect.MAV_CMD_DO_REPEAT_SERVO,
    dialect.MAV_CMD_DO_SET_ACTUATOR,
    dialect.MAV_CMD_DO_SET_ROI,
    dialect.MAV_CMD_DO_SET_ROI_LOCATION,
    dialect.MAV_CMD_DO_SET_ROI_WPNEXT_OFFSET,
    dialect.MAV_CMD_DO_SET_ROI_NONE,
    dialect.MAV_CMD_DO_SET_ROI_SYSID,
    dialect.MAV_CMD_DO_CONTROL_VIDEO,
    dialect.MAV_CMD_DO_DIGICAM_CONFIGURE,
    dialect.MAV_CMD_DO_DIGICAM_CONTROL,
    dialect.MAV_CMD_DO_MOUNT_CONFIGURE,
    dialect.MAV_CMD_DO_MOUNT_CONTROL,
    dialect.MAV_CMD_DO_MOUNT_CONTROL_QUAT,
    dialect.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW,
    dialect.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE,
    dialect.MAV_CMD_DO_SET_CAM_TRIGG_DIST,
    dialect.MAV_CMD_DO_SET_CAM_TRIGG_INTERVAL,
    dialect.MAV_CMD_DO_TRIGGER_CONTROL,
    dialect.MAV_CMD_OBLIQUE_SURVEY,
    dialect.MAV_CMD_PANORAMA_CREATE,
    dialect.MAV_CMD_SET_CAMERA_MODE,
    dialect.MAV_CMD_SET_CAMERA_ZOOM,
    dialect.MAV_CMD_SET_CAMERA_FOCUS,
    dialect.MAV_CMD_SET_CAMERA_SOURCE,
    dialect.MAV_CMD_IMAGE_START_CAPTURE,
    dialect.MAV_CMD_IMAGE_STOP_CAPTURE,
    dialect.MAV_CMD_VIDEO_START_CAPTURE,
    dialect.MAV_CMD_VIDEO_STOP_CAPTURE,
    dialect.MAV_CMD_DO_GRIPPER,
    dialect.MAV_CMD_DO_WINCH,
    dialect.MAV_CMD_DO_SPRAYER,
    dialect.MAV_CMD_ILLUMINATOR_ON_OFF,
)
#: Every command that may be permitted.
RULES: Mapping[int, Rule] = {
    **_PLACED,
    **dict.fromkeys(_ALLOWED, _C.allow),
    dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: _C.return_home,
    dialect.MAV_CMD_NAV_CONTINUE_AND_CHANGE_ALT: _C.climb_on,
    dialect.MAV_CMD_CONDITION_CHANGE_ALT: _C.height,
    dialect.MAV_CMD_DO_CHANGE_ALTITUDE: _C.change_altitude,
    dialect.MAV_CMD_DO_CHANGE_SPEED: _C.speed,
    dialect.MAV_CMD_DO_SET_HOME: _C.set_home,
    dialect.MAV_CMD_DO_FENCE_ENABLE: _C.fence,
    dialect.MAV_CMD_DO_GUIDED_LIMITS: _C.guided_limits,
}


def check_mission(
    subject: str,
    items: Sequence[Item],
    limits: Limits,
    error: Callable[[str], DeviceError],
    situation: Situation,
) -> None:
    """Refuses a mission for the first item that is invalid, or not known to stay within the limits.

    `error` creates the exception for a reason. Raises DeviceError.
    """
    check = MissionCheck(subject, items, limits, error, situation)
    for number, item in enumerate(items):
        check.structure(number, item)
    for number, item in enumerate(items if limits.bounds_anything else ()):
        RULES.get(item.command, MissionCheck.refuse)(check, number, item)


def check_rally(
    subject: str,
    points: Sequence[Item],
    limits: Limits,
    error: Callable[[str], DeviceError],
    situation: Situation,
) -> None:
    """Refuses rally points beyond the limits, since a return would lead there. Raises DeviceError."""
    check = MissionCheck(subject, points, limits, error, situation)
    for number, point in enumerate(points):
        check.rally_point(number, point)
