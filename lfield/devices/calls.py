"""The calls of one guard that have no answer yet, and how long each of them may still begin.

An answer comes once: what the device said, or why it did not happen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from lfield.driver.binding import DeviceBinding
from lfield.driver.values import conform
from lfield.errors import DeviceError, WireError
from lfield.guard.messages import Call, Cancel
from lfield.manifest import DeviceValue, Instruction

#: What a caller gets, once: the value, or why it did not happen.
Answered = Callable[[DeviceValue | DeviceError], None]


class _Asked(NamedTuple):
    """A call, and who waits for it."""

    binding: DeviceBinding
    instruction: Instruction
    answered: Answered
    thread: int


class Calls:
    """The calls under way, by their tokens."""

    def __init__(self) -> None:
        self._tokens = 0
        self._asked: dict[int, _Asked] = {}

    def begin(
        self,
        binding: DeviceBinding,
        instruction: Instruction,
        arguments: Sequence[Any],
        answered: Answered,
        sent: float,
        until: float,
        thread: int,
    ) -> Call:
        """The message for the guard; `answered` is called once.

        It begins before `until`, in seconds on the clock of `sent`, and within the device's time-to-live.
        `thread` of the device's agent waits for it.
        """
        self._tokens += 1
        self._asked[self._tokens] = _Asked(binding, instruction, answered, thread)
        until = min(until, sent + binding.ttl)
        return Call(self._tokens, binding.name, instruction.name, list(arguments), sent, until)

    def cancel(self, agent: str, thread: int, sent: float) -> Cancel | None:
        """The message that gives up what a thread waits for; None for what may not be cancelled."""
        for token, asked in self._asked.items():
            if (asked.binding.agent, asked.thread) == (agent, thread) and asked.instruction.may_be_cancelled:
                return Cancel(token, sent)
        return None

    def done(self, token: int, value: Any) -> None:
        """It has been carried out. Raises WireError for a call that waits for no answer."""
        asked = self._answered(token)
        try:
            asked.answered(conform(value, asked.instruction.result))
        except ValueError as error:
            reason = f"{asked.instruction.name}() gave no {asked.instruction.result}: {error}"
            asked.answered(DeviceError(asked.binding.field, reason))

    def refused(self, token: int, kind: str, reason: str) -> None:
        """It has not; `kind` is the L exception that this becomes. Raises WireError as `done` does."""
        asked = self._answered(token)
        asked.answered(DeviceError(asked.binding.field, reason, kind=kind))

    def _answered(self, token: int) -> _Asked:
        """The call of this token, which has its answer now. Raises WireError."""
        if token not in self._asked:
            raise WireError(f"an answer to call {token}, which waits for none")
        return self._asked.pop(token)

    def lost(self, status: int | None) -> None:
        """The guard has ended: nobody will know what became of them."""
        lost, self._asked = self._asked, {}
        for binding, instruction, answered, _ in lost.values():
            reason = f"{instruction.name}() is lost: the guard ended with status {status}"
            answered(DeviceError(binding.field, reason))
