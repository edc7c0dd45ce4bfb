"""A running call of a device: its kind, whether it has started, and its answer.

A call is answered once. A cancelled call is answered when the instruction that ends it (`hold()` for
`goTo()`) is done or has failed.
"""

from __future__ import annotations

import math
from typing import Literal

from msgspec import Struct

from lfield.driver.contract import RELEASE
from lfield.guard.messages import CANCELLED, CallDone, GuardCall, Refused
from lfield.manifest import DeviceValue, Instruction

CallKind = Literal["ask", "act", "setpoint"]


def call_kind(instruction: Instruction) -> CallKind:
    """The treatment of an instruction by the guard: a query moves no device; a setpoint remains in effect
    after its call has returned.
    """
    if instruction.only_asks or instruction.name == RELEASE.name:
        return "ask"
    return "setpoint" if instruction.effect == "actuate" and not instruction.blocking else "act"


class RunningCall(Struct):
    """A running call of the program, or the call that ends a `cancelled` one.

    `is_started`: the driver has received the call. `replaces_call`: another call was stopped for it.
    `deadline` is the time by which the end of a cancelled call must be done, in seconds of the clock.
    """

    call: GuardCall
    kind: CallKind
    cancelled: GuardCall | None = None
    is_started: bool = False
    replaces_call: bool = False
    deadline: float = math.inf

    def mark_started(self) -> None:
        """Records that the driver has received the call."""
        self.is_started = True

    @property
    def has_changed_nothing(self) -> bool:
        """Whether the call has not affected the device."""
        return not (self.is_started or self.replaces_call)

    def done_answer(self, value: DeviceValue) -> CallDone | Refused:
        """The answer when the call was executed."""
        if self.cancelled is None:
            return CallDone(self.call.token, value)
        return self.failed_answer(f"{self.call.instruction}() is done")

    def failed_answer(self, reason: str) -> Refused:
        """The answer when the call failed: a sentence, or the rest of `goTo() was cancelled, and`."""
        if self.cancelled is None:
            return Refused(self.call.token, "DeviceException", reason)
        message = f"{self.cancelled.instruction}() was cancelled, and {reason}"
        return Refused(self.cancelled.token, CANCELLED, message)

    def cancelled_answer(self) -> Refused:
        """The answer when the wait ends without a command to the device."""
        state = (
            "the motion that it started continues"
            if self.is_started
            else "it had not started; nothing was done"
        )
        return Refused(self.call.token, CANCELLED, f"{self.call.instruction}() was cancelled: {state}")
