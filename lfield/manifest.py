"""What a driver adds to L, as plain data: device types, instructions, telemetry.

A base module: the compiler reads it to check programs, the host to route calls, the driver to know
its own promises. Nobody needs the vendor library for that.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Effect = Literal["query", "idempotent", "actuate"]

#: L types that may cross between a program and a driver.
DEVICE_VALUE_TYPES = ("boolean", "int", "real", "string", "real[]", "int[]")

#: A value of one of those types, as Python sees it.
DeviceValue = bool | int | float | str | list[float] | list[int] | None


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of an instruction. `type` is an L type name, `unit` an SI unit or ''."""

    name: str
    type: str
    unit: str = ""
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class Instruction:
    """One library instruction of a device type: `fc.takeoff(10.0)`.

    `result` is an L type name or 'void'. `effect` says what a repeat would do: nothing at all (query),
    nothing new (idempotent), or act again (actuate). A query is answered from the last telemetry
    snapshot and never blocks; `blocking` instructions hold the calling thread until they are done.
    """

    name: str
    parameters: tuple[Parameter, ...] = ()
    result: str = "void"
    unit: str = ""
    effect: Effect = "actuate"
    blocking: bool = False
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class Quantity:
    """One telemetry quantity that the driver publishes and queries read. `max_age` in seconds."""

    name: str
    type: str
    unit: str = ""
    max_age: float = 3.0
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class DeviceManifest:
    """A device type as L sees it: `Mavlink fc;` with its instructions, telemetry and safe states."""

    type: str
    driver: str
    instructions: tuple[Instruction, ...]
    telemetry: tuple[Quantity, ...] = ()
    safe_states: tuple[str, ...] = ()
    meaning: str = ""
    bindings: dict[str, str] = field(default_factory=dict)

    def instruction(self, name: str) -> Instruction | None:
        """The instruction of that name, or None. A device type never overloads a name."""
        return next((i for i in self.instructions if i.name == name), None)
