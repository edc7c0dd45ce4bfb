"""Stored registers that a binding requires: that a servo answers writes, and the values of its calibration.

All are read when a device is opened, and written only by `lfield setup`. The name of a setting is that of
its register with the id of the servo: `homing_offset of servo 3`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from lfield.driver import Setting
from lfield_dynamixel.servo import STATUS_RETURN_LEVEL, Servo

#: Bits of the phase register of a Feetech servo: speeds are steps per second, the speed 0 is the greatest,
#: and positions count several turns.
_STEPS, _ZERO_IS_GREATEST, _SEVERAL_TURNS = 1 << 2, 1 << 3, 1 << 4
#: The bit of the drive mode of a DYNAMIXEL servo that reverses it.
_REVERSED = 1

_CALIBRATED = ("homing_offset", "min_position_limit", "max_position_limit")


async def settings_of(servos: Iterable[Servo], calibration: str) -> list[Setting]:
    """The settings of all servos with their present values. `calibration` is its file, '' for none."""
    settings = []
    for servo in servos:
        for item, (value, reason) in (await _required(servo, Path(calibration).name)).items():
            settings.append(
                Setting(f"{item} of servo {servo.node.number}", await servo.read_item(item), value, reason)
            )
    return settings


async def _required(servo: Servo, file: str) -> Mapping[str, tuple[int, str]]:
    """The required values by register, each with the reason."""
    model, required = servo.model, dict[str, tuple[int, str]]()
    if servo.keeps_answers:
        required[STATUS_RETURN_LEVEL] = (model.answers, "it answers writes")
    if model.has("phase"):
        phase = (await servo.read_item("phase") | _STEPS | _ZERO_IS_GREATEST) & ~_SEVERAL_TURNS
        required["phase"] = (phase, "speeds are steps per second and positions are within one turn")
    if (entry := servo.joint.calibration) is not None:
        reason = f"calibration of {servo.joint.name} in {file}; check that the file is of this servo"
        values = zip(_CALIBRATED, (entry.homing_offset, entry.range_min, entry.range_max), strict=True)
        required |= {item: (value, reason) for item, value in values if model.has(item)}
        if model.has("drive_mode"):
            drive_mode = await servo.read_item("drive_mode") & ~_REVERSED | entry.drive_mode
            required["drive_mode"] = (drive_mode, reason)
    return required


async def write_setting(servos: Mapping[int, Servo], name: str, value: int) -> None:
    """Writes one setting by its name, and confirms it. Raises DeviceError."""
    item, _, number = name.partition(" of servo ")
    servo = servos[int(number)]
    if item == STATUS_RETURN_LEVEL:
        await servo.set_return_level(value)
    else:
        await servo.write_eeprom(**{item: value})
