"""The mounting of the servos of a device: the name, direction, zero and bounds of each joint. Pure.

angle of a joint = direction * (angle of its servo - zero) + offset. The zero and the bounds of a calibrated
joint are in counts in its file, so they are known as soon as the model is known.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from lfield.driver import DeviceBinding, DeviceError
from lfield_dynamixel.control_tables import Model
from lfield_dynamixel.joints.calibration import OPTION, JointCalibration, for_servos

#: An angle beyond this is no bound, as the manifest says.
_NO_BOUND = 1.0e9


class Joint(Struct, frozen=True):
    """One joint and the id of its servo. `direction` is 1 or -1; angles are in rad.

    `zero` is the angle of the servo where the joint is at `offset`.
    """

    number: int
    name: str = ""
    direction: int = 1
    zero: float = 0.0
    offset: float = 0.0
    lowest: float = -_NO_BOUND
    highest: float = _NO_BOUND
    calibration: JointCalibration | None = None

    @property
    def label(self) -> str:
        """The servo of the joint in a message: `3`, or `3 (elbow_flex)`."""
        return f"{self.number} ({self.name})" if self.name else f"{self.number}"

    def to_servo(self, angle: float) -> float:
        """The angle of the servo for an angle of the joint."""
        return self.direction * (angle - self.offset) + self.zero

    def to_joint(self, angle: float) -> float:
        """The angle of the joint for an angle of the servo."""
        return self.direction * (angle - self.zero) + self.offset

    def fitted(self, model: Model) -> Joint:
        """The joint with the zero and the bounds of its calibration for a model. Raises DeviceError."""
        entry = self.calibration
        if entry is None:
            return self
        last = model.last
        if entry.range_max > last or not model.has_homing(entry.homing_offset):
            values = f"range_max {entry.range_max}, homing_offset {entry.homing_offset}"
            raise DeviceError(
                OPTION,
                f"servo {self.label}: its calibration is not of a {model.name}, whose positions are 0 to "
                f"{last}: {values}",
            )
        drive_direction = -1 if entry.drive_mode and model.protocol != 2 else 1
        zero = model.to_angle(0) + model.position * (entry.range_min + entry.range_max) / 2.0
        joint = replace(self, direction=self.direction * drive_direction, zero=zero)
        low, high = sorted(joint.to_joint(model.to_angle(c)) for c in (entry.range_min, entry.range_max))
        return replace(joint, lowest=max(low, self.lowest), highest=min(high, self.highest))


def ids_of(binding: DeviceBinding) -> list[int]:
    """The ids of the servos in a binding, in order."""
    options = binding.options
    return list(binding.option("ids")) if "ids" in options else [binding.option("id")]


def joints_of(binding: DeviceBinding) -> dict[int, Joint]:
    """The joints of a binding by the ids of their servos, in order. Raises DeviceError."""
    numbers, names = ids_of(binding), _names(binding)
    if repeated := [number for number, count in Counter(numbers).items() if count > 1]:
        raise DeviceError(
            binding.field, f"its binding names servo {repeated[0]} twice; give each servo its own id"
        )
    if len(names) not in (0, len(numbers)) or len(set(names)) < len(names):
        raise DeviceError(
            binding.field, f"'names' must be {len(numbers)} different names, one for each id, not {names}"
        )
    path = binding.options.get(OPTION, "")
    calibrated = for_servos(str(path), numbers, names) if path else {}
    columns = [
        names or [calibrated[number][0] if calibrated else "" for number in numbers],
        _each(binding, "direction", len(numbers), 1),
        _each(binding, "offset", len(numbers), 0.0),
        _each(binding, "lowest", len(numbers), -_NO_BOUND),
        _each(binding, "highest", len(numbers), _NO_BOUND),
    ]
    joints = {}
    for number, name, direction, offset, low, high in zip(numbers, *columns, strict=True):
        if direction not in (1, -1) or not math.isfinite(offset) or not low <= high:
            raise DeviceError(
                binding.field,
                f"servo {number}: 'direction' must be 1 or -1, 'offset' a number and 'lowest' not above "
                f"'highest'; they are {direction}, {offset:g}, {low:g} and {high:g}",
            )
        entry = calibrated[number][1] if calibrated else None
        joints[number] = Joint(number, name, direction, 0.0, offset, low, high, entry)
    return joints


def _names(binding: DeviceBinding) -> list[str]:
    names = binding.options.get("names", [])
    return [str(name) for name in names] if isinstance(names, list) else []


def _each(binding: DeviceBinding, name: str, count: int, default: float) -> Sequence[Any]:
    """The value of an option for each servo: one for all, or a list with one for each. Raises DeviceError."""
    value = binding.options.get(name, default)
    values = value if isinstance(value, list) else [value]
    values = (values or [default]) * (count if len(values) < 2 else 1)
    if len(values) != count:
        raise DeviceError(
            binding.field,
            f"'{name}' must be one value for all, or {count}, one for each id, not {len(values)}",
        )
    return values


def conflicts_of(bindings: Sequence[DeviceBinding]) -> Iterator[tuple[DeviceBinding, str]]:
    """The bindings of a mission whose joints are wrong, or whose servos belong to another one, each with a
    sentence. Ports of different agents may be on different computers.
    """
    users: dict[tuple[str, str, int], DeviceBinding] = {}
    for binding in bindings:
        try:
            joints_of(binding)
        except DeviceError as error:
            yield binding, error.reason
            continue
        for number in ids_of(binding):
            other = users.setdefault((binding.agent, binding.endpoint, number), binding)
            if other is not binding:
                yield binding, f"servo {number} on {binding.endpoint} already belongs to {other.name}"
