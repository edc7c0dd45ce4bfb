"""Calls that a host gives up, by who waits for them."""

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


def begun(calls: PendingDeviceCalls, instruction: Instruction, thread: int) -> tuple[int, list[object]]:
    """The token of a call, and what its caller gets."""
    answers: list[object] = []
    call = calls.start(ARM, instruction, [], answers.append, 1.0, 9.0, thread)
    return call.token, answers


def test_the_call_that_a_thread_waits_for_is_given_up():
    calls = PendingDeviceCalls()
    begun(calls, MOVE, 1)
    token, answers = begun(calls, MOVE, 2)
    assert calls.cancel("crane", 2, 1.5) == CancelInstruction(token, 1.5)
    calls.on_refused(token, CANCELLED, "move() was cancelled, and stop() is done")
    (error,) = answers
    assert isinstance(error, DeviceError)
    assert (error.kind, error.device) == (CANCELLED, "arm")


@pytest.mark.parametrize("instruction", [LOWER, STEER])
def test_what_may_never_be_cancelled_is_not(instruction: Instruction):
    calls = PendingDeviceCalls()
    begun(calls, instruction, 1)
    assert calls.cancel("crane", 1, 1.5) is None


@pytest.mark.parametrize(("agent", "thread"), [("crane", 2), ("other", 1)])
def test_what_another_waits_for_goes_on(agent: str, thread: int):
    calls = PendingDeviceCalls()
    begun(calls, MOVE, 1)
    assert calls.cancel(agent, thread, 1.5) is None


def test_what_has_its_answer_cannot_be_cancelled():
    calls = PendingDeviceCalls()
    token, answers = begun(calls, MOVE, 1)
    calls.on_done(token, None)
    assert calls.cancel("crane", 1, 1.5) is None
    assert answers == [None]


def test_a_guard_that_dies_with_a_cancel_under_way_leaves_no_call_without_an_answer():
    calls = PendingDeviceCalls()
    _, answers = begun(calls, MOVE, 1)
    calls.cancel("crane", 1, 1.5)
    calls.on_guard_lost(9)
    assert [str(error) for error in answers] == ["arm: move() is lost: the guard ended with status 9"]
