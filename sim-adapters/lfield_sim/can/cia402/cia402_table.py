"""Tables of CiA 402: object dictionary of a drive (CiA 301 and CiA 402-2) and its state machine.

Positions are increments of the motor's encoder (0x608F per turn), velocities increments per second,
accelerations increments per second squared, torques and currents thousandths of the rated ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

from lfield_sim.can.canopen.sdo import Key, ObjectEntry

#: Default increments per turn.
INCREMENTS = 16_384
VENDOR, PRODUCT, REVISION = 0x0000_0F1D, 0x0402, 0x0001_0003

PP, PV, PT, HM, CSP, CSV, CST = 1, 3, 4, 6, 8, 9, 10
MODES = (0, PP, PV, PT, HM, CSP, CSV, CST)
#: Homing methods (0x6098): at the present position (35, 37), and those that move to the home switch.
HOME_HERE = (35, 37)
HOMING_METHODS = (-4, -3, -2, -1, 0, 1, 2, 17, 18, 19, 21, 23, 27, 33, 34, *HOME_HERE)
#: Manufacturer's object: temperature of the motor in tenths of a degree Celsius.
TEMPERATURE = 0x2001

_MAX = 0x7FFFFFFF


def _mapped(index: int, bits: int, subindex: int = 0) -> int:
    """An entry of a PDO mapping."""
    return index << 16 | subindex << 8 | bits


#: PDO number from 0 -> its content, and for TPDOs the event timer in milliseconds.
RPDOS = (
    (_mapped(0x6040, 16), _mapped(0x6060, 8)),
    (_mapped(0x6040, 16), _mapped(0x607A, 32)),
    (_mapped(0x6040, 16), _mapped(0x60FF, 32)),
    (_mapped(0x6040, 16), _mapped(0x6071, 16)),
)
TPDOS = (
    ((_mapped(0x6041, 16), _mapped(0x6061, 8), _mapped(0x1001, 8)), 100),
    ((_mapped(0x6064, 32), _mapped(0x606C, 32)), 50),
    ((_mapped(0x6077, 16), _mapped(0x6078, 16), _mapped(0x60F4, 32)), 100),
    ((_mapped(0x6079, 32), _mapped(TEMPERATURE, 16)), 200),
)


def entries(node: int, turn: int, rated_torque: float, rated_current: float) -> dict[Key, ObjectEntry]:
    """The dictionary of the drive with a node id; increments per turn, newton metres, amperes."""
    ratings = {
        (0x6075, 0): ObjectEntry("u32", "ro", round(1000 * rated_current)),
        (0x6076, 0): ObjectEntry("u32", "ro", round(1000 * rated_torque)),
    }
    return {**_communication(node), **_pdos(node), **_profile(turn), **ratings}


def _communication(node: int) -> dict[Key, ObjectEntry]:
    return {
        (0x1000, 0): ObjectEntry("u32", "ro", 0x0002_0192),
        (0x1001, 0): ObjectEntry("u8", "ro", mappable=True),
        (0x1003, 0): ObjectEntry("u8", "rw", 0, 0, 0),
        **{(0x1003, n): ObjectEntry("u32", "ro") for n in range(1, 5)},
        (0x1005, 0): ObjectEntry("u32", "rw", 0x80),
        (0x1008, 0): ObjectEntry("text", "ro", "lfield fake CiA 402 drive"),
        (0x1009, 0): ObjectEntry("text", "ro", "A"),
        (0x100A, 0): ObjectEntry("text", "ro", "1.0.3"),
        (0x1014, 0): ObjectEntry("u32", "rw", 0x80 + node),
        (0x1016, 0): ObjectEntry("u8", "ro", 1),
        (0x1016, 1): ObjectEntry("u32", "rw", 0, 0, 0x7FFFFF),
        (0x1017, 0): ObjectEntry("u16", "rw", 200),
        (0x1018, 0): ObjectEntry("u8", "ro", 4),
        (0x1018, 1): ObjectEntry("u32", "ro", VENDOR),
        (0x1018, 2): ObjectEntry("u32", "ro", PRODUCT),
        (0x1018, 3): ObjectEntry("u32", "ro", REVISION),
        (0x1018, 4): ObjectEntry("u32", "ro", 1000 + node),
        (0x1200, 0): ObjectEntry("u8", "ro", 2),
        (0x1200, 1): ObjectEntry("u32", "ro", 0x600 + node),
        (0x1200, 2): ObjectEntry("u32", "ro", 0x580 + node),
    }


def _pdos(node: int) -> dict[Key, ObjectEntry]:
    table: dict[Key, ObjectEntry] = {}
    for n, mapping in enumerate(RPDOS):
        table[0x1400 + n, 0] = ObjectEntry("u8", "ro", 2)
        table[0x1400 + n, 1] = ObjectEntry("u32", "rw", (0x200 + 0x100 * n) + node)
        table[0x1400 + n, 2] = ObjectEntry("u8", "rw", 255)
        table.update(_mapping(0x1600 + n, mapping))
    for n, (carried, timer) in enumerate(TPDOS):
        table[0x1800 + n, 0] = ObjectEntry("u8", "ro", 5)
        table[0x1800 + n, 1] = ObjectEntry("u32", "rw", (0x180 + 0x100 * n) + node)
        table[0x1800 + n, 2] = ObjectEntry("u8", "rw", 255)
        table[0x1800 + n, 3] = ObjectEntry("u16", "rw", 0)
        table[0x1800 + n, 5] = ObjectEntry("u16", "rw", timer)
        table.update(_mapping(0x1A00 + n, carried))
    return table


def _mapping(index: int, mapping: tuple[int, ...]) -> dict[Key, ObjectEntry]:
    filled = (*mapping, *(8 - len(mapping)) * (0,))
    slots = {(index, n + 1): ObjectEntry("u32", "rw", value) for n, value in enumerate(filled)}
    return {(index, 0): ObjectEntry("u8", "rw", len(mapping), 0, 8), **slots}


def _profile(turn: int) -> dict[Key, ObjectEntry]:
    """The objects of the drive profile; `turn` is a turn of the motor in increments."""
    return _state_objects(turn) | _motion_objects(turn)


def _state_objects(turn: int) -> dict[Key, ObjectEntry]:
    """Commands, states and measured values."""
    return {
        (TEMPERATURE, 0): ObjectEntry("i16", "ro", 250, mappable=True),
        (0x6007, 0): ObjectEntry("i16", "rw", 1, choices=(0, 1, 2, 3)),
        (0x603F, 0): ObjectEntry("u16", "ro", mappable=True),
        (0x6040, 0): ObjectEntry("u16", "rw", mappable=True),
        (0x6041, 0): ObjectEntry("u16", "ro", mappable=True),
        (0x605A, 0): ObjectEntry("i16", "rw", 2, 0, 8),
        (0x605B, 0): ObjectEntry("i16", "rw", 0, 0, 1),
        (0x605C, 0): ObjectEntry("i16", "rw", 1, 0, 1),
        (0x605D, 0): ObjectEntry("i16", "rw", 1, 1, 4),
        (0x605E, 0): ObjectEntry("i16", "rw", 2, 0, 4),
        (0x6060, 0): ObjectEntry("i8", "rw", mappable=True, choices=MODES),
        (0x6061, 0): ObjectEntry("i8", "ro", mappable=True),
        (0x6062, 0): ObjectEntry("i32", "ro", mappable=True),
        (0x6064, 0): ObjectEntry("i32", "ro", mappable=True),
        (0x6065, 0): ObjectEntry("u32", "rw", turn // 4),
        (0x6066, 0): ObjectEntry("u16", "rw", 100),
        (0x6067, 0): ObjectEntry("u32", "rw", 40),
        (0x6068, 0): ObjectEntry("u16", "rw", 20),
        (0x606B, 0): ObjectEntry("i32", "ro", mappable=True),
        (0x606C, 0): ObjectEntry("i32", "ro", mappable=True),
        (0x606D, 0): ObjectEntry("u16", "rw", 400),
        (0x606E, 0): ObjectEntry("u16", "rw", 20),
        (0x6071, 0): ObjectEntry("i16", "rw", mappable=True),
        (0x6072, 0): ObjectEntry("u16", "rw", 3000, 0, 3000, mappable=True),
        (0x6073, 0): ObjectEntry("u16", "rw", 3000, 0, 3000),
        (0x6074, 0): ObjectEntry("i16", "ro", mappable=True),
        (0x6077, 0): ObjectEntry("i16", "ro", mappable=True),
        (0x6078, 0): ObjectEntry("i16", "ro", mappable=True),
        (0x6079, 0): ObjectEntry("u32", "ro", 48_000, mappable=True),
    }


def _motion_objects(turn: int) -> dict[Key, ObjectEntry]:
    """Targets and profiles of motion."""
    return {
        (0x607A, 0): ObjectEntry("i32", "rw", mappable=True),
        (0x607C, 0): ObjectEntry("i32", "rw"),
        (0x607D, 0): ObjectEntry("u8", "ro", 2),
        (0x607D, 1): ObjectEntry("i32", "rw"),
        (0x607D, 2): ObjectEntry("i32", "rw"),
        (0x607F, 0): ObjectEntry("u32", "rw", 50 * turn),
        (0x6080, 0): ObjectEntry("u32", "rw", 3000, 0, 3000, mappable=True),
        (0x6081, 0): ObjectEntry("u32", "rw", 5 * turn, mappable=True),
        (0x6083, 0): ObjectEntry("u32", "rw", 10 * turn, 1, _MAX, mappable=True),
        (0x6084, 0): ObjectEntry("u32", "rw", 10 * turn, 1, _MAX, mappable=True),
        (0x6085, 0): ObjectEntry("u32", "rw", 50 * turn, 1, _MAX),
        (0x6087, 0): ObjectEntry("u32", "rw", 5000, 1, _MAX),
        (0x608F, 0): ObjectEntry("u8", "ro", 2),
        (0x608F, 1): ObjectEntry("u32", "ro", turn),
        (0x608F, 2): ObjectEntry("u32", "ro", 1),
        (0x6091, 0): ObjectEntry("u8", "ro", 2),
        (0x6091, 1): ObjectEntry("u32", "ro", 1),
        (0x6091, 2): ObjectEntry("u32", "ro", 1),
        (0x6098, 0): ObjectEntry("i8", "rw", 0, choices=HOMING_METHODS),
        (0x6099, 0): ObjectEntry("u8", "ro", 2),
        (0x6099, 1): ObjectEntry("u32", "rw", turn, 1, _MAX),
        (0x6099, 2): ObjectEntry("u32", "rw", turn // 4, 1, _MAX),
        (0x609A, 0): ObjectEntry("u32", "rw", 10 * turn, 1, _MAX),
        (0x60B1, 0): ObjectEntry("i32", "rw", mappable=True),
        (0x60B2, 0): ObjectEntry("i16", "rw", mappable=True),
        (0x60C5, 0): ObjectEntry("u32", "rw", 200 * turn, 1, _MAX),
        (0x60C6, 0): ObjectEntry("u32", "rw", 200 * turn, 1, _MAX),
        (0x60E0, 0): ObjectEntry("u16", "rw", 3000, 0, 3000, mappable=True),
        (0x60E1, 0): ObjectEntry("u16", "rw", 3000, 0, 3000, mappable=True),
        (0x60F4, 0): ObjectEntry("i32", "ro", mappable=True),
        (0x60FF, 0): ObjectEntry("i32", "rw", mappable=True),
        (0x6502, 0): ObjectEntry("u32", "ro", sum(1 << mode - 1 for mode in MODES if mode)),
    }


class DriveState(Enum):
    """Drive states: bits 0 to 6 of the statusword, without bit 4 (voltage enabled)."""

    NOT_READY = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


class DriveCommand(Enum):
    """Commands of a controlword: mask and value."""

    SHUTDOWN = (0x87, 0x06)
    SWITCH_ON = (0x8F, 0x07)
    ENABLE_OPERATION = (0x8F, 0x0F)
    DISABLE_VOLTAGE = (0x82, 0x00)
    QUICK_STOP = (0x86, 0x02)


#: Transitions by state and command. ENABLE_OPERATION from READY_TO_SWITCH_ON is transitions 3 and 4.
TRANSITIONS: Mapping[tuple[DriveState, DriveCommand], DriveState] = {
    (DriveState.SWITCH_ON_DISABLED, DriveCommand.SHUTDOWN): DriveState.READY_TO_SWITCH_ON,
    (DriveState.READY_TO_SWITCH_ON, DriveCommand.SWITCH_ON): DriveState.SWITCHED_ON,
    (DriveState.READY_TO_SWITCH_ON, DriveCommand.ENABLE_OPERATION): DriveState.OPERATION_ENABLED,
    (DriveState.READY_TO_SWITCH_ON, DriveCommand.DISABLE_VOLTAGE): DriveState.SWITCH_ON_DISABLED,
    (DriveState.READY_TO_SWITCH_ON, DriveCommand.QUICK_STOP): DriveState.SWITCH_ON_DISABLED,
    (DriveState.SWITCHED_ON, DriveCommand.ENABLE_OPERATION): DriveState.OPERATION_ENABLED,
    (DriveState.SWITCHED_ON, DriveCommand.SHUTDOWN): DriveState.READY_TO_SWITCH_ON,
    (DriveState.SWITCHED_ON, DriveCommand.DISABLE_VOLTAGE): DriveState.SWITCH_ON_DISABLED,
    (DriveState.SWITCHED_ON, DriveCommand.QUICK_STOP): DriveState.SWITCH_ON_DISABLED,
    (DriveState.OPERATION_ENABLED, DriveCommand.SWITCH_ON): DriveState.SWITCHED_ON,
    (DriveState.OPERATION_ENABLED, DriveCommand.SHUTDOWN): DriveState.READY_TO_SWITCH_ON,
    (DriveState.OPERATION_ENABLED, DriveCommand.DISABLE_VOLTAGE): DriveState.SWITCH_ON_DISABLED,
    (DriveState.OPERATION_ENABLED, DriveCommand.QUICK_STOP): DriveState.QUICK_STOP_ACTIVE,
    (DriveState.QUICK_STOP_ACTIVE, DriveCommand.DISABLE_VOLTAGE): DriveState.SWITCH_ON_DISABLED,
    (DriveState.QUICK_STOP_ACTIVE, DriveCommand.ENABLE_OPERATION): DriveState.OPERATION_ENABLED,
}

#: The end of operation on the way to these states: 0 lets the motor coast, 1 ramps it down first.
END_OPTIONS: Mapping[DriveState, int] = {
    DriveState.READY_TO_SWITCH_ON: 0x605B,
    DriveState.SWITCHED_ON: 0x605C,
}

#: States in which the power stage drives the motor.
POWERED = frozenset(
    {DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT_REACTION_ACTIVE}
)


def command_of(controlword: int) -> DriveCommand | None:
    """The command of a controlword."""
    return next((c for c in DriveCommand if controlword & c.value[0] == c.value[1]), None)
