"""What a device is doing for a call: how it is treated, whether it has begun, and the answer that it gets.

An answer is given once. A call that was cancelled has its answer when the instruction that ends it (`hold()`
for `goTo()`) is done, or has failed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from lfield.driver.contract import RELEASE
from lfield.guard.messages import CANCELLED, Call, Done, Refused
from lfield.manifest import DeviceValue, Instruction

Way = Literal["ask", "act", "setpoint"]


def way(instruction: Instruction) -> Way:
    """How the guard treats an instruction: asking moves nothing; a setpoint acts on after it returned."""
    if instruction.only_asks or instruction.name == RELEASE.name:
        return "ask"
    return "setpoint" if instruction.effect == "actuate" and not instruction.blocking else "act"


@dataclass(slots=True)
class Running:
    """A call that is carried out: of the program, or the one that ends a call of it that was `cancelled`.

    It is `begun` once its driver has got it, and `follows` when another one was stopped for it. `until` is
    when the end of a cancelled call is to be done, in seconds of the clock.
    """

    call: Call
    cancelled: Call | None = None
    begun: bool = False
    follows: bool = False
    until: float = math.inf

    @property
    def untouched(self) -> bool:
        """Whether the device still does what it did before the call."""
        return not (self.begun or self.follows)

    def done(self, value: DeviceValue) -> Done | Refused:
        """The answer when it has been carried out."""
        if self.cancelled is None:
            return Done(self.call.token, value)
        return self.refused(f"{self.call.instruction}() is done")

    def refused(self, reason: str) -> Refused:
        """The answer when it has not: a whole sentence, or what comes after `goTo() was cancelled, and`."""
        if self.cancelled is None:
            return Refused(self.call.token, "DeviceException", reason)
        told = f"{self.cancelled.instruction}() was cancelled, and {reason}"
        return Refused(self.cancelled.token, CANCELLED, told)

    def given_up(self) -> Refused:
        """The answer when it is not waited for any longer, and nothing was commanded for that."""
        state = "what it began goes on without it" if self.begun else "it had not begun, and nothing was done"
        return Refused(self.call.token, CANCELLED, f"{self.call.instruction}() was cancelled: {state}")
