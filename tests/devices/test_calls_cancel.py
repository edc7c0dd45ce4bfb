"""A host cancels the device call of a thread: the thread that waits for the call identifies the call."""

from __future__ import annotations

import pytest

from lfield.devices.pending_device_calls import PendingDeviceCalls
from lfield.driver.binding import DeviceBinding
from lfield.errors import DeviceError
from lfield.guard.messages import CANCELLED, CancelInstruction
from lfield.manifest import NEVER, Instruction

ARM = DeviceBinding(agent="crane", field="arm", type="Arm", driver="arm", endpoint="here", ttl=0.5)
MOVE = Instruction("move", effect="idempotent", blocking=True, cancel="stop")
LOWER = Instruction("lower", effect="idempotent", blocking=True, cancel=NEVER)
STEER = Instruction("steer")


def start_call(calls: PendingDeviceCalls, instruction: Instruction, thread: int) -> tuple[int, list[object]]:
    """The token of a started call, and the list of its answers."""
    answers: list[object] = []
    call = calls.start(ARM, instruction, [], answers.append, 1.0, 9.0, thread)
    return call.token, answers


def test_cancel_of_a_waiting_thread_cancels_its_call():
    calls = PendingDeviceCalls()
    start_call(calls, MOVE, 1)
    token, answers = start_call(calls, MOVE, 2)
    assert calls.cancel("crane", 2, 1.5) == CancelInstruction(token, 1.5)
    calls.on_refused(token, CANCELLED, "move() was cancelled, and stop() is done")
    (error,) = answers
    assert isinstance(error, DeviceError)
    assert (error.kind, error.device) == (CANCELLED, "arm")


@pytest.mark.parametrize("instruction", [LOWER, STEER])
def test_instruction_with_cancel_never_is_not_cancelled(instruction: Instruction):
    calls = PendingDeviceCalls()
    start_call(calls, instruction, 1)
    assert calls.cancel("crane", 1, 1.5) is None


@pytest.mark.parametrize(("agent", "thread"), [("crane", 2), ("other", 1)])
def test_call_of_another_thread_or_agent_is_not_cancelled(agent: str, thread: int):
    calls = PendingDeviceCalls()
    start_call(calls, MOVE, 1)
    assert calls.cancel(agent, thread, 1.5) is None


def test_answered_call_cannot_be_cancelled():
    calls = PendingDeviceCalls()
    token, answers = start_call(calls, MOVE, 1)
    calls.on_done(token, None)
    assert calls.cancel("crane", 1, 1.5) is None
    assert answers == [None]


def test_guard_loss_during_a_cancel_answers_the_call():
    calls = PendingDeviceCalls()
    _, answers = start_call(calls, MOVE, 1)
    calls.cancel("crane", 1, 1.5)
    calls.on_guard_lost(9)
    assert [str(error) for error in answers] == ["arm: move() is lost: the guard ended with status 9"]
