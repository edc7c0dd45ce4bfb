"""Calls of one guard without an answer, and their start deadlines.

A call is answered once: with the device's result or with the error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from lfield.driver.binding import DeviceBinding
from lfield.driver.value_types import conform
from lfield.errors import DeviceError, WireError
from lfield.guard.messages import CancelInstruction, GuardCall
from lfield.manifest import DeviceValue, Instruction

#: Receives the result once: the value or the error.
OnDeviceAnswer = Callable[[DeviceValue | DeviceError], None]


class _PendingCall(NamedTuple):
    """A call and the thread that waits for it."""

    binding: DeviceBinding
    instruction: Instruction
    answered: OnDeviceAnswer
    thread: int


class PendingDeviceCalls:
    """Running calls by token."""

    def __init__(self) -> None:
        self._tokens = 0
        self._pending: dict[int, _PendingCall] = {}

    def start(
        self,
        binding: DeviceBinding,
        instruction: Instruction,
        arguments: Sequence[Any],
        answered: OnDeviceAnswer,
        sent: float,
        until: float,
        thread: int,
    ) -> GuardCall:
        """The message for the guard; `answered` is called once.

        The call starts before `until`, on the clock of `sent`, and within the device's time-to-live. `thread`
        of the device's agent waits for it.
        """
        self._tokens += 1
        self._pending[self._tokens] = _PendingCall(binding, instruction, answered, thread)
        until = min(until, sent + binding.ttl)
        return GuardCall(self._tokens, binding.name, instruction.name, list(arguments), sent, until)

    def cancel(self, agent: str, thread: int, sent: float) -> CancelInstruction | None:
        """The message that cancels the call of a thread; None for a call that may not be cancelled."""
        for token, pending in self._pending.items():
            is_waiting = (pending.binding.agent, pending.thread) == (agent, thread)
            if is_waiting and pending.instruction.may_be_cancelled:
                return CancelInstruction(token, sent)
        return None

    def on_done(self, token: int, value: Any) -> None:
        """The call was executed. Raises WireError for an unknown call."""
        pending = self._pop_pending(token)
        try:
            pending.answered(conform(value, pending.instruction.result))
        except ValueError as error:
            reason = f"{pending.instruction.name}() gave no {pending.instruction.result}: {error}"
            pending.answered(DeviceError(pending.binding.field, reason))

    def on_refused(self, token: int, kind: str, reason: str) -> None:
        """The call failed; `kind` is the L exception. Raises WireError as `on_done`."""
        pending = self._pop_pending(token)
        pending.answered(DeviceError(pending.binding.field, reason, kind=kind))

    def _pop_pending(self, token: int) -> _PendingCall:
        """Removes the call of this token. Raises WireError for an unknown call."""
        if token not in self._pending:
            raise WireError(f"an answer to call {token}, which is not pending")
        return self._pending.pop(token)

    def on_guard_lost(self, status: int | None) -> None:
        """The guard has ended: the result of its calls is unknown."""
        lost, self._pending = self._pending, {}
        for binding, instruction, answered, _ in lost.values():
            reason = f"{instruction.name}() is lost: the guard ended with status {status}"
            answered(DeviceError(binding.field, reason))
