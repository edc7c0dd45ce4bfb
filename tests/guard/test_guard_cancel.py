"""What becomes of a call that the host gives up: `GuardCore.on_cancel`, event by event."""

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


class Given:
    """A core with one device; every event comes from a host that is there."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.core = GuardCore([("a", FLYER, TTL, WITHIN)], self.clock, silence=SILENCE)
        self.core.on_opened("")

    def call(self, token: int, instruction: str, *, begun: bool = True):
        now = self.clock.monotonic()
        call = GuardCall(token, "a", instruction, [], now, now + TTL)
        effects = self.core.on_call(call)
        if begun:
            assert self.core.mark_started(call) == ""
        return effects

    def cancel(self, token: int):
        return self.core.on_cancel(token, self.clock.monotonic())

    def live(self, seconds: float):
        effects = []
        for _ in range(round(seconds / 0.05)):
            self.clock.advance(0.05)
            effects += self.core.on_beat(self.clock.monotonic())
        return effects


def answers(effects):
    told = [e.message for e in effects if isinstance(e, Notify)]
    return [message for message in told if isinstance(message, CallDone | Refused)]


def executed(effects):
    return [e.call.instruction for e in effects if isinstance(e, Execute)]


def interrupted(effects):
    return [e.token for e in effects if isinstance(e, Interrupt)]


def test_the_instruction_of_the_manifest_is_carried_out_instead_and_its_end_is_the_answer():
    given = Given()
    given.call(1, "goTo")
    effects = given.cancel(1)
    assert (interrupted(effects), executed(effects), answers(effects)) == ([1], ["hold"], [])
    (end,) = [e.call for e in effects if isinstance(e, Execute)]
    assert given.core.mark_started(end) == ""
    told = answers(given.core.on_finished(end.token, None))
    assert told == [Refused(1, CANCELLED, "goTo() was cancelled, and hold() is done")]
    assert given.live(10.0) == [], "nothing is latched, nothing is left to do"


def test_to_cancel_twice_is_to_cancel_once():
    given = Given()
    given.call(1, "goTo")
    given.cancel(1)
    assert given.cancel(1) == []
    given.core.on_finished(-1, None)
    assert given.cancel(1) == []


def test_a_result_that_crosses_its_cancel_wins_once():
    given = Given()
    given.call(1, "goTo")
    assert answers(given.core.on_finished(1, None)) == [CallDone(1, None)]
    assert given.cancel(1) == []


def test_the_driver_that_is_done_all_the_same_is_not_heard():
    given = Given()
    given.call(1, "goTo")
    given.cancel(1)
    assert given.core.on_finished(1, None) == []
    assert given.core.on_refused(1, "DeviceException", "it was stopped") == []


def test_what_has_not_begun_never_begins():
    given = Given()
    given.call(1, "goTo", begun=False)
    effects = given.cancel(1)
    assert (interrupted(effects), executed(effects)) == ([1], [])
    told = "goTo() was cancelled: it had not started; nothing was done"
    assert answers(effects) == [Refused(1, CANCELLED, told)]


def test_what_has_not_begun_but_has_replaced_another_is_ended_too():
    """The device is on the way of the first, which nobody waits for any more."""
    given = Given()
    given.call(1, "goTo")
    given.call(2, "goTo", begun=False)
    assert executed(given.cancel(2)) == ["hold"]


@pytest.mark.parametrize("instruction", ["land", "steer"])
def test_what_may_never_be_cancelled_goes_on(instruction):
    given = Given()
    given.call(1, instruction)
    assert given.cancel(1) == []
    assert answers(given.core.on_finished(1, None)) == [CallDone(1, None)]


def test_what_is_only_left_commands_nothing():
    given = Given()
    given.call(1, "point")
    effects = given.cancel(1)
    assert (interrupted(effects), executed(effects)) == ([1], [])
    assert answers(effects) == [
        Refused(1, CANCELLED, "point() was cancelled: the motion that it started continues")
    ]


def test_a_question_is_dropped():
    given = Given()
    given.call(1, "ask")
    effects = given.cancel(1)
    assert (interrupted(effects), executed(effects)) == ([1], [])
    assert [told.kind for told in answers(effects)] == [CANCELLED]


def test_when_the_end_fails_the_device_goes_safe_and_the_answer_says_so():
    given = Given()
    given.call(1, "goTo")
    given.cancel(1)
    effects = given.core.on_refused(-1, "DeviceTimeoutException", "no answer")
    why = "goTo() was cancelled, and hold() failed: no answer"
    assert answers(effects) == [Refused(1, CANCELLED, why)]
    assert [e.device for e in effects if isinstance(e, MakeSafe)] == ["a"]
    assert [
        e.message.reason for e in effects if isinstance(e, Notify) and isinstance(e.message, Latched)
    ] == [why]


def test_a_driver_that_breaks_in_the_end_has_its_device_made_safe():
    given = Given()
    given.call(1, "goTo")
    given.cancel(1)
    effects = given.core.on_crashed(-1, "the driver failed in hold(): KeyError()")
    (told,) = answers(effects)
    assert (told.token, told.kind) == (1, CANCELLED)
    assert [e.device for e in effects if isinstance(e, MakeSafe)] == ["a"]


def test_an_end_that_takes_longer_than_the_device_may_is_a_failure():
    given = Given()
    given.call(1, "goTo")
    given.cancel(1)
    assert given.live(WITHIN - 0.1) == []
    assert given.core.due() <= given.clock.monotonic() + 0.11
    effects = given.live(0.2)
    assert interrupted(effects) == [-1]
    assert [e.device for e in effects if isinstance(e, MakeSafe)] == ["a"]
    assert "hold() is not done after 5 s" in answers(effects)[0].reason


def test_a_newer_call_replaces_the_end_and_is_answered_itself():
    given = Given()
    given.call(1, "goTo")
    given.cancel(1)
    effects = given.call(2, "land")
    assert (interrupted(effects), executed(effects)) == ([-1], ["land"])
    told = "goTo() was cancelled, and hold() was replaced by land()"
    assert answers(effects) == [Refused(1, CANCELLED, told)]
    assert answers(given.core.on_finished(2, None)) == [CallDone(2, None)]


def test_in_its_safe_state_there_is_nothing_to_cancel():
    given = Given()
    given.call(1, "goTo")
    given.core.latch("a", "asked")
    assert given.cancel(1) == []


def test_a_safe_state_stops_the_end_too():
    given = Given()
    given.call(1, "goTo")
    given.cancel(1)
    effects = given.core.latch("a", "the emergency stop was pressed")
    assert interrupted(effects) == [-1]
    told = "goTo() was cancelled, and hold() was stopped, since the emergency stop was pressed"
    assert answers(effects) == [Refused(1, CANCELLED, told)]


def test_a_host_that_falls_silent_while_it_cancels_is_silent_as_ever():
    given = Given()
    given.call(1, "goTo")
    given.cancel(1)
    given.clock.advance(SILENCE)
    assert [e.device for e in given.core.tick() if isinstance(e, MakeSafe)] == ["a"]


def test_the_end_is_the_newest_on_its_channel_and_ends_a_setpoint():
    given = Given()
    given.call(1, "steer")
    given.core.on_finished(1, None)
    given.call(2, "goTo")
    given.cancel(2)
    given.core.on_finished(-2, None)
    assert given.live(5 * TTL) == []


def test_other_channels_go_on():
    given = Given()
    given.call(1, "goTo")
    given.call(2, "point")
    given.cancel(1)
    assert answers(given.core.on_finished(2, None)) == [CallDone(2, None)]
