from __future__ import annotations

import pytest
from guard_rig import (
    MANIFEST,
    SILENCE,
    TTL,
    WITHIN,
    Rig,
    effects_of,
    exits,
    made_safe,
    messages,
    mutes,
    rest_checks,
)

from lfield.clock import ManualClock
from lfield.guard.core import MUTE_AFTER, REPEAT, GuardCore
from lfield.guard.effects import Abandon, Execute, Interrupt, MakeSafe, Mute, Notify
from lfield.guard.messages import CallDone, GuardCall, Latched, Moving, Note, Refused, Released, Stopped
from lfield.manifest import DeviceManifest

SENSOR = DeviceManifest("Eye", "eye", MANIFEST.instructions[3:5])


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
        assert effects_of(effects, Execute)
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
    assert effects_of(effects, Execute) == []
    reason = f"{call[0]}() had to start within 0.5 s, but reached its guard after 0.5 s: nothing was done"
    assert messages(effects, Refused) == [Refused(1, "DeviceException", reason)]


def test_delayed_query_is_executed():
    assert effects_of(Rig().call("ask", age=60.0), Execute)


def test_call_delayed_between_guard_and_driver_is_refused():
    rig = Rig()
    (execute,) = effects_of(rig.call("go", 1.0), Execute)
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
    assert effects_of(rig.call("go", 1.0), Execute)


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
    expected = {
        "b": "its safe state was not confirmed",
        "c": "it is in its safe state and not at rest: 4 m up",
    }
    assert messages(effects, Stopped) == [Stopped(expected)]
    assert exits(effects) == [1]


def test_immediate_stop_ends_at_once_and_names_the_devices():
    rig = Rig()
    rig.core.on_stop("bye")
    rig.core.on_safe("a")
    rig.core.on_motion_report("a", "4 m up")
    effects = rig.core.on_stop("now", at_once=True)
    assert messages(effects, Stopped) == [Stopped({"a": "it is in its safe state and not at rest: 4 m up"})]
    effects = Rig().core.on_stop("now", at_once=True)
    assert made_safe(effects) == ["a"], "an immediate stop also makes every device safe"
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
    assert messages(rig.core.on_motion_report("a", "2 m up"), Moving) == [], (
        "a report after the release is ignored"
    )


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
    assert messages(rig.core.on_safe("a"), Latched) == [], "the confirmation was reported before"
    assert made_safe(rig.core.on_motion_report("a", "4 m up")) == []
    rig.wait(REPEAT + 0.1)
    assert made_safe(rig.core.on_motion_report("a", "4 m up")) == ["a"]
    assert effects_of(rig.core.on_safe_failed("a", "no answer"), Notify) == []
    assert made_safe(rig.wait(10.0)) == [], "the device is checked for rest first"
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
    after_mute = effects[next(n for n, e in enumerate(effects) if isinstance(e, Mute)) :]
    assert len(made_safe(effects)) > 10
    assert made_safe(after_mute) == [], "further commands would feed the device's watchdog"


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


def test_sensor_is_not_latched_and_does_not_delay_a_stop():
    """A sensor does not move: it counts as at rest, and a stop or a failure needs no release."""
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
    assert effects_of(core.on_call(GuardCall(1, "eye", "ask", [], clock.monotonic(), 0.0)), Execute)
    effects = core.on_stop("the host is stopping")
    assert messages(effects, Stopped) == [Stopped({})]
    assert exits(effects) == [0]


def test_stop_waits_for_an_actuated_device_beside_a_sensor():
    core = GuardCore([("eye", SENSOR, TTL, WITHIN), ("arm", MANIFEST, TTL, WITHIN)], ManualClock())
    core.on_opened("")
    assert made_safe(core.on_stop("the host is stopping")) == ["arm"]
    assert messages(core.on_safe("arm"), Stopped) == []
    assert messages(core.on_motion_report("arm", ""), Stopped) == [Stopped({})]


def test_latched_device_changes_to_another_requested_safe_state():
    rig = Rig()
    rig.core.latch("a", "the host was silent")
    effects = rig.core.latch("a", "no pilot", state="lie down")
    assert effects_of(effects, Abandon | MakeSafe) == [Abandon("a"), MakeSafe("a", "lie down")]
    assert messages(effects, Latched) == [Latched("a", "no pilot", False, "lie down")]
    rig.core.on_safe_failed("a", "no answer")
    assert effects_of(rig.wait(1.1), MakeSafe) == [MakeSafe("a", "lie down")]
    (confirmed,) = messages(rig.core.on_safe("a"), Latched)
    assert confirmed == Latched("a", "no pilot", True, "lie down")
    assert rig.core.latch("a", "once more", state="lie down") == []
    assert rig.core.latch("a", "the usual one", state="") == []
    rig.call("release")
    effects = rig.core.latch("a", "the host was silent")
    assert effects_of(effects, MakeSafe) == [MakeSafe("a")]
