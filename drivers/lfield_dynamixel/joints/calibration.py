"""Calibration files of LeRobot: one entry for each joint, as `lerobot-calibrate` writes them.

`homing_offset`, `range_min` and `range_max` are values of the servo's own registers (homing offset, position
limits), in counts. Angle 0 is in the middle of the range, as in LeRobot's degrees. `drive_mode` 1 reverses a
Feetech joint; in a DYNAMIXEL servo it is bit 0 of the drive mode register, which the servo itself applies.
"""

from __future__ import annotations

import codecs
import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import msgspec

from lfield.driver import DeviceError, read_within

#: The option of a binding that names the file.
OPTION = "calibration"
#: A longer file is not a calibration.
MAX_BYTES = 1 << 20

_Counts = Annotated[int, msgspec.Meta(ge=0, le=65_535)]


class JointCalibration(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The entry of one joint: the id of its servo and values of its registers, in counts."""

    id: Annotated[int, msgspec.Meta(ge=0, le=252)]
    drive_mode: Annotated[int, msgspec.Meta(ge=0, le=1)]
    homing_offset: Annotated[int, msgspec.Meta(ge=-65_535, le=65_535)]
    range_min: _Counts
    range_max: _Counts


def read(path: str) -> dict[str, JointCalibration]:
    """The joints of a file by name. Raises DeviceError for a file that cannot be read, or is wrong."""
    try:
        return parsed(path, read_within(Path(path), MAX_BYTES))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise DeviceError(OPTION, f"{path} cannot be read: {reason}") from None


def parsed(name: str, data: bytes) -> dict[str, JointCalibration]:
    """The joints in the bytes of a file. Raises DeviceError with all mistakes."""
    data = data.removeprefix(codecs.BOM_UTF8)
    try:
        joints = msgspec.json.decode(data, type=dict[str, JointCalibration])
    except msgspec.DecodeError as error:
        hint = "; it is of an older LeRobot: run lerobot-calibrate again" if b'"motor_names"' in data else ""
        raise DeviceError(OPTION, f"{name} is not a calibration of LeRobot: {error}{hint}") from None
    mistakes = [
        f"joint {joint!r}: {mistake}"
        for joint, entry in joints.items()
        if (mistake := _mistake(joint, entry))
    ]
    repeated_ids = [id for id, count in Counter(entry.id for entry in joints.values()).items() if count > 1]
    mistakes += [f"two joints have the servo id {id}" for id in repeated_ids]
    mistakes += [f"'{key}' is written twice" for key in _repeated_keys(data)]
    if mistakes or not joints:
        raise DeviceError(OPTION, f"{name}: {'; '.join(mistakes) or 'it has no joints'}")
    return joints


def _repeated_keys(data: bytes) -> list[str]:
    """The keys that an object of a JSON text has more than once; decoders silently use the last one."""
    repeated_keys: list[str] = []

    def check(pairs: list[tuple[str, object]]) -> None:
        repeated_keys.extend(key for key, count in Counter(key for key, _ in pairs).items() if count > 1)

    json.loads(data, object_pairs_hook=check)
    return repeated_keys


def mistakes_in(option: str, file: str) -> tuple[()]:
    """No mistakes; raises DeviceError with all mistakes in the file of an option."""
    read(file)
    return ()


def for_servos(path: str, numbers: list[int], names: list[str]) -> Mapping[int, tuple[str, JointCalibration]]:
    """The name and entry of each servo, by its id. Raises DeviceError, also for a missing joint.

    `names` are those of the binding, in the order of the ids; empty if it has none.
    """
    by_id = {entry.id: (joint, entry) for joint, entry in read(path).items()}
    mistakes = [f"it has no joint of servo {number}" for number in numbers if number not in by_id]
    for number, name in zip(numbers, names, strict=False):
        if number in by_id and by_id[number][0] != name:
            mistakes.append(
                f"servo {number} is the joint '{by_id[number][0]}' in it, but the binding says '{name}'"
            )
    if mistakes:
        raise DeviceError(OPTION, f"{path}: {'; '.join(mistakes)}")
    return {number: by_id[number] for number in numbers}


def _mistake(joint: str, entry: JointCalibration) -> str:
    if not joint.isprintable() or not joint.strip():
        return "its name is not printable"
    low, high = entry.range_min, entry.range_max
    if low < high:
        return ""
    fault = "is reversed" if low > high else "is empty"
    return f"its range {fault} (range_min {low}, range_max {high}); calibrate it again"
