"""Tables of CANSimple, the CAN protocol of ODrive's firmware 0.6. Positions in turns, speeds in turns/s."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, IntFlag

HEARTBEAT, ESTOP, GET_VERSION = 0x01, 0x02, 0x00
RX_SDO, TX_SDO = 0x04, 0x05
REBOOT, CLEAR_ERRORS = 0x16, 0x18
#: Head of RxSdo: opcode, endpoint, reserved. A read has no value, or an ignored one.
SDO_HEAD, WRITE = "<BHB", 1


class AxisState(IntEnum):
    """States of an axis (Axis_State)."""

    IDLE = 1
    FULL_CALIBRATION = 3
    MOTOR_CALIBRATION = 4
    ENCODER_INDEX_SEARCH = 6
    ENCODER_OFFSET_CALIBRATION = 7
    CLOSED_LOOP_CONTROL = 8
    HOMING = 11


class ProcedureResult(IntEnum):
    """Result of the last procedure (Procedure_Result)."""

    SUCCESS = 0
    BUSY = 1
    CANCELLED = 2
    DISARMED = 3


class AxisError(IntFlag):
    """Bits of Axis_Error, Active_Errors and Disarm_Reason."""

    NONE = 0
    DC_BUS_UNDER_VOLTAGE = 0x200
    CURRENT_LIMIT_VIOLATION = 0x1000
    MOTOR_OVER_TEMP = 0x2000
    VELOCITY_LIMIT_VIOLATION = 0x8000
    WATCHDOG_TIMER_EXPIRED = 0x1000000
    ESTOP_REQUESTED = 0x2000000
    SPINOUT_DETECTED = 0x4000000


class ControlMode(IntEnum):
    """The controlled quantity (Control_Mode)."""

    TORQUE = 1
    VELOCITY = 2
    POSITION = 3


class InputMode(IntEnum):
    """The conversion of an input into a setpoint (Input_Mode)."""

    INACTIVE = 0
    PASSTHROUGH = 1
    VEL_RAMP = 2
    POS_FILTER = 3
    TRAP_TRAJ = 5
    TORQUE_RAMP = 6


#: Messages to the axis: command -> layout.
SETTERS: Mapping[int, str] = {
    ESTOP: "<",
    0x07: "<I",
    0x0B: "<II",
    0x0C: "<fhh",
    0x0D: "<ff",
    0x0E: "<f",
    0x0F: "<ff",
    0x11: "<f",
    0x12: "<ff",
    REBOOT: "<B",
    CLEAR_ERRORS: "<B",
    0x19: "<f",
}

#: Messages from the axis, on request (a remote frame or one without data): command -> layout.
GETTERS: Mapping[int, str] = {
    GET_VERSION: "<BBBBBBBB",
    HEARTBEAT: "<IBBBx",
    0x03: "<II",
    0x09: "<ff",
    0x14: "<ff",
    0x15: "<ff",
    0x17: "<ff",
    0x1C: "<ff",
    0x1D: "<ff",
}

#: Periodic messages: command -> seconds.
CYCLIC: Mapping[int, float] = {HEARTBEAT: 0.1, 0x09: 0.01, 0x03: 0.1, 0x14: 0.1, 0x15: 0.5, 0x17: 0.5}

#: Endpoints of RxSdo. Their numbers depend on the firmware; these are this simulated device's own.
ENDPOINTS: Mapping[int, tuple[str, str]] = {
    1: ("axis0.config.enable_watchdog", "<?3x"),
    2: ("axis0.config.watchdog_timeout", "<f"),
    3: ("axis0.controller.config.vel_ramp_rate", "<f"),
    4: ("axis0.config.can.heartbeat_msg_rate_ms", "<I"),
    5: ("axis0.config.can.encoder_msg_rate_ms", "<I"),
}
