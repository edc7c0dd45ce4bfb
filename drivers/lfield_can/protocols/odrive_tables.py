"""Tables of ODrive's CANSimple: commands, layouts, states, errors (docs.odriverobotics.com, CAN Protocol,
0.6).

The id of a frame is `node << 5 | command`; all numbers are little-endian, positions are turns of the motor.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

# From the device.
HEARTBEAT, ERROR, ESTIMATES, IQ, TEMPERATURE, BUS_VOLTAGE, TORQUES = 0x01, 0x03, 0x09, 0x14, 0x15, 0x17, 0x1C
# To the device.
ESTOP, SET_STATE, SET_MODE, SET_POSITION, SET_VELOCITY, SET_TORQUE = 0x02, 0x07, 0x0B, 0x0C, 0x0D, 0x0E
SET_LIMITS, SET_TRAVEL_SPEED, SET_TRAVEL_ACCELERATION, CLEAR_ERRORS = 0x0F, 0x11, 0x12, 0x18

LAYOUTS: Mapping[int, struct.Struct] = {
    HEARTBEAT: struct.Struct("<IB"),  # active errors, axis state; the rest differs between versions
    ERROR: struct.Struct("<II"),  # active errors, disarm reason
    ESTIMATES: struct.Struct("<ff"),  # turns, turns/s
    IQ: struct.Struct("<ff"),  # A: target, measured
    TEMPERATURE: struct.Struct("<ff"),  # °C: power stage, motor
    BUS_VOLTAGE: struct.Struct("<ff"),  # V, A
    TORQUES: struct.Struct("<ff"),  # N m: target, estimated
    ESTOP: struct.Struct(""),
    SET_STATE: struct.Struct("<I"),
    SET_MODE: struct.Struct("<II"),  # control mode, input mode
    SET_POSITION: struct.Struct("<fhh"),  # turns; feed-forwards in 0.001 turns/s and 0.001 N m
    SET_VELOCITY: struct.Struct("<ff"),  # turns/s; torque feed-forward in N m
    SET_TORQUE: struct.Struct("<f"),  # N m
    SET_LIMITS: struct.Struct("<ff"),  # turns/s, A
    SET_TRAVEL_SPEED: struct.Struct("<f"),  # turns/s
    SET_TRAVEL_ACCELERATION: struct.Struct("<ff"),  # turns/s²: acceleration, deceleration
    CLEAR_ERRORS: struct.Struct("<B"),
}
TELEMETRY = (HEARTBEAT, ERROR, ESTIMATES, IQ, TEMPERATURE, BUS_VOLTAGE, TORQUES)

IDLE, CLOSED_LOOP, HOMING = 1, 8, 11
STATES: Mapping[int, str] = {
    0: "undefined",
    IDLE: "idle",
    2: "startup sequence",
    3: "full calibration",
    4: "motor calibration",
    6: "encoder index search",
    7: "encoder offset calibration",
    CLOSED_LOOP: "closed loop",
    9: "lockin spin",
    10: "encoder direction search",
    HOMING: "homing",
    12: "encoder polarity calibration",
    13: "encoder phase calibration",
    14: "anticogging calibration",
}

# Control modes, input modes.
TORQUE, VELOCITY, POSITION = 1, 2, 3
DIRECT, TRAVEL = 1, 5

ERRORS: Mapping[int, str] = {
    1 << 0: "initializing",
    1 << 1: "system level",
    1 << 2: "timing",
    1 << 3: "no position estimate",
    1 << 4: "bad configuration",
    1 << 5: "gate driver fault",
    1 << 6: "missing input",
    1 << 8: "supply over-voltage",
    1 << 9: "supply under-voltage",
    1 << 10: "supply over-current",
    1 << 11: "too much current fed back",
    1 << 12: "over-current of the motor",
    1 << 13: "the motor is too hot",
    1 << 14: "the power stage is too hot",
    1 << 15: "too fast",
    1 << 16: "position out of bounds",
    1 << 24: "its watchdog expired",
    1 << 25: "emergency stop",
    1 << 26: "spinout",
    1 << 27: "brake resistor off",
    1 << 28: "thermistor disconnected",
    1 << 30: "calibration",
}


def error_text(bits: int) -> str:
    """Describes error bits, '' for none."""
    texts = [text for bit, text in ERRORS.items() if bits & bit]
    unknown_bits = bits & ~sum(ERRORS)
    return ", ".join([*texts, *([f"unknown error 0x{unknown_bits:X}"] if unknown_bits else [])])
