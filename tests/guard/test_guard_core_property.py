"""Property tests of the guard's core: any order of events, and host silence between two clock readings."""

from __future__ import annotations

import pytest
from guard_rig import MANIFEST, SILENCE, TTL, WITHIN, Rig, made_safe, messages, mutes
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from lfield.clock import ManualClock
from lfield.guard.core import GuardCore
from lfield.guard.effects import Abandon, Execute, Interrupt, MakeSafe, Notify
from lfield.guard.messages import CallDone, GuardCall, Latched, Refused, Released

MOVING = ("go", "steer", "halt")


class CreepingClock(ManualClock):
    """A clock that advances with each reading, like a real one."""

    STEP = 1e-6

    def monotonic(self):
        self.now += self.STEP
        return self.now


@pytest.mark.parametrize("steps_before", range(1, 13))
@pytest.mark.parametrize("event", ["tick", "ask", "beat"])
def test_silence_that_starts_between_two_clock_readings_is_found(event, steps_before):
    clock = CreepingClock()
    core = GuardCore([("a", MANIFEST, TTL, WITHIN)], clock, silence=SILENCE)
    start = clock.monotonic()
    core.on_opened("")
    core.on_call(GuardCall(1, "a", "go", [1.0], start, start + TTL))
    core.on_finished(1, None)
    last = clock.now
    core.on_beat(last)
    clock.now = last + SILENCE - steps_before * clock.STEP
    effects = {
        "tick": core.tick,
        "ask": lambda: core.on_call(GuardCall(2, "a", "ask", [], last, last)),
        "beat": lambda: core.on_beat(last),
    }[event]()
    while made_safe(effects) == [] and core.due() is not None:
        clock.now = max(clock.now, core.due())
        effects += core.tick()
    assert made_safe(effects) == ["a"]
    assert mutes(effects) == []
    assert clock.now < last + SILENCE + 20 * clock.STEP


class GuardMachine(RuleBasedStateMachine):
    """Any order of events. A model of the guard, updated from the effects only, checks its promises."""

    @initialize()
    def start(self):
        self.rig = Rig()
        self.latched = self.confirmed = self.moved = False
        self.commands_pending = 0
        self.running: dict[int, GuardCall] = {}
        self.last_contact = self.now
        self.setpoint_until: float | None = None
        self.answered: set[int] = set()

    @property
    def now(self):
        return self.rig.clock.monotonic()

    def observe(self, effects):
        for effect in effects:
            if isinstance(effect, MakeSafe):
                self.commands_pending += 1
                assert self.commands_pending == 1, "only one safe-state command at a time"
                assert self.latched or not self.confirmed
            elif isinstance(effect, Abandon):
                self.commands_pending -= 1
            elif isinstance(effect, Interrupt):
                self.running.pop(effect.token)
            elif isinstance(effect, Execute):
                call = effect.call
                acts = call.instruction in MOVING
                assert not (acts and self.latched), "a latched device was moved"
                if call.instruction == "steer":
                    assert self.now - call.sent < TTL, "a setpoint was executed after its time-to-live"
                self.running[call.token] = call
                self.moved = self.moved or acts
                assert self.rig.core.mark_started(call) == ""
            elif isinstance(effect, Notify) and isinstance(effect.message, CallDone | Refused):
                assert effect.message.token not in self.answered, "a call was answered twice"
                self.answered.add(effect.message.token)
            elif isinstance(effect, Notify) and isinstance(effect.message, Latched):
                if not effect.message.confirmed:
                    assert not self.latched
                    self.latched, self.confirmed, self.setpoint_until = True, False, None
            elif isinstance(effect, Notify) and isinstance(effect.message, Released):
                assert self.confirmed, "released before its safe state was confirmed"
                self.latched = self.confirmed = self.moved = False

    @rule(seconds=st.floats(0.0, 0.7))
    def wait(self, seconds):
        self.rig.clock.advance(seconds)
        self.observe(self.rig.core.tick())

    @precondition(lambda self: not self.latched)
    @rule(instruction=st.sampled_from(["go", "steer"]), steps=st.integers(0, 15))
    def move(self, instruction, steps):
        """The usual sequence: a call, its end, and some time. Random rules alone seldom produce it."""
        self.call(instruction, 0.0)
        token = self.rig.token
        if token in self.running:
            self._end(token, "finished")
        self.advance_with_heartbeats(steps)

    @rule(steps=st.integers(1, 15))
    def advance_with_heartbeats(self, steps):
        for _ in range(steps):
            self.rig.clock.advance(0.05)
            self.observe(self.rig.beat())
            self.last_contact = max(self.last_contact, self.now)
            self.promises()

    @rule(age=st.just(0.0) | st.floats(0.0, 1.0), stopped=st.floats(0.0, 0.4))
    def beat(self, age, stopped):
        self.rig.clock.advance(stopped)
        silent = self.moved and self.now >= self.last_contact + SILENCE
        sent = self.now - age
        self.observe(self.rig.core.on_beat(sent))
        self.last_contact = max(self.last_contact, sent)
        assert self.latched or not silent, "a late heartbeat hid the silence"

    @rule(
        instruction=st.sampled_from(["go", "steer", "ask", "release"]), age=st.just(0.0) | st.floats(0.0, 0.7)
    )
    def call(self, instruction, age):
        arguments = [1.0] if instruction in ("go", "steer") else []
        self.observe(self.rig.call(instruction, *arguments, age=age))
        self.last_contact = max(self.last_contact, self.now - age)

    @precondition(lambda self: self.running)
    @rule(data=st.data(), how=st.sampled_from(["finished", "refused", "crashed"]))
    def end(self, data, how):
        self._end(data.draw(st.sampled_from(sorted(self.running))), how)

    def _end(self, token, how):
        call = self.running[token]
        cancelled = token < 0
        arguments = {"finished": (None,), "refused": ("DeviceException", "no"), "crashed": ("boom",)}[how]
        effects = getattr(self.rig.core, f"on_{how}")(token, *arguments)
        if any(answer.token == token for answer in messages(effects, CallDone)):
            if call.instruction == "steer":
                self.setpoint_until = self.now + TTL
            elif call.instruction == "go":
                self.setpoint_until = None
        if cancelled and how == "finished" and messages(effects, Refused):
            self.setpoint_until = None
        self.running.pop(token, None)
        self.observe(effects)
        if how == "crashed" or (cancelled and how == "refused"):
            assert self.latched

    @precondition(lambda self: any(token > 0 for token in self.running))
    @rule(data=st.data(), age=st.just(0.0) | st.floats(0.0, 0.7))
    def cancel(self, data, age):
        """A cancelled motion is replaced by its cancel instruction, unless the device has gone safe."""
        token = data.draw(st.sampled_from(sorted(token for token in self.running if token > 0)))
        call = self.running[token]
        self.observe(self.rig.core.on_cancel(token, self.now - age))
        self.last_contact = max(self.last_contact, self.now - age)
        if call.instruction == "go":
            assert self.latched or self.running[-token].instruction == "halt"

    @precondition(lambda self: self.commands_pending)
    @rule(is_confirmed=st.booleans())
    def answer_safe_state(self, is_confirmed):
        self.commands_pending -= 1
        if is_confirmed:
            self.observe(self.rig.core.on_safe("a"))
            self.confirmed = True
        else:
            self.observe(self.rig.core.on_safe_failed("a", "no answer"))

    @precondition(lambda self: self.confirmed)
    @rule(moving=st.sampled_from(["", "4 m up"]))
    def report_motion(self, moving):
        self.observe(self.rig.core.on_motion_report("a", moving))

    @rule()
    def request_safe_state(self):
        self.observe(self.rig.core.latch("", "asked"))
        assert self.latched

    @invariant()
    def promises(self):
        if not hasattr(self, "rig"):
            return
        self.observe(self.rig.core.tick())
        if self.moved and self.now >= self.last_contact + SILENCE:
            assert self.latched, "the host was silent and the device is not latched"
        acting = [c for c in self.running.values() if c.instruction in MOVING]
        assert len(acting) <= 1
        if self.setpoint_until is not None and not acting and self.now >= self.setpoint_until:
            assert self.latched, "a setpoint has expired and the device is not latched"
        due = self.rig.core.due()
        assert due is None or due > self.now, "an action is due and was not executed"


GuardMachine.TestCase.settings = settings(max_examples=300, stateful_step_count=30, deadline=None)
TestGuardMachine = GuardMachine.TestCase
