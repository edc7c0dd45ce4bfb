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
    """A core with its clock; each step sends a heartbeat unless `beating` is false."""

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


def messages(effects, kind):
    return [e.message for e in effects if isinstance(e, Notify) and isinstance(e.message, kind)]


def made_safe(effects):
    return [e.device for e in effects if isinstance(e, MakeSafe)]


def test_call_is_executed_and_answered_once():
    rig = Rig()
    effects = rig.call("go", 1.0)
    assert [e.call.instruction for e in effects if isinstance(e, Execute)] == ["go"]
    assert messages(rig.core.on_finished(1, None), CallDone) == [CallDone(1, None)]
    assert messages(rig.core.on_finished(1, None), CallDone) == []


@pytest.mark.parametrize(
    ("instruction", "arguments", "words"),
    [("fly", (), "there is no a.fly()"), ("go", (), "go() takes 1 arguments"), ("go", (1.0, 2.0), "takes 1")],
)
def test_unknown_instruction_or_wrong_argument_count_is_refused(instruction, arguments, words):
    (refused,) = messages(Rig().call(instruction, *arguments), Refused)
    assert words in refused.reason


def test_setpoint_without_renewal_ends_in_the_safe_state():
    rig = Rig()
    rig.call("steer", 1.0)
    rig.core.on_finished(1, None)
    assert made_safe(rig.wait(0.45)) == []
    effects = rig.wait(0.1)
    assert made_safe(effects) == ["a"]
    assert "has expired (time-to-live 0.5 s)" in messages(effects, Latched)[0].reason


def test_ttl_starts_at_execution_and_limits_a_running_call():
    """The first setpoint may take longer, to enter a mode. The program can renew it only afterwards."""
    rig = Rig()
    for _ in range(5):
        rig.call("steer", 1.0)
        assert made_safe(rig.wait(0.4)) == []
        rig.core.on_finished(rig.token, None)
        assert made_safe(rig.wait(0.4)) == []
    rig.call("steer", 1.0)
    assert made_safe(rig.wait(TTL + 0.05)) == ["a"]


def test_renewed_setpoint_continues():
    rig = Rig()
    for _ in range(10):
        effects = rig.call("steer", 1.0)
        assert [e for e in effects if isinstance(e, Execute)]
        rig.core.on_finished(rig.token, None)
        assert made_safe(rig.wait(0.4)) == []


def test_blocking_call_replaces_a_setpoint():
    rig = Rig()
    rig.call("steer", 1.0)
    rig.core.on_finished(1, None)
    rig.call("go", 1.0)
    assert made_safe(rig.wait(5.0)) == []
    rig.core.on_finished(2, None)
    assert made_safe(rig.wait(5.0)) == []


def test_refused_blocking_call_does_not_renew_the_setpoint():
    rig = Rig()
    rig.call("steer", 1.0)
    rig.core.on_finished(1, None)
    rig.call("go", 1.0)
    rig.wait(1.0)
    rig.core.on_refused(2, "DeviceException", "no")
    assert made_safe(rig.beat()) == ["a"]


@pytest.mark.parametrize("call", [("steer", 1.0), ("go", 1.0), ("release",)])
def test_call_delayed_in_the_pipe_is_refused(call):
    rig = Rig()
    effects = rig.call(*call, age=TTL)
    assert [e for e in effects if isinstance(e, Execute)] == []
    reason = f"{call[0]}() had to start within 0.5 s, but reached its guard after 0.5 s: nothing was done"
    assert messages(effects, Refused) == [Refused(1, "DeviceException", reason)]


def test_delayed_query_is_executed():
    assert [e for e in Rig().call("ask", age=60.0) if isinstance(e, Execute)]


def test_call_delayed_between_guard_and_driver_is_refused():
    rig = Rig()
    (execute,) = [e for e in rig.call("go", 1.0) if isinstance(e, Execute)]
    rig.clock.advance(TTL - 0.01)
    assert rig.core.mark_started(execute.call) == ""
    rig.clock.advance(0.02)
    assert "reached its guard after 0.51 s" in rig.core.mark_started(execute.call)


def test_silence_latches_moved_devices_until_release():
    rig = Rig("a", "b")
    rig.call("go", 1.0)
    effects = rig.wait(0.25, beating=False)
    assert made_safe(effects) == ["a"]
    assert [e.token for e in effects if isinstance(e, Interrupt)] == [1]
    assert "the host was silent" in messages(effects, Refused)[0].reason
    rig.wait(5.0)
    (refused,) = messages(rig.call("go", 1.0), Refused)
    assert "held in its safe state: the host was silent" in refused.reason
    (refused,) = messages(rig.call("release"), Refused)
    assert "not confirmed yet" in refused.reason
    assert messages(rig.core.on_safe("a"), Latched)[0].confirmed
    assert messages(rig.call("release"), Released) == [Released("a")]
    assert [e for e in rig.call("go", 1.0) if isinstance(e, Execute)]


def test_heartbeat_delayed_in_the_pipe_does_not_hide_silence():
    rig = Rig()
    rig.call("go", 1.0)
    sent = rig.clock.monotonic()
    rig.clock.advance(10.0)
    assert made_safe(rig.core.on_beat(sent + 9.99)) == ["a"]


def test_old_heartbeat_does_not_extend_the_silence_limit():
    rig = Rig()
    rig.call("go", 1.0)
    rig.clock.advance(0.15)
    rig.core.on_beat(rig.clock.monotonic() - 0.14)
    rig.clock.advance(0.1)
    assert made_safe(rig.core.tick()) == ["a"]


def test_newest_actuation_replaces_the_earlier_one():
    rig = Rig()
    rig.call("go", 1.0)
    effects = rig.call("go", 2.0)
    assert [e.token for e in effects if isinstance(e, Interrupt)] == [1]
    assert messages(effects, Refused) == [Refused(1, "DeviceException", "go() was replaced by go()")]


def test_query_interrupts_nothing_and_works_while_latched():
    rig = Rig()
    rig.call("go", 1.0)
    effects = rig.call("ask")
    assert [type(e) for e in effects] == [Execute]
    rig.core.latch("a", "asked to")
    assert [type(e) for e in rig.call("ask")] == [Execute]


def test_driver_crash_makes_the_device_safe():
    rig = Rig()
    rig.call("go", 1.0)
    effects = rig.core.on_crashed(1, "the driver failed")
    assert made_safe(effects) == ["a"]
    assert messages(effects, Refused)[0].reason == "the driver failed"


def test_failed_safe_state_is_retried():
    rig = Rig()
    rig.core.latch("", "asked to")
    rig.core.on_safe_failed("a", "no answer")
    assert made_safe(rig.wait(0.95)) == []
    assert made_safe(rig.wait(0.1)) == ["a"]


def rest_checks(effects):
    return [e.device for e in effects if isinstance(e, CheckRest)]


def exits(effects):
    return [e.status for e in effects if isinstance(e, Exit)]


def test_stop_ends_when_all_devices_are_safe_and_at_rest():
    rig = Rig("a", "b")
    assert made_safe(rig.core.on_stop("bye")) == ["a", "b"]
    assert rest_checks(rig.core.on_safe("a")) == ["a"]
    assert messages(rig.core.on_motion_report("a", "4 m up"), Moving) == [Moving("a", "4 m up")]
    assert rest_checks(rig.core.on_safe("b")) == ["b"]
    rig.core.on_motion_report("b", "")
    assert set(rest_checks(rig.wait(10.0))) == {"a", "b"}
    effects = rig.core.on_motion_report("a", "")
    assert messages(effects, Stopped) == [Stopped({})]
    assert exits(effects) == [0]
    assert exits(rig.wait(200.0)) == []


def test_stop_timeout_names_devices_not_safe_or_not_at_rest():
    rig = Rig("a", "b", "c")
    rig.core.on_stop("bye")
    for name, moving in (("a", ""), ("c", "4 m up")):
        rig.core.on_safe(name)
        rig.core.on_motion_report(name, moving)
    effects = rig.wait(WITHIN - 0.1)
    assert exits(effects) == []
    effects = rig.wait(0.2)
    assert messages(effects, Stopped) == [
        Stopped(
            {
                "b": "its safe state was not confirmed",
                "c": "it is in its safe state and not at rest: 4 m up",
            }
        )
    ]
    assert exits(effects) == [1]


def test_immediate_stop_ends_at_once_and_names_the_devices():
    rig = Rig()
    rig.core.on_stop("bye")
    rig.core.on_safe("a")
    rig.core.on_motion_report("a", "4 m up")
    effects = rig.core.on_stop("now", at_once=True)
    assert messages(effects, Stopped) == [Stopped({"a": "it is in its safe state and not at rest: 4 m up"})]
    effects = Rig().core.on_stop("now", at_once=True)
    assert made_safe(effects) == ["a"], "an immediate stop also makes everything safe"
    assert messages(effects, Stopped) == [Stopped({"a": "its safe state was not confirmed"})]


def test_guard_without_host_stays_until_its_devices_are_at_rest():
    rig = Rig()
    assert made_safe(rig.core.on_host_gone("the host is gone")) == ["a"]
    assert exits(rig.wait(1.0, beating=False)) == []
    assert exits(rig.core.on_safe("a")) == []
    assert exits(rig.core.on_motion_report("a", "4 m up")) == []
    assert exits(rig.wait(30.0, beating=False)) == []
    assert exits(rig.core.on_motion_report("a", "")) == [0]


def test_guard_on_a_muted_bus_ends_at_a_confirmed_safe_state():
    rig = Rig()
    rig.core.on_host_gone("the host is gone")
    assert mutes(rig.wait(SILENCE + MUTE_AFTER + 0.1, beating=False)) == [True]
    assert exits(rig.wait(30.0, beating=False)) == []
    assert exits(rig.core.on_safe("a")) == [0]


def test_loss_of_the_host_during_a_stop_changes_nothing():
    rig = Rig()
    rig.core.on_stop("bye")
    rig.core.on_safe("a")
    assert exits(rig.core.on_motion_report("a", "4 m up")) == []
    assert exits(rig.core.on_host_gone("the host is gone")) == []
    assert exits(rig.core.on_motion_report("a", "")) == [0]


def test_latched_device_is_checked_until_release():
    rig = Rig()
    rig.core.latch("", "asked to")
    assert rest_checks(rig.wait(1.0)) == [], "not confirmed: nothing to check yet"
    assert rest_checks(rig.core.on_safe("a")) == ["a"]
    assert messages(rig.core.on_motion_report("a", "4 m up"), Moving)
    assert messages(rig.core.on_motion_report("a", "4 m up"), Moving) == []
    rig.wait(0.25)
    assert messages(rig.core.on_motion_report("a", "3 m up"), Moving) == [], "at most two reports per second"
    rig.wait(0.3)
    assert messages(rig.core.on_motion_report("a", "2 m up"), Moving) == [Moving("a", "2 m up")]
    assert messages(rig.core.on_motion_report("a", ""), Moving) == [Moving("a", "")], (
        "rest is reported at once"
    )
    assert messages(rig.call("release"), Released)
    assert rest_checks(rig.wait(2.0)) == []
    assert messages(rig.core.on_motion_report("a", "2 m up"), Moving) == [], "a late answer"


def test_device_that_moves_in_its_safe_state_is_commanded_again():
    rig = Rig()
    rig.core.latch("", "asked to")
    rig.core.on_safe("a")
    rig.wait(REPEAT - 0.1)
    assert made_safe(rig.core.on_motion_report("a", "4 m up")) == []
    rig.wait(0.2)
    assert made_safe(rig.core.on_motion_report("a", "4 m up")) == ["a"]
    rig.wait(10.0)
    assert made_safe(rig.core.on_motion_report("a", "4 m up")) == [], "the last command is still pending"
    assert messages(rig.core.on_safe("a"), Latched) == [], "it was reported before"
    assert made_safe(rig.core.on_motion_report("a", "4 m up")) == []
    rig.wait(REPEAT + 0.1)
    assert made_safe(rig.core.on_motion_report("a", "4 m up")) == ["a"]
    assert [e for e in rig.core.on_safe_failed("a", "no answer") if isinstance(e, Notify)] == []
    assert made_safe(rig.wait(10.0)) == [], "it is checked first"
    assert made_safe(rig.core.on_motion_report("a", "")) == []
    assert made_safe(rig.core.on_motion_report("a", "led out")) == ["a"]


def test_release_ends_the_safe_state_commands():
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


def test_repeated_safe_state_commands_do_not_delay_the_mute():
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
    assert mutes(effects) == [True]
    after = effects[next(n for n, e in enumerate(effects) if isinstance(e, Mute)) :]
    assert len(made_safe(effects)) > 10
    assert made_safe(after) == [], "these commands would feed the device's watchdog"


def test_restarted_guard_makes_its_devices_safe():
    clock = ManualClock()
    core = GuardCore([("a", MANIFEST, TTL, WITHIN)], clock)
    effects = core.on_opened("its guard died")
    assert made_safe(effects) == ["a"]
    assert messages(effects, Latched) == [Latched("a", "its guard died", False)]


def test_channels_run_in_parallel_and_stop_together():
    rig = Rig()
    rig.call("go", 1.0)
    assert [type(e) for e in rig.call("grip")] == [Execute]
    assert messages(rig.call("go", 2.0), Refused)[0].token == 1
    effects = rig.core.latch("", "asked")
    assert sorted(e.token for e in effects if isinstance(e, Interrupt)) == [2, 3]
    assert len(messages(effects, Refused)) == 2


def test_setpoint_expires_despite_another_channel():
    rig = Rig()
    rig.call("steer", 1.0)
    rig.core.on_finished(1, None)
    rig.call("grip")
    rig.core.on_finished(2, None)
    assert made_safe(rig.wait(0.6)) == ["a"]


def mutes(effects):
    return [e.on for e in effects if isinstance(e, Mute)]


def test_silent_host_mutes_the_bus_until_its_next_heartbeat():
    rig = Rig()
    assert mutes(rig.wait(1.0)) == []
    assert mutes(rig.wait(SILENCE + 0.05, beating=False)) == [True]
    assert mutes(rig.wait(5.0, beating=False)) == []
    assert mutes(rig.wait(0.1)) == [False]


def test_bus_is_not_muted_before_the_device_is_at_rest():
    rig = Rig()
    rig.call("go", 1.0)
    assert mutes(rig.wait(SILENCE + 0.5, beating=False)) == []
    assert mutes(rig.core.on_safe("a")) == []
    assert mutes(rig.core.on_motion_report("a", "4 m up")) == []
    assert mutes(rig.wait(30.0, beating=False)) == []
    assert mutes(rig.core.on_motion_report("a", "")) == [True]


def test_bus_of_a_moving_device_is_muted_after_its_time():
    rig = Rig()
    rig.call("go", 1.0)
    rig.wait(SILENCE + 0.5, beating=False)
    rig.core.on_safe("a")
    rig.core.on_motion_report("a", "it circles")
    assert mutes(rig.wait(WITHIN - 0.1, beating=False)) == []
    assert mutes(rig.wait(0.2, beating=False)) == [True]


def test_unconfirmed_safe_state_does_not_delay_the_mute():
    rig = Rig()
    rig.call("go", 1.0)
    assert mutes(rig.wait(SILENCE + MUTE_AFTER - 0.1, beating=False)) == []
    assert mutes(rig.wait(0.2, beating=False)) == [True]


class CreepingClock(ManualClock):
    """A clock that advances with each reading, like a real one."""

    STEP = 1e-6

    def monotonic(self):
        self.now += self.STEP
        return self.now


@pytest.mark.parametrize("early", range(1, 13))
@pytest.mark.parametrize("event", ["tick", "ask", "beat"])
def test_silence_that_starts_between_two_clock_readings_is_found(event, early):
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
    assert mutes(effects) == []
    assert clock.now < last + SILENCE + 20 * clock.STEP


def test_delayed_call_of_a_silent_host_is_stopped():
    rig = Rig()
    assert mutes(rig.wait(1.0, beating=False)) == [True]
    rig.call("go", 1.0, age=0.4)
    assert rig.core.due() <= rig.clock.monotonic()
    assert made_safe(rig.core.tick()) == ["a"]


def test_locked_device_is_not_released_by_the_program():
    rig = Rig()
    rig.core.latch("", "the emergency stop was pressed", lock=True)
    rig.core.on_safe("a")
    (refused,) = messages(rig.call("release"), Refused)
    assert "the emergency stop was pressed; 'lfield estop --lift' must come first" in refused.reason
    rig.core.clear_stop()
    assert messages(rig.call("release"), Released)


def test_device_that_is_already_safe_can_be_locked():
    rig = Rig()
    rig.core.latch("a", "asked")
    rig.core.on_safe("a")
    assert messages(rig.core.latch("a", "stop!", lock=True), Latched) == []
    assert "stop!" in messages(rig.call("release"), Refused)[0].reason


class GuardMachine(RuleBasedStateMachine):
    """Any order of events: a model that only observes the effects checks the promises of the guard."""

    @initialize()
    def start(self):
        self.rig = Rig()
        self.latched = self.confirmed = self.moved = False
        self.making = 0
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
                self.making += 1
                assert self.making == 1, "only one safe-state command at a time"
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
        """The usual sequence, which random rules alone seldom produce: a call, its end, and time."""
        self.call(instruction, 0.0)
        token = self.rig.token
        if token in self.running:
            self._end(token, "finished")
        self.live(steps)

    @rule(steps=st.integers(1, 15))
    def live(self, steps):
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
        if any(done.token == token for done in messages(effects, CallDone)):
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
        was = self.running[token]
        self.observe(self.rig.core.on_cancel(token, self.now - age))
        self.last_contact = max(self.last_contact, self.now - age)
        if was.instruction == "go":
            assert self.latched or self.running[-token].instruction == "halt"

    @precondition(lambda self: self.making)
    @rule(good=st.booleans())
    def safety_answer(self, good):
        self.making -= 1
        if good:
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
            assert self.latched, "the host was silent and the device is free"
        acting = [c for c in self.running.values() if c.instruction in MOVING]
        assert len(acting) <= 1
        if self.setpoint_until is not None and not acting and self.now >= self.setpoint_until:
            assert self.latched, "a setpoint has expired and the device is free"
        due = self.rig.core.due()
        assert due is None or due > self.now, "something is due and has not been done"


GuardMachine.TestCase.settings = settings(max_examples=300, stateful_step_count=30, deadline=None)
TestGuardMachine = GuardMachine.TestCase


def test_sensor_is_neither_latched_nor_waited_for():
    """A sensor has no motion to make safe: it is at rest at once, and needs no release."""
    clock = ManualClock()
    core = GuardCore([("eye", SENSOR, TTL, WITHIN)], clock, silence=SILENCE)
    (note,) = messages(core.on_opened("its guard died"), Note)
    assert (note.code, note.text) == ("sensor-not-latched", "sensor without safe state: its guard died")
    assert made_safe(core.latch("", "the stop was pressed", lock=True)) == []
    core.clear_stop()
    assert messages(core.latch("eye", "the driver failed: x"), Note)
    assert messages(core.latch("eye", "the driver failed: x"), Note) == []
    clock.advance(3 * SILENCE)
    assert messages(core.tick(), Latched) == []
    core.on_beat(clock.monotonic())
    assert [
        e
        for e in core.on_call(GuardCall(1, "eye", "ask", [], clock.monotonic(), 0.0))
        if isinstance(e, Execute)
    ]
    over = core.on_stop("the host is stopping")
    assert messages(over, Stopped) == [Stopped({})]
    assert [e.status for e in over if isinstance(e, Exit)] == [0]


def test_stop_waits_for_an_actuated_device_beside_a_sensor():
    core = GuardCore([("eye", SENSOR, TTL, WITHIN), ("arm", MANIFEST, TTL, WITHIN)], ManualClock())
    core.on_opened("")
    assert made_safe(core.on_stop("the host is stopping")) == ["arm"]
    assert messages(core.on_safe("arm"), Stopped) == []
    assert messages(core.on_motion_report("arm", ""), Stopped) == [Stopped({})]


def test_another_safe_state_replaces_the_one_of_a_latched_device():
    rig = Rig()
    rig.core.latch("a", "the host was silent")
    effects = rig.core.latch("a", "no pilot", state="lie down")
    assert [e for e in effects if isinstance(e, Abandon | MakeSafe)] == [
        Abandon("a"),
        MakeSafe("a", "lie down"),
    ]
    assert messages(effects, Latched) == [Latched("a", "no pilot", False, "lie down")]
    rig.core.on_safe_failed("a", "no answer")
    assert [e for e in rig.wait(1.1) if isinstance(e, MakeSafe)] == [MakeSafe("a", "lie down")]
    (confirmed,) = messages(rig.core.on_safe("a"), Latched)
    assert confirmed == Latched("a", "no pilot", True, "lie down")
    assert rig.core.latch("a", "once more", state="lie down") == []
    assert rig.core.latch("a", "the usual one", state="") == []
    rig.call("release")
    effects = rig.core.latch("a", "the host was silent")
    assert [e for e in effects if isinstance(e, MakeSafe)] == [MakeSafe("a")]
