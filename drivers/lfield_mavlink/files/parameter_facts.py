"""Parameters that an autopilot counts or measures itself, and those that take effect after a restart.

From the parameter documentation of ArduPilot 4.6 (ReadOnly, Volatile, RebootRequired;
https://ardupilot.org/copter/docs/parameters.html) and of PX4 1.15 (reboot_required;
https://docs.px4.io/main/en/advanced_config/parameter_reference). Other versions may have more of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fnmatch import fnmatchcase

from lfield_mavlink.modes import ARDUPILOT, PX4

#: Patterns of names, separated by white space; `#` is a digit.
Patterns = str

#: Counters, automatic calibrations, and identifiers of sensors: a value of another time or vehicle is wrong.
_OWN: Mapping[int, Patterns] = {
    ARDUPILOT: """
        FORMAT_VERSION SYSID_SW_* STAT_* MIS_TOTAL FENCE_TOTAL RALLY_TOTAL CMD_INDEX CMD_TOTAL
        SYS_NUM_RESETS LOG_LASTFILE GND_ABS_PRESS GND_TEMP BARO#_GND_PRESS BARO_GND_TEMP
        BARO_FIELD_ELV BARO#_DEVID ARSPD_OFFSET ARSPD_DEVID ARSPD#_DEVID COMPASS_DEV_ID*
        GPS_CAN_NODEID# INS_GYR*_ID INS_ACC*_ID INS#_GYR_ID INS#_ACC_ID TCAL_TEMP_* TCAL_BARO_EXP
    """,
    PX4: """
        LND_FLIGHT_T_* COM_FLIGHT_UUID COM_FLIGHT_TIME CAL_*_ID SYS_PARAM_VER
    """,
}
_RESTART: Mapping[int, Patterns] = {
    ARDUPILOT: """
        ADSB_LIST_MAX ADSB_TYPE AIS_TYPE ARSPD*_BUS BATT*_CURR_PIN BATT*_VOLT_PIN BATT*_MONITOR
        BATT*_I#C_* BATT*_FL_FLTR BRD_ALT_CONFIG BRD_IO_* BRD_SAFETY_* BRD_SBUS_OUT BRD_SD_*
        BRD_SER#_RTSCTS BRD_TYPE CAM#_FEEDBAK_PIN CAN_* CC_TYPE COMPASS_ENABLE COMPASS_CUS_*
        COMPASS_PRIO#_ID CUST_ROT* DDS_* EFI_TYPE EK#_ENABLE EK#_AFFINITY EK#_*_DELAY EK#_*_MASK
        EK#_MAG_CAL EK#_FLOW_USE FFT_* FILT#_TYPE FLOW_TYPE FRAME_CLASS FRAME_TYPE GEN_TYPE
        GPS*_TYPE* GPS*_COM_PORT* GPS*_DELAY_MS* GPS_RAW_DATA INS_GYRO_RATE INS_HNT*
        INS*_TCAL*_ENABLE INS_LOG_BAT_* LGR_*_PIN LOG_MAX_FILES MNT#_TYPE MOT_PWM_TYPE NET_*
        NTF_LED_LEN OA_DB_* OSD_TYPE* PLND_LAG PLND_ORIENT PRX#_TYPE RCMAP_* RNGFND_FILT
        SCHED_LOOP_RATE SCR_ENABLE SCR_HEAP_SIZE SCR_DIR_DISABLE SERIAL*_PROTOCOL SERIAL*_OPTIONS
        SERVO*_FUNCTION SERVO_BLH_* SERVO_FTW_MASK SERVO_GPIO_MASK SR#_* SRTL_POINTS TEMP#_*
        VISO_TYPE
    """,
    PX4: """
        SYS_AUTOSTART SYS_HITL SYS_USE_IO SYS_DM_BACKEND CBRK_* MAV_SYS_ID MAV_COMP_ID MAV_TYPE
        MAV_#_CONFIG SER_*_BAUD GPS_#_CONFIG GPS_#_PROTOCOL GPS_UBX_MODE EKF2_EN EKF2_*_DELAY
        EKF2_MULTI_* EKF2_PREDICT_US IMU_ACCEL_CUTOFF IMU_GYRO_RATEMAX IMU_INTEG_RATE SENS_EN_*
        SDLOG_MODE SDLOG_PROFILE UAVCAN_* CYPHAL_* UXRCE_DDS_* VT_TYPE DSHOT_CONFIG TRIG_MODE
        TRIG_INTERFACE CAM_CAP_* BAT#_SOURCE BAT#_N_CELLS RC_*_CONFIG MNT_MODE_IN
    """,
}


def own_values(autopilot: int, names: Iterable[str]) -> list[str]:
    """The given names whose parameters the autopilot itself counts or measures."""
    return _matching(_OWN[autopilot], names)


def effective_after_restart(autopilot: int, names: Iterable[str]) -> list[str]:
    """The given names whose parameters take effect after a restart."""
    return _matching(_RESTART[autopilot], names)


def _matching(patterns: Patterns, names: Iterable[str]) -> list[str]:
    globs = [pattern.replace("#", "[0-9]") for pattern in patterns.split()]
    return [name for name in names if any(fnmatchcase(name, glob) for glob in globs)]
