"""What a driver adds to L, as plain data: device types, instructions, telemetry.

A base module: the compiler reads it to check programs, the host to route calls, the driver to know
its own promises. The vendor library is not needed for that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from msgspec import Struct

Effect = Literal["query", "idempotent", "actuate"]

#: What a cancel does where no instruction is named that ends the running one: nothing, since it must be
#: completed; or it only ends the wait for it.
NEVER, LEAVE = "never", "leave"

#: What of the team's frame a parameter or a quantity is about (`lfield.driver.frame` says how each is meant).
FRAME_KINDS = ("place", "direction", "heading")

#: What a file is that a parameter names; the compiler reads it.
FILE_KINDS = ("plan",)

#: L types that may cross between a program and a driver.
DEVICE_VALUE_TYPES = ("boolean", "int", "real", "string", "real[]", "int[]")

#: A value of one of those types, as Python sees it.
DeviceValue = bool | int | float | str | Sequence[int | float] | None


class Observation(Struct, frozen=True, array_like=True):
    """The value of a telemetry quantity that was true at `when`, in seconds of the monotonic clock.

    Driver, guard and host are on one machine and share that clock, so this is what each of them keeps and
    hands on. How old it is is asked where it matters.
    """

    value: DeviceValue
    when: float


class Parameter(Struct, frozen=True):
    """One parameter of an instruction. `type` is an L type name, `unit` an SI unit or ''.

    `frame` is a kind of FRAME_KINDS for what is about the team's frame, '' for all else. `file` is a kind of
    FILE_KINDS for the name of a file that the compiler reads, '' for all else.
    """

    name: str
    type: str
    unit: str = ""
    meaning: str = ""
    frame: str = ""
    file: str = ""


class Instruction(Struct, frozen=True):
    """One library instruction of a device type: `fc.takeoff(10.0)`.

    `result` is an L type name or 'void'. `effect` is what a repetition does: nothing (query),
    nothing new (idempotent), or act again (actuate). A query is answered from the last telemetry
    snapshot and never blocks; `blocking` instructions hold the calling thread until they are done.
    Instructions of one `channel` replace one another, those of different channels run side by side: a
    gripper may close while the vehicle that carries it flies on.

    `cancel` is what a cancel of a blocking one that acts does: the name of an instruction of the same device
    and channel, without parameters, which is carried out instead of it (`hold`); NEVER; or LEAVE. '' for all
    others.
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
        """Whether a call of it that is under way can be given up.

        A blocking query can, since nothing depends on it; a setpoint cannot, since it is done at once.
        """
        return self.blocking and (self.only_asks or self.cancel not in ("", NEVER))

    @property
    def only_asks(self) -> bool:
        """Whether it moves and changes nothing: telemetry answers it, or the device itself is asked."""
        return self.effect == "query"

    @property
    def is_query(self) -> bool:
        """Whether telemetry answers it: then it is never sent to the device."""
        return self.only_asks and not self.blocking


class Quantity(Struct, frozen=True):
    """One telemetry quantity that the driver publishes and queries read.

    `max_age` in seconds; `rate` in Hz is the rate that the driver requests from the device, 0 when it
    is reported irregularly, or not by every device. `frame` is as that of a parameter.
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
    """A device type as L sees it: `Mavlink fc;` with its instructions, telemetry and safe states.

    A pure sensor has no safe state: all its instructions only ask.
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
        """The instruction of that name, or None. A device type never overloads a name."""
        return self._by_name.get(name)
