from __future__ import annotations

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from lfield.clock import ManualClock
from lfield.guard.core import MUTE_AFTER, REPEAT, GuardCore
from lfield.guard.effects import Abandon, CheckRest, Execute, Exit, Interrupt, MakeSafe, Mute, Notify
from lfield.guard.messages import CallDone, GuardCall, Latched, Moving, Note, Refused, Released, Stopped
from lfield.manifest import NEVER, DeviceManifest, Instruction, Parameter

TTL, SILENCE, WITHIN = 0.5, 0.2, 120.0
MOVING = ("go", "steer", "halt")

MANIFEST = DeviceManifest(
    "Thing",
    "thing",
    (
        Instruction("go", (Parameter("x", "real"),), blocking=True, cancel="halt"),
        Instruction("steer", (Parameter("x", "real"),)),
        Instruction("grip", (), blocking=True, channel="gripper"),
        Instruction("ask", (), "int", effect="query", blocking=True),
        Instruction("release", effect="idempotent", blocking=True),
        Instruction("halt", effect="idempotent", blocking=True, cancel=NEVER),
    ),
    safe_states=("stop",),
)
SENSOR = DeviceManifest("Eye", "eye", MANIFEST.instructions[3:5])


class Rig:
    """A core with its clock; every step beats first unless told otherwise."""

    def __init__(self, *devices: str) -> None:
        self.clock = ManualClock()
        made = [(d, MANIFEST, TTL, WITHIN) for d in devices or ("a",)]
        self.core = GuardCore(made, self.clock, silence=SILENCE)
        self.core.on_opened("")
        self.token = 0

    def beat(self):
        return self.core.on_beat(self.clock.monotonic())

    def wait(self, seconds: float, *, beating: bool = True):
        effects = []
        for _ in range(round(seconds / 0.05)):
            self.clock.advance(0.05)
            effects += self.beat() if beating else self.core.tick()
        return effects

    def call(self, instruction: str, *arguments: float, device: str = "a", age: float = 0.0):
        self.token += 1
        sent = self.clock.monotonic() - age
        return self.core.on_call(
            GuardCall(self.token, device, instruction, list(arguments), sent, sent + TTL)
        )


def told(effects, kind):
    return [e.message for e in effects if isinstance(e, Notify) and isinstance(e.message, kind)]


def made_safe(effects):
    return [e.device for e in effects if isinstance(e, MakeSafe)]


def test_a_call_is_carried_out_and_answered():
    rig = Rig()
    effects = rig.call("go", 1.0)
    assert [e.call.instruction for e in effects if isinstance(e, Execute)] == ["go"]
    assert told(rig.core.on_finished(1, None), CallDone) == [CallDone(1, None)]
    assert told(rig.core.on_finished(1, None), CallDone) == []


@pytest.mark.parametrize(
    ("instruction", "arguments", "words"),
    [("fly", (), "there is no a.fly()"), ("go", (), "go() takes 1 arguments"), ("go", (1.0, 2.0), "takes 1")],
)
def test_what_does_not_exist_is_refused(instruction, arguments, words):
    (refused,) = told(Rig().call(instruction, *arguments), Refused)
    assert words in refused.reason


def test_a_setpoint_that_is_not_renewed_ends_in_the_safe_state():
    rig = Rig()
    rig.call("steer", 1.0)
    rig.core.on_finished(1, None)
    assert made_safe(rig.wait(0.45)) == []
    effects = rig.wait(0.1)
    assert made_safe(effects) == ["a"]
    assert "has expired (time-to-live 0.5 s)" in told(effects, Latched)[0].reason


def test_a_setpoint_lives_from_when_the_device_took_it_and_a_call_under_way_has_as_long():
    """The first one may take its time: a mode has to be entered first. A program can renew it only then."""
    rig = Rig()
    for _ in range(5):
        rig.call("steer", 1.0)
        assert made_safe(rig.wait(0.4)) == []
        rig.core.on_finished(rig.token, None)
        assert made_safe(rig.wait(0.4)) == []
    rig.call("steer", 1.0)
    assert made_safe(rig.wait(TTL + 0.05)) == ["a"]


def test_a_setpoint_that_is_renewed_goes_on():
    rig = Rig()
    for _ in range(10):
        effects = rig.call("steer", 1.0)
        assert [e for e in effects if isinstance(e, Execute)]
        rig.core.on_finished(rig.token, None)
        assert made_safe(rig.wait(0.4)) == []


def test_a_blocking_call_replaces_a_setpoint():
    rig = Rig()
    rig.call("steer", 1.0)
    rig.core.on_finished(1, None)
    rig.call("go", 1.0)
    assert made_safe(rig.wait(5.0)) == []
    rig.core.on_finished(2, None)
    assert made_safe(rig.wait(5.0)) == []


def test_a_blocking_call_that_is_refused_does_not_renew_the_setpoint():
    rig = Rig()
    rig.call("steer", 1.0)
    rig.core.on_finished(1, None)
    rig.call("go", 1.0)
    rig.wait(1.0)
    rig.core.on_refused(2, "DeviceException", "no")
    assert made_safe(rig.beat()) == ["a"]


@pytest.mark.parametrize("call", [("steer", 1.0), ("go", 1.0), ("release",)])
def test_what_lay_in_the_pipe_too_long_is_not_begun(call):
    rig = Rig()
    effects = rig.call(*call, age=TTL)
    assert [e for e in effects if isinstance(e, Execute)] == []
    reason = f"{call[0]}() had to start within 0.5 s, but reached its guard after 0.5 s: nothing was done"
    assert told(effects, Refused) == [Refused(1, "DeviceException", reason)]


def test_what_only_asks_may_be_asked_late():
    assert [e for e in Rig().call("ask", age=60.0) if isinstance(e, Execute)]


def test_a_call_that_was_let_in_is_too_late_when_its_guard_stands_still_before_its_driver_gets_it():
    rig = Rig()
    (execute,) = [e for e in rig.call("go", 1.0) if isinstance(e, Execute)]
    rig.clock.advance(TTL - 0.01)
    assert rig.core.mark_started(execute.call) == ""
    rig.clock.advance(0.02)
    assert "reached its guard after 0.51 s" in rig.core.mark_started(execute.call)


def test_silence_latches_what_was_moved_and_only_release_frees_it():
    rig = Rig("a", "b")
    rig.call("go", 1.0)
    effects = rig.wait(0.25, beating=False)
    assert made_safe(effects) == ["a"]
    assert [e.token for e in effects if isinstance(e, Interrupt)] == [1]
    assert "the host was silent" in told(effects, Refused)[0].reason
    rig.wait(5.0)
    (refused,) = told(rig.call("go", 1.0), Refused)
    assert "held in its safe state: the host was silent" in refused.reason
    (refused,) = told(rig.call("release"), Refused)
    assert "not confirmed yet" in refused.reason
    assert told(rig.core.on_safe("a"), Latched)[0].confirmed
    assert told(rig.call("release"), Released) == [Released("a")]
    assert [e for e in rig.call("go", 1.0) if isinstance(e, Execute)]


def test_a_beat_that_lay_in_the_pipe_does_not_excuse_silence():
    rig = Rig()
    rig.call("go", 1.0)
    sent = rig.clock.monotonic()
    rig.clock.advance(10.0)
    assert made_safe(rig.core.on_beat(sent + 9.99)) == ["a"]


def test_an_old_beat_does_not_count_as_new():
    rig = Rig()
    rig.call("go", 1.0)
    rig.clock.advance(0.15)
    rig.core.on_beat(rig.clock.monotonic() - 0.14)
    rig.clock.advance(0.1)
    assert made_safe(rig.core.tick()) == ["a"]


def test_the_newest_actuation_wins():
    rig = Rig()
    rig.call("go", 1.0)
    effects = rig.call("go", 2.0)
    assert [e.token for e in effects if isinstance(e, Interrupt)] == [1]
    assert told(effects, Refused) == [Refused(1, "DeviceException", "go() was replaced by go()")]


def test_asking_disturbs_nothing_and_works_while_latched():
    rig = Rig()
    rig.call("go", 1.0)
    effects = rig.call("ask")
    assert [type(e) for e in effects] == [Execute]
    rig.core.latch("a", "asked to")
    assert [type(e) for e in rig.call("ask")] == [Execute]


def test_a_driver_exception_makes_safe():
    rig = Rig()
    rig.call("go", 1.0)
    effects = rig.core.on_crashed(1, "the driver failed")
    assert made_safe(effects) == ["a"]
    assert told(effects, Refused)[0].reason == "the driver failed"


def test_a_safe_state_that_fails_is_tried_again():
    rig = Rig()
    rig.core.latch("", "asked to")
    rig.core.on_safe_failed("a", "no answer")
    assert made_safe(rig.wait(0.95)) == []
    assert made_safe(rig.wait(0.1)) == ["a"]


def looks(effects):
    return [e.device for e in effects if isinstance(e, CheckRest)]


def exits(effects):
    return [e.status for e in effects if isinstance(e, Exit)]


def test_a_stop_ends_when_all_is_safe_and_at_rest():
    rig = Rig("a", "b")
    assert made_safe(rig.core.on_stop("bye")) == ["a", "b"]
    assert looks(rig.core.on_safe("a")) == ["a"]
    assert told(rig.core.on_motion_report("a", "4 m up"), Moving) == [Moving("a", "4 m up")]
    assert looks(rig.core.on_safe("b")) == ["b"]
    rig.core.on_motion_report("b", "")
    assert set(looks(rig.wait(10.0))) == {"a", "b"}
    effects = rig.core.on_motion_report("a", "")
    assert told(effects, Stopped) == [Stopped({})]
    assert exits(effects) == [0]
    assert exits(rig.wait(200.0)) == []


def test_who_is_not_safe_or_not_at_rest_when_the_time_of_a_stop_is_over_is_named():
    rig = Rig("a", "b", "c")
    rig.core.on_stop("bye")
    for name, moving in (("a", ""), ("c", "4 m up")):
        rig.core.on_safe(name)
        rig.core.on_motion_report(name, moving)
    effects = rig.wait(WITHIN - 0.1)
    assert exits(effects) == []
    effects = rig.wait(0.2)
    assert told(effects, Stopped) == [
        Stopped(
            {
                "b": "its safe state was not confirmed",
                "c": "it is in its safe state and not at rest: 4 m up",
            }
        )
    ]
    assert exits(effects) == [1]


def test_a_second_word_ends_a_stop_at_once():
    rig = Rig()
    rig.core.on_stop("bye")
    rig.core.on_safe("a")
    rig.core.on_motion_report("a", "4 m up")
    effects = rig.core.on_stop("now", at_once=True)
    assert told(effects, Stopped) == [Stopped({"a": "it is in its safe state and not at rest: 4 m up"})]
    effects = Rig().core.on_stop("now", at_once=True)
    assert made_safe(effects) == ["a"], "also who is in a hurry makes everything safe"
    assert told(effects, Stopped) == [Stopped({"a": "its safe state was not confirmed"})]


def test_without_a_host_a_guard_stays_until_its_devices_are_at_rest():
    rig = Rig()
    assert made_safe(rig.core.on_host_gone("the host is gone")) == ["a"]
    assert exits(rig.wait(1.0, beating=False)) == []
    assert exits(rig.core.on_safe("a")) == []
    assert exits(rig.core.on_motion_report("a", "4 m up")) == []
    assert exits(rig.wait(30.0, beating=False)) == []
    assert exits(rig.core.on_motion_report("a", "")) == [0]


def test_without_a_host_and_on_a_quiet_bus_a_confirmed_safe_state_is_the_end():
    rig = Rig()
    rig.core.on_host_gone("the host is gone")
    assert quiets(rig.wait(SILENCE + MUTE_AFTER + 0.1, beating=False)) == [True]
    assert exits(rig.wait(30.0, beating=False)) == []
    assert exits(rig.core.on_safe("a")) == [0]


def test_a_host_that_goes_during_a_stop_changes_nothing():
    rig = Rig()
    rig.core.on_stop("bye")
    rig.core.on_safe("a")
    assert exits(rig.core.on_motion_report("a", "4 m up")) == []
    assert exits(rig.core.on_host_gone("the host is gone")) == []
    assert exits(rig.core.on_motion_report("a", "")) == [0]


def test_what_is_held_is_looked_at_until_it_is_released_and_told_when_it_changes():
    rig = Rig()
    rig.core.latch("", "asked to")
    assert looks(rig.wait(1.0)) == [], "not confirmed: there is nothing to look at yet"
    assert looks(rig.core.on_safe("a")) == ["a"]
    assert told(rig.core.on_motion_report("a", "4 m up"), Moving)
    assert told(rig.core.on_motion_report("a", "4 m up"), Moving) == []
    rig.wait(0.25)
    assert told(rig.core.on_motion_report("a", "3 m up"), Moving) == [], "twice a second is enough"
    rig.wait(0.3)
    assert told(rig.core.on_motion_report("a", "2 m up"), Moving) == [Moving("a", "2 m up")]
    assert told(rig.core.on_motion_report("a", ""), Moving) == [Moving("a", "")], "the end is told at once"
    assert told(rig.call("release"), Released)
    assert looks(rig.wait(2.0)) == []
    assert told(rig.core.on_motion_report("a", "2 m up"), Moving) == [], "an answer that comes too late"


def test_what_goes_on_moving_in_its_safe_state_is_commanded_again():
    rig = Rig()
    rig.core.latch("", "asked to")
    rig.core.on_safe("a")
    rig.wait(REPEAT - 0.1)
    assert made_safe(rig.core.on_motion_report("a", "4 m up")) == []
    rig.wait(0.2)
    assert made_safe(rig.core.on_motion_report("a", "4 m up")) == ["a"]
    rig.wait(10.0)
    assert made_safe(rig.core.on_motion_report("a", "4 m up")) == [], "the last one is still under way"
    assert told(rig.core.on_safe("a"), Latched) == [], "it was told before"
    assert made_safe(rig.core.on_motion_report("a", "4 m up")) == []
    rig.wait(REPEAT + 0.1)
    assert made_safe(rig.core.on_motion_report("a", "4 m up")) == ["a"]
    assert [e for e in rig.core.on_safe_failed("a", "no answer") if isinstance(e, Notify)] == []
    assert made_safe(rig.wait(10.0)) == [], "it is looked at first"
    assert made_safe(rig.core.on_motion_report("a", "")) == []
    assert made_safe(rig.core.on_motion_report("a", "led out")) == ["a"]


def test_who_is_released_is_not_brought_into_its_safe_state_any_more():
    rig = Rig()
    rig.core.latch("", "asked to")
    rig.core.on_safe("a")
    rig.wait(REPEAT + 0.1)
    assert made_safe(rig.core.on_motion_report("a", "4 m up")) == ["a"]
    effects = rig.call("release")
    assert [type(e) for e in effects] == [Abandon, Notify, Execute]
    rig.wait(10.0)
    assert made_safe(rig.core.on_motion_report("a", "4 m up")) == []
    assert made_safe(rig.core.latch("", "asked again")) == ["a"]


def test_being_commanded_again_gives_a_silent_host_no_more_time():
    rig = Rig()
    rig.call("go", 1.0)
    rig.wait(SILENCE + 0.5, beating=False)
    rig.core.on_safe("a")
    effects = []
    for _ in range(round(WITHIN + 20)):
        effects += rig.core.on_motion_report("a", "it circles")
        if made_safe(effects[-1:]):
            rig.core.on_safe("a")
        effects += rig.wait(1.0, beating=False)
    assert quiets(effects) == [True]
    after = effects[next(n for n, e in enumerate(effects) if isinstance(e, Mute)) :]
    assert len(made_safe(effects)) > 10
    assert made_safe(after) == [], "what feeds its own watchdog"


def test_a_restarted_guard_brings_its_devices_back_safe():
    clock = ManualClock()
    core = GuardCore([("a", MANIFEST, TTL, WITHIN)], clock)
    effects = core.on_opened("its guard died")
    assert made_safe(effects) == ["a"]
    assert told(effects, Latched) == [Latched("a", "its guard died", False)]


def test_channels_run_side_by_side_and_stop_together():
    rig = Rig()
    rig.call("go", 1.0)
    assert [type(e) for e in rig.call("grip")] == [Execute]
    assert told(rig.call("go", 2.0), Refused)[0].token == 1
    effects = rig.core.latch("", "asked")
    assert sorted(e.token for e in effects if isinstance(e, Interrupt)) == [2, 3]
    assert len(told(effects, Refused)) == 2


def test_a_setpoint_is_not_ended_by_another_channel():
    rig = Rig()
    rig.call("steer", 1.0)
    rig.core.on_finished(1, None)
    rig.call("grip")
    rig.core.on_finished(2, None)
    assert made_safe(rig.wait(0.6)) == ["a"]


def quiets(effects):
    return [e.on for e in effects if isinstance(e, Mute)]


def test_a_silent_host_makes_the_bus_quiet_and_its_beat_ends_that():
    rig = Rig()
    assert quiets(rig.wait(1.0)) == []
    assert quiets(rig.wait(SILENCE + 0.05, beating=False)) == [True]
    assert quiets(rig.wait(5.0, beating=False)) == []
    assert quiets(rig.wait(0.1)) == [False]


def test_the_bus_is_not_quiet_before_the_device_is_at_rest():
    rig = Rig()
    rig.call("go", 1.0)
    assert quiets(rig.wait(SILENCE + 0.5, beating=False)) == []
    assert quiets(rig.core.on_safe("a")) == []
    assert quiets(rig.core.on_motion_report("a", "4 m up")) == []
    assert quiets(rig.wait(30.0, beating=False)) == []
    assert quiets(rig.core.on_motion_report("a", "")) == [True]


def test_the_bus_of_a_device_that_never_rests_is_quiet_when_its_time_is_over():
    rig = Rig()
    rig.call("go", 1.0)
    rig.wait(SILENCE + 0.5, beating=False)
    rig.core.on_safe("a")
    rig.core.on_motion_report("a", "it circles")
    assert quiets(rig.wait(WITHIN - 0.1, beating=False)) == []
    assert quiets(rig.wait(0.2, beating=False)) == [True]


def test_a_safe_state_that_nobody_confirms_keeps_no_watchdog_content():
    rig = Rig()
    rig.call("go", 1.0)
    assert quiets(rig.wait(SILENCE + MUTE_AFTER - 0.1, beating=False)) == []
    assert quiets(rig.wait(0.2, beating=False)) == [True]


class CreepingClock(ManualClock):
    """A clock on which time passes while somebody looks at it, as on every real one."""

    STEP = 1e-6

    def monotonic(self):
        self.now += self.STEP
        return self.now


@pytest.mark.parametrize("early", range(1, 13))
@pytest.mark.parametrize("event", ["tick", "ask", "beat"])
def test_a_silence_that_begins_between_two_looks_at_the_clock_is_not_missed(event, early):
    clock = CreepingClock()
    core = GuardCore([("a", MANIFEST, TTL, WITHIN)], clock, silence=SILENCE)
    start = clock.monotonic()
    core.on_opened("")
    core.on_call(GuardCall(1, "a", "go", [1.0], start, start + TTL))
    core.on_finished(1, None)
    last = clock.now
    core.on_beat(last)
    clock.now = last + SILENCE - early * clock.STEP
    effects = {
        "tick": core.tick,
        "ask": lambda: core.on_call(GuardCall(2, "a", "ask", [], last, last)),
        "beat": lambda: core.on_beat(last),
    }[event]()
    while made_safe(effects) == [] and core.due() is not None:
        clock.now = max(clock.now, core.due())
        effects += core.tick()
    assert made_safe(effects) == ["a"]
    assert quiets(effects) == []
    assert clock.now < last + SILENCE + 20 * clock.STEP


def test_a_call_that_lay_in_the_pipe_of_a_silent_host_is_stopped():
    rig = Rig()
    assert quiets(rig.wait(1.0, beating=False)) == [True]
    rig.call("go", 1.0, age=0.4)
    assert rig.core.due() <= rig.clock.monotonic()
    assert made_safe(rig.core.tick()) == ["a"]


def test_who_is_barred_is_not_released_by_the_program():
    rig = Rig()
    rig.core.latch("", "the emergency stop was pressed", lock=True)
    rig.core.on_safe("a")
    (refused,) = told(rig.call("release"), Refused)
    assert "the emergency stop was pressed; 'lfield estop --lift' must come first" in refused.reason
    rig.core.clear_stop()
    assert told(rig.call("release"), Released)


def test_a_device_that_was_safe_already_is_barred_all_the_same():
    rig = Rig()
    rig.core.latch("a", "asked")
    rig.core.on_safe("a")
    assert told(rig.core.latch("a", "stop!", lock=True), Latched) == []
    assert "stop!" in told(rig.call("release"), Refused)[0].reason


class GuardMachine(RuleBasedStateMachine):
    """Any order of events: the promises of the guard, checked by a model that only watches the effects."""

    @initialize()
    def start(self):
        self.rig = Rig()
        self.latched = self.confirmed = self.moved = False
        self.making = 0
        self.running: dict[int, GuardCall] = {}
        self.last_word = self.now
        self.setpoint_until: float | None = None
        self.answered: set[int] = set()

    @property
    def now(self):
        return self.rig.clock.monotonic()

    def see(self, effects):
        for effect in effects:
            if isinstance(effect, MakeSafe):
                self.making += 1
                assert self.making == 1, "one at a time"
                assert self.latched or not self.confirmed
            elif isinstance(effect, Abandon):
                self.making -= 1
            elif isinstance(effect, Interrupt):
                self.running.pop(effect.token)
            elif isinstance(effect, Execute):
                call = effect.call
                acts = call.instruction in MOVING
                assert not (acts and self.latched), "a latched device was moved"
                if call.instruction == "steer":
                    assert self.now - call.sent < TTL, "a setpoint went out after its time-to-live"
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
        self.see(self.rig.core.tick())

    @precondition(lambda self: not self.latched)
    @rule(instruction=st.sampled_from(["go", "steer"]), steps=st.integers(0, 15))
    def move(self, instruction, steps):
        """The usual life, which random rules alone would seldom lead: a call, its end, and time."""
        self.call(instruction, 0.0)
        token = self.rig.token
        if token in self.running:
            self._end(token, "finished")
        self.live(steps)

    @rule(steps=st.integers(1, 15))
    def live(self, steps):
        for _ in range(steps):
            self.rig.clock.advance(0.05)
            self.see(self.rig.beat())
            self.last_word = max(self.last_word, self.now)
            self.promises()

    @rule(age=st.just(0.0) | st.floats(0.0, 1.0), stopped=st.floats(0.0, 0.4))
    def beat(self, age, stopped):
        self.rig.clock.advance(stopped)
        silent = self.moved and self.now >= self.last_word + SILENCE
        sent = self.now - age
        self.see(self.rig.core.on_beat(sent))
        self.last_word = max(self.last_word, sent)
        assert self.latched or not silent, "a beat that came late excused the silence"

    @rule(
        instruction=st.sampled_from(["go", "steer", "ask", "release"]), age=st.just(0.0) | st.floats(0.0, 0.7)
    )
    def call(self, instruction, age):
        arguments = [1.0] if instruction in ("go", "steer") else []
        self.see(self.rig.call(instruction, *arguments, age=age))
        self.last_word = max(self.last_word, self.now - age)

    @precondition(lambda self: self.running)
    @rule(data=st.data(), how=st.sampled_from(["finished", "refused", "crashed"]))
    def end(self, data, how):
        self._end(data.draw(st.sampled_from(sorted(self.running))), how)

    def _end(self, token, how):
        call = self.running[token]
        cancelled = token < 0
        arguments = {"finished": (None,), "refused": ("DeviceException", "no"), "crashed": ("boom",)}[how]
        effects = getattr(self.rig.core, f"on_{how}")(token, *arguments)
        if any(done.token == token for done in told(effects, CallDone)):
            if call.instruction == "steer":
                self.setpoint_until = self.now + TTL
            elif call.instruction == "go":
                self.setpoint_until = None
        if cancelled and how == "finished" and told(effects, Refused):
            self.setpoint_until = None
        self.running.pop(token, None)
        self.see(effects)
        if how == "crashed" or (cancelled and how == "refused"):
            assert self.latched

    @precondition(lambda self: any(token > 0 for token in self.running))
    @rule(data=st.data(), age=st.just(0.0) | st.floats(0.0, 0.7))
    def cancel(self, data, age):
        """A cancelled motion is replaced by its end at once, unless the device has gone safe meanwhile."""
        token = data.draw(st.sampled_from(sorted(token for token in self.running if token > 0)))
        was = self.running[token]
        self.see(self.rig.core.on_cancel(token, self.now - age))
        self.last_word = max(self.last_word, self.now - age)
        if was.instruction == "go":
            assert self.latched or self.running[-token].instruction == "halt"

    @precondition(lambda self: self.making)
    @rule(good=st.booleans())
    def safety_answer(self, good):
        self.making -= 1
        if good:
            self.see(self.rig.core.on_safe("a"))
            self.confirmed = True
        else:
            self.see(self.rig.core.on_safe_failed("a", "no answer"))

    @precondition(lambda self: self.confirmed)
    @rule(moving=st.sampled_from(["", "4 m up"]))
    def looked(self, moving):
        self.see(self.rig.core.on_motion_report("a", moving))

    @rule()
    def asked_to_be_safe(self):
        self.see(self.rig.core.latch("", "asked"))
        assert self.latched

    @invariant()
    def promises(self):
        if not hasattr(self, "rig"):
            return
        self.see(self.rig.core.tick())
        if self.moved and self.now >= self.last_word + SILENCE:
            assert self.latched, "the host was silent and the device is free"
        acting = [c for c in self.running.values() if c.instruction in MOVING]
        assert len(acting) <= 1
        if self.setpoint_until is not None and not acting and self.now >= self.setpoint_until:
            assert self.latched, "a setpoint is over and the device is free"
        due = self.rig.core.due()
        assert due is None or due > self.now, "something is due and has not been done"


GuardMachine.TestCase.settings = settings(max_examples=300, stateful_step_count=30, deadline=None)
TestGuardMachine = GuardMachine.TestCase


def test_a_sensor_is_never_latched_nor_waited_for():
    """Nothing that it does could be made safe: it is at rest at once, and needs no release."""
    clock = ManualClock()
    core = GuardCore([("eye", SENSOR, TTL, WITHIN)], clock, silence=SILENCE)
    (note,) = told(core.on_opened("its guard died"), Note)
    assert (note.code, note.text) == ("sensor-not-latched", "sensor without safe state: its guard died")
    assert made_safe(core.latch("", "somebody pressed it", lock=True)) == []
    core.clear_stop()
    assert told(core.latch("eye", "the driver failed: x"), Note)
    assert told(core.latch("eye", "the driver failed: x"), Note) == []
    clock.advance(3 * SILENCE)
    assert told(core.tick(), Latched) == []
    core.on_beat(clock.monotonic())
    assert [
        e
        for e in core.on_call(GuardCall(1, "eye", "ask", [], clock.monotonic(), 0.0))
        if isinstance(e, Execute)
    ]
    over = core.on_stop("the host is stopping")
    assert told(over, Stopped) == [Stopped({})]
    assert [e.status for e in over if isinstance(e, Exit)] == [0]


def test_a_stop_waits_for_what_moves_beside_a_sensor():
    core = GuardCore([("eye", SENSOR, TTL, WITHIN), ("arm", MANIFEST, TTL, WITHIN)], ManualClock())
    core.on_opened("")
    assert made_safe(core.on_stop("the host is stopping")) == ["arm"]
    assert told(core.on_safe("arm"), Stopped) == []
    assert told(core.on_motion_report("arm", ""), Stopped) == [Stopped({})]


def test_another_safe_state_is_commanded_also_of_a_device_that_is_held_already():
    rig = Rig()
    rig.core.latch("a", "the host was silent")
    effects = rig.core.latch("a", "nobody flies it", state="lie down")
    assert [e for e in effects if isinstance(e, Abandon | MakeSafe)] == [
        Abandon("a"),
        MakeSafe("a", "lie down"),
    ]
    assert told(effects, Latched) == [Latched("a", "nobody flies it", False, "lie down")]
    rig.core.on_safe_failed("a", "no answer")
    assert [e for e in rig.wait(1.1) if isinstance(e, MakeSafe)] == [MakeSafe("a", "lie down")]
    (confirmed,) = told(rig.core.on_safe("a"), Latched)
    assert confirmed == Latched("a", "nobody flies it", True, "lie down")
    assert rig.core.latch("a", "once more", state="lie down") == []
    assert rig.core.latch("a", "the usual one", state="") == []
    rig.call("release")
    effects = rig.core.latch("a", "the host was silent")
    assert [e for e in effects if isinstance(e, MakeSafe)] == [MakeSafe("a")]
