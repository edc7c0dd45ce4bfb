"""The additions of a driver to L, as plain data: device types, instructions, telemetry.

This is a base module: the compiler uses the data to check programs, the host to route calls, and the driver
to check its own contract. The vendor library is not needed for this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from msgspec import Struct

Effect = Literal["query", "idempotent", "actuate"]

#: The effect of a cancel if no instruction is named that ends the running one: none, since the instruction
#: must be completed; or only the end of the wait for it.
NEVER, LEAVE = "never", "leave"

#: The references of a parameter or a quantity to the team's frame (`lfield.driver.frame` defines each).
FRAME_KINDS = ("place", "direction", "heading")

#: The kinds of files that a parameter names and the compiler reads.
FILE_KINDS = ("plan",)

#: L types that may be passed between a program and a driver.
DEVICE_VALUE_TYPES = ("boolean", "int", "real", "string", "real[]", "int[]")

#: A value of one of these types in Python.
DeviceValue = bool | int | float | str | Sequence[int | float] | None


class Observation(Struct, frozen=True, array_like=True):
    """The value of a telemetry quantity that was true at `when`, in seconds of the monotonic clock.

    Driver, guard and host are on one machine and share this clock, so each of them stores and passes on the
    time. The age is computed where it is needed.
    """

    value: DeviceValue
    when: float


class Parameter(Struct, frozen=True):
    """One parameter of an instruction. `type` is an L type name, `unit` an SI unit or ''.

    `frame` is a kind of FRAME_KINDS for a value that refers to the team's frame, '' for others. `file` is a
    kind of FILE_KINDS for the name of a file that the compiler reads, '' for others.
    """

    name: str
    type: str
    unit: str = ""
    meaning: str = ""
    frame: str = ""
    file: str = ""


class Instruction(Struct, frozen=True):
    """One library instruction of a device type: `fc.takeoff(10.0)`.

    `result` is an L type name or 'void'. `effect` is the effect of a repetition: none (query), no further one
    (idempotent), or a second action (actuate). A query is answered from the last telemetry snapshot and never
    blocks; `blocking` instructions block the calling thread until they are done. Instructions of one
    `channel` replace one another, instructions of different channels run concurrently: a gripper may close
    while its vehicle flies.

    `cancel` is the effect of a cancel of a blocking instruction that acts: the name of an instruction of the
    same device and channel, without parameters, which is executed in its place (`hold`); NEVER; or LEAVE. It
    is '' for all others.
    """

    name: str
    parameters: tuple[Parameter, ...] = ()
    result: str = "void"
    unit: str = ""
    effect: Effect = "actuate"
    blocking: bool = False
    meaning: str = ""
    channel: str = "motion"
    cancel: str = ""

    @property
    def may_be_cancelled(self) -> bool:
        """Whether a call of this instruction can be cancelled while under way.

        A blocking query can be cancelled, since it has no effect; a setpoint cannot, since it is done at
        once.
        """
        return self.blocking and (self.only_asks or self.cancel not in ("", NEVER))

    @property
    def only_asks(self) -> bool:
        """Whether the instruction has no effect on the device: telemetry, or a query to the device itself,
        answers it.
        """
        return self.effect == "query"

    @property
    def is_query(self) -> bool:
        """Whether telemetry answers the instruction, which is then never sent to the device."""
        return self.only_asks and not self.blocking


class Quantity(Struct, frozen=True):
    """One telemetry quantity that the driver publishes and queries read.

    `max_age` in seconds; `rate` in Hz is the rate that the driver requests from the device, 0 when it is
    reported irregularly, or not by every device. `frame` is as for a parameter.
    """

    name: str
    type: str
    unit: str = ""
    max_age: float = 3.0
    meaning: str = ""
    rate: float = 0.0
    frame: str = ""


@dataclass(frozen=True)
class DeviceManifest:
    """A device type in L: `Mavlink fc;` with its instructions, telemetry and safe states.

    A pure sensor has no safe state: all its instructions are queries.
    """

    type: str
    driver: str
    instructions: tuple[Instruction, ...]
    telemetry: tuple[Quantity, ...] = ()
    safe_states: tuple[str, ...] = ()
    meaning: str = ""

    @cached_property
    def _by_name(self) -> dict[str, Instruction]:
        return {i.name: i for i in self.instructions}

    def instruction(self, name: str) -> Instruction | None:
        """The instruction with this name, or None. A device type never overloads a name."""
        return self._by_name.get(name)
