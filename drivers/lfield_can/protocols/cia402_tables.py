"""Tables of CiA 301 and CiA 402: objects, states, process data, units, errors.

CiA 301 4.2 (communication profile) and CiA 402-2 4.1 / IEC 61800-7-201 (drive profile).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

from canopen.objectdictionary import datatypes as t
from msgspec import Struct

#: The objects that this driver uses: (index, subindex) -> (name, data type).
OBJECTS: Mapping[tuple[int, int], tuple[str, int]] = {
    (0x1000, 0): ("device type", t.UNSIGNED32),
    (0x1001, 0): ("error register", t.UNSIGNED8),
    (0x1005, 0): ("id of SYNC", t.UNSIGNED32),
    (0x1016, 1): ("consumer heartbeat time", t.UNSIGNED32),
    (0x1017, 0): ("producer heartbeat time", t.UNSIGNED16),
    (0x1018, 1): ("vendor id", t.UNSIGNED32),
    (0x1018, 2): ("product code", t.UNSIGNED32),
    (0x1018, 4): ("serial number", t.UNSIGNED32),
    (0x6007, 0): ("abort connection option code", t.INTEGER16),
    (0x603F, 0): ("error code", t.UNSIGNED16),
    (0x6040, 0): ("control word", t.UNSIGNED16),
    (0x6041, 0): ("status word", t.UNSIGNED16),
    (0x605A, 0): ("quick stop option code", t.INTEGER16),
    (0x605E, 0): ("fault reaction option code", t.INTEGER16),
    (0x6060, 0): ("mode of operation", t.INTEGER8),
    (0x6061, 0): ("mode of operation display", t.INTEGER8),
    (0x6064, 0): ("position", t.INTEGER32),
    (0x606C, 0): ("velocity", t.INTEGER32),
    (0x6071, 0): ("target torque", t.INTEGER16),
    (0x6072, 0): ("max torque", t.UNSIGNED16),
    (0x6073, 0): ("max current", t.UNSIGNED16),
    (0x6075, 0): ("motor rated current", t.UNSIGNED32),
    (0x6076, 0): ("motor rated torque", t.UNSIGNED32),
    (0x6079, 0): ("supply voltage", t.UNSIGNED32),
    (0x607A, 0): ("target position", t.INTEGER32),
    (0x607D, 1): ("lowest position", t.INTEGER32),
    (0x607D, 2): ("highest position", t.INTEGER32),
    (0x607F, 0): ("max profile velocity", t.UNSIGNED32),
    (0x6081, 0): ("profile velocity", t.UNSIGNED32),
    (0x6083, 0): ("profile acceleration", t.UNSIGNED32),
    (0x6084, 0): ("profile deceleration", t.UNSIGNED32),
    (0x6085, 0): ("quick stop deceleration", t.UNSIGNED32),
    (0x6098, 0): ("homing method", t.INTEGER8),
    (0x6099, 1): ("homing speed to the switch", t.UNSIGNED32),
    (0x6099, 2): ("homing speed to the zero", t.UNSIGNED32),
    (0x60FF, 0): ("target velocity", t.INTEGER32),
    (0x6502, 0): ("supported modes", t.UNSIGNED32),
}

# Function codes, added to the node id to give a frame id (CiA 301, predefined connections).
NMT, EMERGENCY, SDO_ANSWER, SDO_REQUEST, HEARTBEAT = 0x000, 0x080, 0x580, 0x600, 0x700
#: Function codes of the process data that a node sends.
TRANSMITTED = (0x180, 0x280, 0x380, 0x480)
#: The default id of SYNC (object 0x1005).
SYNC = 0x080

#: Seconds between two process data of each kind.
EVERY = 0.02

# Objects in process data: index << 16 | subindex << 8 | bits.
STATUS, POSITION, VELOCITY, TORQUE, CURRENT = 0x60410010, 0x60640020, 0x606C0020, 0x60770010, 0x60780010
CONTROL, TO_POSITION, TO_VELOCITY, TO_TORQUE = 0x60400010, 0x607A0020, 0x60FF0020, 0x60710010

#: The encodings of these objects.
NUMBERS: Mapping[int, struct.Struct] = {
    STATUS: struct.Struct("<H"),
    POSITION: struct.Struct("<i"),
    VELOCITY: struct.Struct("<i"),
    TORQUE: struct.Struct("<h"),
    CURRENT: struct.Struct("<h"),
    CONTROL: struct.Struct("<H"),
    TO_POSITION: struct.Struct("<i"),
    TO_VELOCITY: struct.Struct("<i"),
    TO_TORQUE: struct.Struct("<h"),
}


class Direction(Struct, frozen=True):
    """Process data of one direction: records, mappings, required objects."""

    name: str
    is_sent: bool
    record: int
    mapping: int
    first: int
    mappings: tuple[tuple[int, ...], ...]
    required: frozenset[int]


TPDO = Direction(
    "TPDO",
    True,
    0x1800,
    0x1A00,
    0x180,
    ((STATUS,), (POSITION, VELOCITY), (TORQUE, CURRENT)),
    frozenset((STATUS, POSITION, VELOCITY)),
)
RPDO = Direction(
    "RPDO",
    False,
    0x1400,
    0x1600,
    0x200,
    ((CONTROL,), (TO_POSITION,), (TO_VELOCITY,), (TO_TORQUE,)),
    frozenset((CONTROL,)),
)
#: Optional objects, and the ability that a drive without them lacks.
OPTIONAL: Mapping[int, str] = {
    TORQUE: "report torque",
    CURRENT: "report current",
    TO_POSITION: "accept a stream of positions",
    TO_VELOCITY: "accept velocities",
    TO_TORQUE: "accept torques",
}

#: Emergencies and heartbeats.
LAYOUTS: Mapping[int, struct.Struct] = {
    EMERGENCY: struct.Struct("<HB5x"),
    HEARTBEAT: struct.Struct("<B"),
}

OPERATIONAL, BOOTED = 0x05, 0x00
NMT_START, NMT_PREPARE = 0x01, 0x80

# Bits of the status word beyond the state.
TARGET_REACHED, ACKNOWLEDGED, FAILED = 1 << 10, 1 << 12, 1 << 13

# Control words (CiA 402-2, table of commands).
SHUTDOWN, SWITCH_ON, ENABLE, DISABLE_VOLTAGE, QUICK_STOP, FAULT_RESET = 0x06, 0x07, 0x0F, 0x00, 0x02, 0x80
NEW_SETPOINT, AT_ONCE, HALT = 0x10, 0x20, 0x100
START_HOMING = 0x10

#: State of the drive by status word: (mask, value, name); the first match.
STATES = (
    (0x4F, 0x00, "not ready to switch on"),
    (0x4F, 0x40, "switch on disabled"),
    (0x6F, 0x21, "ready to switch on"),
    (0x6F, 0x23, "switched on"),
    (0x6F, 0x27, "operation enabled"),
    (0x6F, 0x07, "quick stop active"),
    (0x4F, 0x0F, "fault reaction active"),
    (0x4F, 0x08, "fault"),
)

#: The control word for the next step towards "operation enabled".
UPWARDS: Mapping[str, int] = {
    "quick stop active": DISABLE_VOLTAGE,
    "switch on disabled": SHUTDOWN,
    "ready to switch on": SWITCH_ON,
    "switched on": ENABLE,
}
#: States without torque.
IDLE = ("switch on disabled", "ready to switch on", "switched on", "fault", "not ready to switch on")

# Modes of operation, and their bits in the object of supported modes.
PROFILE_POSITION, PROFILE_VELOCITY, PROFILE_TORQUE, HOMING = 1, 3, 4, 6
CYCLIC_POSITION, CYCLIC_VELOCITY, CYCLIC_TORQUE = 8, 9, 10
MODES: Mapping[int, str] = {
    PROFILE_POSITION: "profile position",
    PROFILE_VELOCITY: "profile velocity",
    PROFILE_TORQUE: "profile torque",
    HOMING: "homing",
    CYCLIC_POSITION: "cyclic position",
    CYCLIC_VELOCITY: "cyclic velocity",
    CYCLIC_TORQUE: "cyclic torque",
}

# Values of the abort connection option code and the quick stop option code.
ABORT_DISABLES, ABORT_QUICK_STOPS, STOP_AND_HOLD = 2, 3, 6
#: Option codes of a quick stop and a fault: coast; the last standard value.
DISABLES, LAST_KNOWN = 0, 8

#: Bits of the error register (CiA 301, object 0x1001).
REGISTER: Mapping[int, str] = {
    0x01: "generic error",
    0x02: "current",
    0x04: "voltage",
    0x08: "temperature",
    0x10: "communication",
    0x20: "drive profile",
    0x80: "manufacturer-specific",
}

#: Error codes (CiA 402-2, table of error codes; CiA 301, emergency error codes). An unlisted code has the
#: text of its group: 0x7123 is in 0x7120, 0x7100, 0x7000.
ERRORS: Mapping[int, str] = {
    0x1000: "generic error",
    0x2000: "current",
    0x2100: "current at the input",
    0x2200: "current inside the drive",
    0x2210: "current inside the drive",
    0x2220: "continuous over-current inside the drive",
    0x2230: "short circuit or earth leakage inside the drive",
    0x2300: "current at the output",
    0x2310: "continuous over-current",
    0x2320: "short circuit or earth leakage",
    0x2330: "earth leakage",
    0x2340: "short circuit",
    0x2350: "overload (I²t)",
    0x3000: "voltage",
    0x3100: "mains voltage",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3130: "phase failure",
    0x3200: "supply voltage",
    0x3210: "supply over-voltage",
    0x3220: "supply under-voltage",
    0x3300: "output voltage",
    0x4000: "temperature",
    0x4100: "ambient temperature",
    0x4110: "ambient temperature too high",
    0x4200: "temperature of the drive",
    0x4210: "the drive is too hot",
    0x4220: "the drive is too cold",
    0x4300: "temperature of the motor or brake",
    0x4310: "the motor is too hot",
    0x4400: "temperature of the supply",
    0x5000: "hardware of the drive",
    0x5100: "supply of the electronics",
    0x5110: "low voltage of the electronics",
    0x5200: "control electronics",
    0x5300: "operating unit",
    0x5400: "power stage",
    0x5410: "output stages",
    0x5440: "contactors",
    0x5500: "memory of the drive",
    0x5530: "parameter memory",
    0x6000: "software of the drive",
    0x6010: "watchdog of the drive's software",
    0x6100: "internal software",
    0x6200: "user software",
    0x6300: "parameters",
    0x6320: "a wrong parameter",
    0x7000: "an additional module",
    0x7100: "power module",
    0x7110: "brake chopper",
    0x7120: "motor",
    0x7121: "motor blocked",
    0x7122: "motor error or wrong commutation",
    0x7180: "mechanical error",
    0x7200: "measuring",
    0x7300: "sensor",
    0x7305: "incremental encoder 1",
    0x7306: "incremental encoder 2",
    0x7310: "speed sensor",
    0x7320: "position sensor",
    0x7400: "computation",
    0x7500: "communication",
    0x7510: "serial interface",
    0x8000: "monitoring",
    0x8100: "communication",
    0x8110: "CAN overrun, frames were lost",
    0x8120: "CAN is error passive",
    0x8130: "our heartbeat was missed",
    0x8140: "recovered from bus off",
    0x8150: "collision of ids",
    0x8200: "protocol",
    0x8210: "process data too short",
    0x8220: "process data too long",
    0x8300: "torque control",
    0x8311: "excess torque",
    0x8331: "torque fault",
    0x8400: "velocity control",
    0x8480: "wrong speed",
    0x8500: "position control",
    0x8600: "positioning",
    0x8611: "following error",
    0x8612: "reference limit",
    0x8613: "homing",
    0x8700: "synchronisation",
    0x9000: "external error",
    0xF000: "an additional function",
    0xF001: "deceleration",
    0xF002: "sub-synchronous run",
    0xFF00: "vendor-specific",
}


def state_of(statusword: int) -> str:
    """The state of a status word, or '' if invalid."""
    return next((name for mask, value, name in STATES if statusword & mask == value), "")


def error_text(code: int, register: int = 0) -> str:
    """Describes an error code and error register, '' for none."""
    if code:
        groups = (ERRORS.get(code & mask) for mask in (0xFFFF, 0xFFF0, 0xFF00, 0xF000))
        return f"{next((g for g in groups if g), 'unknown error')} (0x{code:04X})"
    return ", ".join(text for bit, text in REGISTER.items() if register & bit)


def name_of(index: int, subindex: int) -> str:
    """The name of an object: `mapping of TPDO 2`."""
    for direction in (TPDO, RPDO):
        for start, label in ((direction.record, "parameters of"), (direction.mapping, "mapping of")):
            if start <= index < start + 0x200:
                return f"{label} {direction.name} {index - start + 1}"
    return OBJECTS.get((index, subindex), ("object", 0))[0]


# -- units -----------------------------------------------------------------------------------------------

#: Units per turn of the motor and second; counts depend on the encoder.
_PER_TURN = {"rpm": 60.0, "milli_rpm": 60_000.0}


class Units(Struct):
    """Scales of one drive. `turns` of the motor per radian of the axis, with its sign.

    `rated_torque` in N m and `rated_current` in A are of the motor; 0 while unknown.
    """

    turns: float
    counts: int
    velocity_unit: str
    rated_torque: float = 0.0
    rated_current: float = 0.0

    def set_ratings(self, torque: float, current: float) -> None:
        """Sets the rated torque (N m) and current (A) of the motor."""
        self.rated_torque, self.rated_current = torque, current

    def to_counts(self, position: float) -> int:
        """rad of the axis to counts."""
        return round(position * self.turns * self.counts)

    def position(self, counts: int) -> float:
        """Counts to rad of the axis."""
        return counts / self.counts / self.turns

    def to_velocity(self, velocity: float) -> int:
        """rad/s of the axis (or rad/s²) to the drive's unit."""
        return round(velocity * self.turns * self._per_turn)

    def velocity(self, value: int) -> float:
        """The drive's unit to rad/s of the axis."""
        return value / self._per_turn / self.turns

    def to_torque(self, torque: float) -> int:
        """N m of the axis to thousandths of the rated torque, which must be known."""
        return round(1000.0 * torque / self._axis_torque)

    def torque(self, value: int) -> float:
        """Thousandths of the rated torque to N m of the axis."""
        return value / 1000.0 * self._axis_torque

    @property
    def _per_turn(self) -> float:
        return _PER_TURN.get(self.velocity_unit, float(self.counts))

    @property
    def _axis_torque(self) -> float:
        """The rated torque after the gear, with the sign of the axis, without losses."""
        return self.rated_torque * self.turns * math.tau
