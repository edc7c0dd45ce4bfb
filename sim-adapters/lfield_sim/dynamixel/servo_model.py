"""Registers, ranges and strength of servo models. Data only.

Sources: the models' pages under https://emanual.robotis.com/docs/en/dxl/.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from msgspec import Struct, field
from msgspec.structs import replace

from lfield.errors import UsageError

#: Bits per second by the value of the Baud Rate register, protocol 2.0 models.
BAUDS = (9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)

#: The same for STS servos.
STS_BAUDS = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)

#: Operating modes by the value of their register.
CURRENT, VELOCITY, POSITION, EXTENDED, CURRENT_POSITION, PWM = 0, 1, 3, 4, 5, 16
#: Drive Mode: reverse (1), time-based profile (4) and torque on by goal update (8); and slave (2) for models
#: with a sync cable.
DRIVE_MODES = (0, 1, 4, 5, 8, 9, 12, 13)
DUAL_DRIVE_MODES = tuple(range(16))

_MANUAL = "https://emanual.robotis.com/docs/en/dxl/"
_RPM = math.tau / 60.0


class Register(Struct, frozen=True):
    """One register. `low` to `high` is its range; `choices`, if any, are the only values.

    `limit` names the register that bounds its magnitude at runtime.
    """

    name: str
    address: int
    size: int
    initial: int = 0
    low: int = 0
    high: int = 0
    writable: bool = True
    eeprom: bool = False
    limit: str = ""
    choices: Sequence[int] = ()

    @property
    def signed(self) -> bool:
        """Whether the register is two's complement; a read-only one is if its limits are negative."""
        return self.low < 0


def _rom(address: int, size: int, name: str, initial: int, low: int, high: int) -> Register:
    return Register(name, address, size, initial, low, high, eeprom=True)


def _ram(address: int, size: int, name: str, initial: int, low: int, high: int, limit: str = "") -> Register:
    return Register(name, address, size, initial, low, high, limit=limit)


def _read_only(address: int, size: int, name: str, initial: int = 0, *, signed: bool = False) -> Register:
    return Register(name, address, size, initial, -1 if signed else 0, writable=False, eeprom=address < 64)


#: The maximum goal, in counts: 255 turns.
TURNS = 1_048_575

X_SERIES = (
    _read_only(0, 2, "model_number"),
    _read_only(2, 4, "model_information"),
    _read_only(6, 1, "firmware_version", 52),
    _rom(7, 1, "id", 1, 0, 252),
    _rom(8, 1, "baud_rate", 1, 0, 7),
    _rom(9, 1, "return_delay_time", 250, 0, 254),
    _rom(10, 1, "drive_mode", 0, 0, 15),
    _rom(11, 1, "operating_mode", 3, 0, 16),
    _rom(12, 1, "secondary_id", 255, 0, 255),
    _rom(13, 1, "protocol_type", 2, 1, 2),
    _rom(20, 4, "homing_offset", 0, -1_044_479, 1_044_479),
    _rom(24, 4, "moving_threshold", 10, 0, 1_023),
    _rom(31, 1, "temperature_limit", 80, 0, 100),
    _rom(32, 2, "max_voltage_limit", 160, 95, 160),
    _rom(34, 2, "min_voltage_limit", 95, 95, 160),
    _rom(36, 2, "pwm_limit", 885, 0, 885),
    _rom(38, 2, "current_limit", 1_193, 0, 1_193),
    _rom(44, 4, "velocity_limit", 200, 0, 1_023),
    _rom(48, 4, "max_position_limit", 4_095, 0, 4_095),
    _rom(52, 4, "min_position_limit", 0, 0, 4_095),
    _rom(60, 1, "startup_configuration", 0, 0, 3),
    _rom(63, 1, "shutdown", 52, 0, 63),
    _ram(64, 1, "torque_enable", 0, 0, 1),
    _ram(65, 1, "led", 0, 0, 1),
    _ram(68, 1, "status_return_level", 2, 0, 2),
    _read_only(69, 1, "registered_instruction"),
    _read_only(70, 1, "hardware_error_status"),
    _ram(76, 2, "velocity_i_gain", 1_920, 0, 16_383),
    _ram(78, 2, "velocity_p_gain", 100, 0, 16_383),
    _ram(80, 2, "position_d_gain", 0, 0, 16_383),
    _ram(82, 2, "position_i_gain", 0, 0, 16_383),
    _ram(84, 2, "position_p_gain", 800, 0, 16_383),
    _ram(88, 2, "feedforward_2nd_gain", 0, 0, 16_383),
    _ram(90, 2, "feedforward_1st_gain", 0, 0, 16_383),
    _ram(98, 1, "bus_watchdog", 0, 0, 127),
    _ram(100, 2, "goal_pwm", 885, -32_768, 32_767, "pwm_limit"),
    _ram(102, 2, "goal_current", 0, -32_768, 32_767, "current_limit"),
    _ram(104, 4, "goal_velocity", 0, -(1 << 31), (1 << 31) - 1, "velocity_limit"),
    _ram(108, 4, "profile_acceleration", 0, 0, 32_767),
    _ram(112, 4, "profile_velocity", 0, 0, 32_767),
    _ram(116, 4, "goal_position", 0, -TURNS, TURNS),
    _read_only(120, 2, "realtime_tick"),
    _read_only(122, 1, "moving"),
    _read_only(123, 1, "moving_status"),
    _read_only(124, 2, "present_pwm", signed=True),
    _read_only(126, 2, "present_current", signed=True),
    _read_only(128, 4, "present_velocity", signed=True),
    _read_only(132, 4, "present_position", signed=True),
    _read_only(136, 4, "velocity_trajectory", signed=True),
    _read_only(140, 4, "position_trajectory", signed=True),
    _read_only(144, 2, "present_input_voltage"),
    _read_only(146, 1, "present_temperature"),
    _read_only(147, 1, "backup_ready"),
)


class MotorStrength(Struct, frozen=True):
    """The motor at nominal voltage, in N m, A, rad/s and V.

    `unit` is amperes per count of current; 0 if the register is a load in 0.1 percent instead.
    """

    stall_torque: float
    stall_current: float
    fastest: float
    voltage: float
    unit: float


class ServoModel(Struct, frozen=True):
    """A servo model: registers by name, strength, and its page in the manual.

    `indirect` are blocks of (first address register, first data register, count). `protocol` is 1 or 0
    (Feetech) for a model that supports only that.
    """

    name: str
    page: str
    items: Mapping[str, Register]
    strength: MotorStrength
    indirect: Sequence[tuple[int, int, int]] = ()
    protocol: int = 2

    @property
    def number(self) -> int:
        """The model number in the answer to a ping."""
        return self.items["model_number"].initial


class _Row(Struct, frozen=True):
    """Differences of a model from the table above."""

    number: int
    page: str
    strength: MotorStrength
    ranges: Mapping[str, tuple[int, int, int]] = field(default_factory=dict)
    initial: Mapping[str, int] = field(default_factory=dict)
    missing_items: Sequence[str] = ()
    modes: Sequence[int] = (CURRENT, VELOCITY, POSITION, EXTENDED, CURRENT_POSITION, PWM)
    wide: bool = True
    dual: bool = False


#: Common registers of the 330 series: initial value, lowest, highest.
_330 = {
    "baud_rate": (1, 0, 6),
    "protocol_type": (2, 2, 22),
    "temperature_limit": (70, 0, 100),
    "max_voltage_limit": (70, 31, 70),
    "min_voltage_limit": (35, 31, 70),
}
_XL330 = {**_330, "shutdown": (53, 0, 63), "current_limit": (1_750, 0, 1_750)}
_XC330 = {**_330, "current_limit": (2_352, 0, 2_352), "velocity_limit": (350, 0, 2_047)}
_XL330_GAINS = {"velocity_i_gain": 1_600, "velocity_p_gain": 180, "position_p_gain": 400}
_XC330_GAINS = {**_XL330_GAINS, "velocity_p_gain": 50, "position_d_gain": 500, "position_p_gain": 1_100}
_XL430 = {
    "temperature_limit": (72, 0, 100),
    "max_voltage_limit": (140, 60, 140),
    "min_voltage_limit": (60, 60, 140),
    "velocity_limit": (265, 0, 1_023),
}
_XL430_GAINS = {"velocity_i_gain": 1_000, "position_d_gain": 4_000, "position_p_gain": 640}

_ROWS = {
    "XL330-M288": _Row(
        1200,
        "x/xl330-m288/",
        MotorStrength(0.52, 1.47, 103 * _RPM, 5.0, 0.001),
        {**_XL330, "velocity_limit": (445, 0, 2_047)},
        _XL330_GAINS,
        wide=False,
    ),
    "XL330-M077": _Row(
        1190,
        "x/xl330-m077/",
        MotorStrength(0.215, 1.47, 383 * _RPM, 5.0, 0.001),
        {**_XL330, "velocity_limit": (1_620, 0, 2_047)},
        _XL330_GAINS,
        wide=False,
    ),
    "XC330-M288": _Row(
        1240,
        "x/xc330-m288/",
        MotorStrength(0.93, 1.8, 81 * _RPM, 5.0, 0.001),
        _XC330,
        _XC330_GAINS,
        wide=False,
    ),
    "XL430-W250": _Row(
        1060,
        "x/xl430-w250/",
        MotorStrength(1.5, 1.4, 61 * _RPM, 12.0, 0.0),
        _XL430,
        _XL430_GAINS,
        missing_items=("current_limit", "goal_current"),
        modes=(VELOCITY, POSITION, EXTENDED, PWM),
    ),
    "XM430-W350": _Row(1020, "x/xm430-w350/", MotorStrength(4.1, 2.3, 46 * _RPM, 12.0, 0.00269)),
    "XM430-W210": _Row(
        1030,
        "x/xm430-w210/",
        MotorStrength(3.0, 2.3, 77 * _RPM, 12.0, 0.00269),
        {"velocity_limit": (330, 0, 1_023)},
    ),
    "XM540-W270": _Row(
        1120,
        "x/xm540-w270/",
        MotorStrength(10.6, 4.4, 30 * _RPM, 12.0, 0.00269),
        {"current_limit": (2_047, 0, 2_047), "velocity_limit": (128, 0, 1_023)},
        dual=True,
    ),
}


def _indirect(wide: bool) -> Sequence[tuple[int, int, int]]:
    return ((168, 224, 28), (578, 634, 28)) if wide else ((168, 208, 20),)


def _items(row: _Row) -> dict[str, Register]:
    items = {item.name: item for item in X_SERIES if item.name not in row.missing_items}
    for name, (initial, low, high) in row.ranges.items():
        items[name] = replace(items[name], initial=initial, low=low, high=high)
    for name, initial in {**row.initial, "model_number": row.number}.items():
        items[name] = replace(items[name], initial=initial)
    drive_modes = DUAL_DRIVE_MODES if row.dual else DRIVE_MODES
    items["drive_mode"] = replace(items["drive_mode"], choices=drive_modes)
    items["operating_mode"] = replace(items["operating_mode"], choices=row.modes)
    return items | _indirect_items(_indirect(row.wide))


def _indirect_items(blocks: Sequence[tuple[int, int, int]]) -> dict[str, Register]:
    """Pairs of an address register and a byte of data; each initially refers to its own byte."""
    last = blocks[-1][1] + blocks[-1][2] - 1
    items: list[Register] = []
    for first, data, count in blocks:
        for place in range(count):
            number = 1 + len(items) // 2
            pointer = _ram(first + 2 * place, 2, f"indirect_address_{number}", data + place, 64, last)
            items += [pointer, _ram(data + place, 1, f"indirect_data_{number}", 0, 0, 255)]
    return {item.name: item for item in items}


def _model(name: str, row: _Row) -> ServoModel:
    items = MappingProxyType(_items(row))
    return ServoModel(name, f"{_MANUAL}{row.page}", items, row.strength, _indirect(row.wide))


#: AX-12A: protocol 1.0 only, another table, no modes and no profiles.
AX_SERIES = (
    _read_only(0, 2, "model_number", 12),
    _read_only(2, 1, "firmware_version", 24),
    _rom(3, 1, "id", 1, 0, 253),
    _rom(4, 1, "baud_rate", 1, 0, 254),
    _rom(5, 1, "return_delay_time", 250, 0, 254),
    _rom(6, 2, "cw_angle_limit", 0, 0, 1_023),
    _rom(8, 2, "ccw_angle_limit", 1_023, 0, 1_023),
    _rom(11, 1, "temperature_limit", 70, 0, 150),
    _rom(12, 1, "min_voltage_limit", 60, 50, 250),
    _rom(13, 1, "max_voltage_limit", 140, 50, 250),
    _rom(14, 2, "max_torque", 1_023, 0, 1_023),
    _rom(16, 1, "status_return_level", 2, 0, 2),
    _rom(17, 1, "alarm_led", 36, 0, 127),
    _rom(18, 1, "shutdown", 36, 0, 127),
    _ram(24, 1, "torque_enable", 0, 0, 1),
    _ram(25, 1, "led", 0, 0, 1),
    _ram(26, 1, "cw_compliance_margin", 1, 0, 255),
    _ram(27, 1, "ccw_compliance_margin", 1, 0, 255),
    _ram(28, 1, "cw_compliance_slope", 32, 0, 255),
    _ram(29, 1, "ccw_compliance_slope", 32, 0, 255),
    _ram(30, 2, "goal_position", 512, 0, 1_023),
    _ram(32, 2, "moving_speed", 0, 0, 2_047),
    _ram(34, 2, "torque_limit", 1_023, 0, 1_023),
    _read_only(36, 2, "present_position", 512),
    _read_only(38, 2, "present_speed"),
    _read_only(40, 2, "present_load"),
    _read_only(42, 1, "present_voltage", 120),
    _read_only(43, 1, "present_temperature", 30),
    _read_only(44, 1, "registered_instruction"),
    _read_only(46, 1, "moving"),
    _ram(47, 1, "lock", 0, 0, 1),
    _ram(48, 2, "punch", 32, 0, 1_023),
)

_AX_12A = ServoModel(
    "AX-12A",
    f"{_MANUAL}ax/ax-12a/",
    MappingProxyType({item.name: replace(item, eeprom=item.address < 24) for item in AX_SERIES}),
    MotorStrength(1.5, 1.5, 59 * _RPM, 12.0, 0.0),
    protocol=1,
)

#: STS series: as in protocol 1.0, another table. A raw value has a sign bit.
STS_SERIES = (
    _read_only(0, 1, "firmware_version", 3),
    _read_only(1, 1, "firmware_minor", 10),
    _read_only(2, 1, "big_endian"),
    _read_only(3, 2, "model_number", 777),
    _rom(5, 1, "id", 1, 0, 253),
    _rom(6, 1, "baud_rate", 0, 0, 7),
    _rom(7, 1, "return_delay_time", 250, 0, 254),
    _rom(8, 1, "status_return_level", 1, 0, 1),
    _rom(9, 2, "min_position_limit", 0, 0, 4_095),
    _rom(11, 2, "max_position_limit", 4_095, 0, 4_095),
    _rom(13, 1, "temperature_limit", 70, 0, 100),
    _rom(14, 1, "max_voltage_limit", 80, 0, 254),
    _rom(15, 1, "min_voltage_limit", 40, 0, 254),
    _rom(16, 2, "max_torque", 1_000, 0, 1_000),
    _rom(18, 1, "phase", 12, 0, 254),
    _rom(19, 1, "unloading_condition", 44, 0, 254),
    _rom(20, 1, "alarm_led", 47, 0, 254),
    _rom(21, 1, "p_coefficient", 32, 0, 254),
    _rom(22, 1, "d_coefficient", 32, 0, 254),
    _rom(23, 1, "i_coefficient", 0, 0, 254),
    _rom(24, 2, "startup_force", 16, 0, 1_000),
    _rom(26, 1, "cw_dead_zone", 1, 0, 32),
    _rom(27, 1, "ccw_dead_zone", 1, 0, 32),
    _rom(28, 2, "protection_current", 500, 0, 511),
    _rom(30, 1, "angular_resolution", 1, 1, 3),
    _rom(31, 2, "homing_offset", 0, 0, 4_095),
    _rom(33, 1, "operating_mode", 0, 0, 3),
    _rom(34, 1, "protective_torque", 20, 0, 100),
    _rom(35, 1, "protection_time", 200, 0, 254),
    _rom(36, 1, "overload_torque", 80, 0, 100),
    _rom(37, 1, "velocity_p", 10, 0, 100),
    _rom(38, 1, "over_current_time", 200, 0, 254),
    _rom(39, 1, "velocity_i", 10, 0, 254),
    replace(_ram(40, 1, "torque_enable", 0, 0, 128), choices=(0, 1, 2, 128)),
    _ram(41, 1, "acceleration", 0, 0, 254),
    _ram(42, 2, "goal_position", 2_048, 0, 65_535),
    _ram(44, 2, "goal_time", 0, 0, 1_000),
    _ram(46, 2, "goal_velocity", 0, 0, 65_535),
    _ram(48, 2, "torque_limit", 1_000, 0, 1_000),
    _ram(55, 1, "lock", 1, 0, 1),
    _read_only(56, 2, "present_position", 2_048),
    _read_only(58, 2, "present_velocity"),
    _read_only(60, 2, "present_load"),
    _read_only(62, 1, "present_voltage", 74),
    _read_only(63, 1, "present_temperature", 30),
    _read_only(64, 1, "registered_instruction"),
    _read_only(65, 1, "status"),
    _read_only(66, 1, "moving"),
    _read_only(69, 2, "present_current"),
    *(_rom(80 + place, 1, f"factory_{80 + place}", 0, 0, 254) for place in range(7)),
)

_STS3215 = ServoModel(
    "STS3215",
    "http://doc.feetech.cn/#/prodinfodownload?srcType=FT-SMS-STS-emanual-229f4476422d4059abfb1cb0",
    MappingProxyType({item.name: item for item in STS_SERIES}),
    MotorStrength(1.91, 2.4, 52 * _RPM, 7.4, 0.0065),
    protocol=0,
)

MODELS: Mapping[str, ServoModel] = MappingProxyType(
    {model.name: model for model in (*itertools.starmap(_model, _ROWS.items()), _AX_12A, _STS3215)}
)


def model_named(name: str) -> ServoModel:
    """The model of that name, ignoring a suffix -T or -R. Raises UsageError."""
    base_name = name.upper().removesuffix("-T").removesuffix("-R")
    if base_name not in MODELS:
        raise UsageError(f"there is no simulation of the servo '{name}'; there are: {', '.join(MODELS)}")
    return MODELS[base_name]
