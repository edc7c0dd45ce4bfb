"""Faults of a simulated device by name: definitions and present values, for all devices or one.

The values can be changed at runtime:

loss=0.1               a share, for every device of the simulated device
dead@3=true            of device 3 only
silent@alpha.fc=true   by the name of the device's binding in a mission
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from msgspec import Struct

FaultValue = bool | float | str


class Fault(Struct, frozen=True):
    """One fault. The type of `default` is the type of its values; it means "healthy".

    A fault with `whole` applies to the whole link or bus; the name of a device then selects its bus.
    """

    name: str
    default: FaultValue
    meaning: str
    minimum: float = -math.inf
    maximum: float = math.inf
    whole: bool = False

    def parse(self, text: str) -> FaultValue:
        """The value of a text. Raises ValueError."""
        if isinstance(self.default, str):
            return text
        if isinstance(self.default, bool):
            if text not in ("true", "false"):
                raise ValueError(f"{self.name} is true or false, not '{text}'")
            return text == "true"
        try:
            value = float(text)
        except ValueError:
            raise ValueError(f"{self.name} is a number, not '{text}'") from None
        if not self.minimum <= value <= self.maximum:
            raise ValueError(f"{self.name} is from {self.minimum:g} to {self.maximum:g}, not {text}")
        return value


def share(name: str, meaning: str) -> Fault:
    """A fault that is a probability: 0 healthy, 1 always."""
    return Fault(name, 0.0, meaning, 0.0, 1.0)


class Faults:
    """The faults of a fake. `devices` are their ids, with the names of their bindings."""

    def __init__(self, definitions: Iterable[Fault], devices: Mapping[str, str] | Iterable[str] = ()) -> None:
        self._definitions = {fault.name: fault for fault in definitions}
        self._names = dict(devices) if isinstance(devices, Mapping) else dict.fromkeys(devices, "")
        self._values: dict[tuple[str, str], FaultValue] = {}
        self._watchers: list[Callable[[], None]] = []

    def watch(self, on_change: Callable[[], None]) -> None:
        """Calls `on_change` after every change."""
        self._watchers.append(on_change)

    def get(self, name: str, device: object = "") -> Any:
        """The value of a fault for a device (by its id), or for the whole simulated device."""
        if not self._values:
            return self._definitions[name].default
        own = self._values.get((name, str(device)))
        return self._values.get((name, ""), self._definitions[name].default) if own is None else own

    def apply(self, texts: Iterable[str]) -> None:
        """Sets `NAME[@DEVICE]=VALUE`, all or none. Raises ValueError."""
        parsed = [self._parse(text) for text in texts]
        self._values.update(parsed)
        for on_change in self._watchers:
            on_change()

    def _parse(self, text: str) -> tuple[tuple[str, str], FaultValue]:
        target, equals, value = text.partition("=")
        name, at, device = target.partition("@")
        if not equals:
            raise ValueError(f"'{text}' is not a fault; write NAME=VALUE or NAME@DEVICE=VALUE")
        if name not in self._definitions:
            raise ValueError(f"there is no fault '{name}'; there are: {', '.join(sorted(self._definitions))}")
        fault, target = self._definitions[name], self._device(device) if at else ""
        return (name, "" if fault.whole else target), fault.parse(value)

    def _device(self, name: str) -> str:
        if name in self._names:
            return name
        for device, name_of_binding in self._names.items():
            if name_of_binding == name:
                return device
        definitions = ", ".join(
            f"{device} ({name_of_binding})" if name_of_binding else device
            for device, name_of_binding in self._names.items()
        )
        raise ValueError(f"there is no device '{name}'; there are: {definitions or 'none with names'}")

    def described(self) -> dict[str, str]:
        """Every fault with its present value and meaning."""
        lines = {}
        for fault in self._definitions.values():
            values = [f"{_text(self.get(fault.name))}"]
            values += [
                f"@{d}={_text(v)}" for (name, d), v in self._values.items() if name == fault.name and d
            ]
            lines[fault.name] = f"{' '.join(values)}  ({fault.meaning})"
        return lines


def add_fault_option(parser: argparse.ArgumentParser) -> None:
    """Adds `--fault NAME=VALUE`, repeatable: faults from the start."""
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="NAME[@DEVICE]=VALUE",
        help="fault that is present from the start (repeatable)",
    )


def _text(value: FaultValue) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
