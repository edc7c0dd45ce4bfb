"""Cancelled calls: `GuardCore.on_cancel`, event by event."""

from __future__ import annotations

import pytest

from lfield.clock import ManualClock
from lfield.guard.core import GuardCore
from lfield.guard.effects import Execute, Interrupt, MakeSafe, Notify
from lfield.guard.messages import CANCELLED, CallDone, GuardCall, Latched, Refused
from lfield.manifest import LEAVE, NEVER, DeviceManifest, Instruction

TTL, SILENCE, WITHIN = 0.5, 0.2, 5.0

FLYER = DeviceManifest(
    "Flyer",
    "flyer",
    (
        Instruction("goTo", effect="idempotent", blocking=True, cancel="hold"),
        Instruction("hold", effect="idempotent", blocking=True, cancel=NEVER),
        Instruction("land", effect="idempotent", blocking=True, cancel=NEVER),
        Instruction("steer"),
        Instruction("point", blocking=True, cancel=LEAVE, channel="gimbal"),
        Instruction("ask", (), "int", effect="query", blocking=True),
    ),
    safe_states=("stop",),
)


class CancelRig:
    """A core with one device and a connected host."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.core = GuardCore([("a", FLYER, TTL, WITHIN)], self.clock, silence=SILENCE)
        self.core.on_opened("")

    def call(self, token: int, instruction: str, *, started: bool = True):
        now = self.clock.monotonic()
        call = GuardCall(token, "a", instruction, [], now, now + TTL)
        effects = self.core.on_call(call)
        if started:
            assert self.core.mark_started(call) == ""
        return effects

    def cancel(self, token: int):
        return self.core.on_cancel(token, self.clock.monotonic())

    def advance(self, seconds: float):
        """Advance the clock; the host sends a heartbeat in each step."""
        effects = []
        for _ in range(round(seconds / 0.05)):
            self.clock.advance(0.05)
            effects += self.core.on_beat(self.clock.monotonic())
        return effects


def answers(effects):
    messages = [e.message for e in effects if isinstance(e, Notify)]
    return [message for message in messages if isinstance(message, CallDone | Refused)]


def executed(effects):
    return [e.call.instruction for e in effects if isinstance(e, Execute)]


def interrupted(effects):
    return [e.token for e in effects if isinstance(e, Interrupt)]


def test_cancel_executes_the_instruction_of_the_manifest():
    rig = CancelRig()
    rig.call(1, "goTo")
    effects = rig.cancel(1)
    assert (interrupted(effects), executed(effects), answers(effects)) == ([1], ["hold"], [])
    (hold,) = [e.call for e in effects if isinstance(e, Execute)]
    assert rig.core.mark_started(hold) == ""
    answer = answers(rig.core.on_finished(hold.token, None))
    assert answer == [Refused(1, CANCELLED, "goTo() was cancelled, and hold() is done")]
    assert rig.advance(10.0) == [], "nothing is latched or pending"


def test_second_cancel_has_no_effect():
    rig = CancelRig()
    rig.call(1, "goTo")
    rig.cancel(1)
    assert rig.cancel(1) == []
    rig.core.on_finished(-1, None)
    assert rig.cancel(1) == []


def test_result_before_the_cancel_is_the_answer():
    rig = CancelRig()
    rig.call(1, "goTo")
    assert answers(rig.core.on_finished(1, None)) == [CallDone(1, None)]
    assert rig.cancel(1) == []


def test_result_after_the_cancel_is_ignored():
    rig = CancelRig()
    rig.call(1, "goTo")
    rig.cancel(1)
    assert rig.core.on_finished(1, None) == []
    assert rig.core.on_refused(1, "DeviceException", "it was stopped") == []


def test_cancelled_call_that_has_not_started_does_not_start():
    rig = CancelRig()
    rig.call(1, "goTo", started=False)
    effects = rig.cancel(1)
    assert (interrupted(effects), executed(effects)) == ([1], [])
    expected = "goTo() was cancelled: it had not started; nothing was done"
    assert answers(effects) == [Refused(1, CANCELLED, expected)]


def test_cancel_of_an_unstarted_replacement_ends_the_motion():
    """The device still executes the first motion, and no caller waits for that motion any more."""
    rig = CancelRig()
    rig.call(1, "goTo")
    rig.call(2, "goTo", started=False)
    assert executed(rig.cancel(2)) == ["hold"]


@pytest.mark.parametrize("instruction", ["land", "steer"])
def test_instruction_with_cancel_never_continues(instruction):
    rig = CancelRig()
    rig.call(1, instruction)
    assert rig.cancel(1) == []
    assert answers(rig.core.on_finished(1, None)) == [CallDone(1, None)]


def test_cancel_leave_commands_nothing():
    rig = CancelRig()
    rig.call(1, "point")
    effects = rig.cancel(1)
    assert (interrupted(effects), executed(effects)) == ([1], [])
    assert answers(effects) == [
        Refused(1, CANCELLED, "point() was cancelled: the motion that it started continues")
    ]


def test_cancelled_query_is_dropped():
    rig = CancelRig()
    rig.call(1, "ask")
    effects = rig.cancel(1)
    assert (interrupted(effects), executed(effects)) == ([1], [])
    assert [answer.kind for answer in answers(effects)] == [CANCELLED]


def test_failed_cancel_instruction_makes_the_device_safe():
    rig = CancelRig()
    rig.call(1, "goTo")
    rig.cancel(1)
    effects = rig.core.on_refused(-1, "DeviceTimeoutException", "no answer")
    reason = "goTo() was cancelled, and hold() failed: no answer"
    assert answers(effects) == [Refused(1, CANCELLED, reason)]
    assert [e.device for e in effects if isinstance(e, MakeSafe)] == ["a"]
    assert [
        e.message.reason for e in effects if isinstance(e, Notify) and isinstance(e.message, Latched)
    ] == [reason]


def test_driver_crash_in_the_cancel_makes_the_device_safe():
    rig = CancelRig()
    rig.call(1, "goTo")
    rig.cancel(1)
    effects = rig.core.on_crashed(-1, "the driver failed in hold(): KeyError()")
    (answer,) = answers(effects)
    assert (answer.token, answer.kind) == (1, CANCELLED)
    assert [e.device for e in effects if isinstance(e, MakeSafe)] == ["a"]


def test_cancel_instruction_that_exceeds_its_time_is_a_failure():
    rig = CancelRig()
    rig.call(1, "goTo")
    rig.cancel(1)
    assert rig.advance(WITHIN - 0.1) == []
    assert rig.core.due() <= rig.clock.monotonic() + 0.11
    effects = rig.advance(0.2)
    assert interrupted(effects) == [-1]
    assert [e.device for e in effects if isinstance(e, MakeSafe)] == ["a"]
    assert "hold() is not done after 5 s" in answers(effects)[0].reason


def test_newer_call_replaces_the_cancel_instruction():
    rig = CancelRig()
    rig.call(1, "goTo")
    rig.cancel(1)
    effects = rig.call(2, "land")
    assert (interrupted(effects), executed(effects)) == ([-1], ["land"])
    expected = "goTo() was cancelled, and hold() was replaced by land()"
    assert answers(effects) == [Refused(1, CANCELLED, expected)]
    assert answers(rig.core.on_finished(2, None)) == [CallDone(2, None)]


def test_cancel_in_the_safe_state_has_no_effect():
    rig = CancelRig()
    rig.call(1, "goTo")
    rig.core.latch("a", "asked")
    assert rig.cancel(1) == []


def test_safe_state_stops_the_cancel_instruction():
    rig = CancelRig()
    rig.call(1, "goTo")
    rig.cancel(1)
    effects = rig.core.latch("a", "the emergency stop was pressed")
    assert interrupted(effects) == [-1]
    expected = "goTo() was cancelled, and hold() was stopped, since the emergency stop was pressed"
    assert answers(effects) == [Refused(1, CANCELLED, expected)]


def test_host_silence_during_a_cancel_makes_the_device_safe():
    rig = CancelRig()
    rig.call(1, "goTo")
    rig.cancel(1)
    rig.clock.advance(SILENCE)
    assert [e.device for e in rig.core.tick() if isinstance(e, MakeSafe)] == ["a"]


def test_cancel_instruction_ends_a_setpoint_on_its_channel():
    rig = CancelRig()
    rig.call(1, "steer")
    rig.core.on_finished(1, None)
    rig.call(2, "goTo")
    rig.cancel(2)
    rig.core.on_finished(-2, None)
    assert rig.advance(5 * TTL) == []


def test_cancel_does_not_affect_other_channels():
    rig = CancelRig()
    rig.call(1, "goTo")
    rig.call(2, "point")
    rig.cancel(1)
    assert answers(rig.core.on_finished(2, None)) == [CallDone(2, None)]
