"""How late a computer is and may be: the rule, the figures and the warnings, on time that is given."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.devices.scheduling_jitter import (
    HEARTBEAT_INTERVAL,
    WINDOW,
    HeartbeatJitter,
    JitterLimit,
    JitterMonitor,
)

SILENCE = 0.2


@pytest.mark.parametrize("prompt", [False, True], ids=["guards wait", "guards come first"])
@pytest.mark.parametrize(
    ("silence", "late", "keeps"),
    [
        (0.1, 0.0, True),
        (0.1, 0.02, True),  # one hiccup of a healthy small computer
        (0.1, 0.05, False),
        (0.1, 0.12, False),
        (0.2, 0.05, True),
        (0.2, 0.12, False),
        (2.0, 0.9, True),
        (2.0, 1.9, False),
        (10.0, 9.96, False),
    ],
)
def test_which_silence_a_computer_keeps(silence, late, keeps, prompt):
    assert (late <= JitterLimit(silence, prompt).max_jitter) is keeps


@given(st.floats(0.0, 20.0), st.booleans())
def test_what_it_could_keep_it_keeps_and_a_tenth_less_it_does_not(late, prompt):
    kept = JitterLimit(SILENCE, prompt).shortest_silence(late)
    assert kept >= 0.1
    assert late <= JitterLimit(kept, prompt).max_jitter + 1e-6
    assert kept == 0.1 or late > JitterLimit(kept - 0.1, prompt).max_jitter - 1e-6


def test_what_is_not_kept_is_told_with_what_could_be_and_what_to_do():
    limit = JitterLimit(0.1)
    assert limit.report(0.12) == (
        "'silence: 0.1' is too short for this computer: heartbeats to guards are up to 0.12 s late, "
        "and the shortest possible silence is 0.3 s"
    )
    assert limit.remedy(0.12) == (
        "reduce the load of this computer, give its guards real-time priority (LimitRTPRIO=1, see "
        "'lfield doctor') or "
        "write 'silence: 0.3' if the vehicles may move for so long without their host"
    )
    assert limit.report(0.004) == "heartbeats to guards up to 4 ms late: fast enough for 'silence: 0.1'"


def test_guards_that_come_first_count_less_and_need_not_be_let():
    limit = JitterLimit(0.2, prompt=True)
    assert limit.shortest_silence(0.12) == 0.3
    assert limit.shortest_silence(0.09) == 0.2 < JitterLimit(0.2).shortest_silence(0.09)
    assert limit.remedy(0.12) == (
        "reduce the load of this computer or write 'silence: 0.3' "
        "if the vehicles may move for so long without their host"
    )


def test_no_silence_is_named_that_could_not_be_written():
    assert JitterLimit(10.0).report(6.0).endswith("up to 6.00 s late, and no silence is long enough")
    assert JitterLimit(10.0, prompt=True).remedy(7.0) == "reduce the load of this computer"


# --- while it runs ------------------------------------------------------------------------------------


class Run:
    """Beats on a clock that is given, each as late as is said."""

    def __init__(self, silence=SILENCE):
        self.now = 1000.0
        self.lateness = JitterMonitor(JitterLimit(silence))

    def beat(self, late=0.0):
        due = self.now + HEARTBEAT_INTERVAL
        self.now = due + late
        return self.lateness.sample(due, self.now)

    def beats(self, seconds):
        return [word for _ in range(round(seconds / HEARTBEAT_INTERVAL)) if (word := self.beat())]


def test_beats_in_time_say_nothing():
    run = Run()
    assert run.beats(100.0) == []
    assert run.lateness.longest < 1e-6
    assert run.lateness.last_minute(run.now) < 1e-6


def test_a_beat_that_comes_early_is_not_late():
    lateness = JitterMonitor(JitterLimit(SILENCE))
    assert lateness.sample(5.0, 4.9) is None
    assert lateness.longest == 0.0


def test_a_lateness_near_the_limit_is_warned_of_with_what_happens_then():
    run = Run()
    assert run.beat(0.07) is None
    assert run.beat(0.08) == (
        "heartbeats to the guards late by 80 ms (longest so far 80 ms): this computer is overloaded; reduce "
        "its load, since guards make their devices safe at 0.15 s"
    )


def test_it_warns_once_a_minute_and_again_when_it_gets_worse():
    run = Run()
    assert run.beat(0.08)
    assert [run.beat(0.08) for _ in range(100)] == [None] * 100
    assert run.beat(0.11) is None
    assert "late by 0.13 s" in run.beat(0.13)
    assert run.beat(0.14) is None
    run.beats(WINDOW)
    assert "late by 80 ms (longest so far 0.14 s)" in run.beat(0.08)


def test_the_figure_of_the_last_minute_forgets_and_the_longest_ever_does_not():
    run = Run()
    run.beat(0.3)
    run.beats(30.0)
    run.beat(0.1)
    assert run.lateness.last_minute(run.now) == pytest.approx(0.3)
    run.beats(31.0)
    assert run.lateness.last_minute(run.now) == pytest.approx(0.1)
    run.beats(31.0)
    assert run.lateness.last_minute(run.now) == pytest.approx(0.0)
    assert run.lateness.longest == pytest.approx(0.3)


@given(st.lists(st.tuples(st.floats(0.0, 20.0), st.floats(0.0, 1.0)), min_size=1, max_size=60))
def test_the_figures_are_those_of_all_samples_and_warnings_are_few(steps):
    run, kept, warned = Run(), [], []
    for pause, late in steps:
        due = run.now + pause
        run.now = due + late
        kept.append((run.now, run.now - due))
        if run.lateness.sample(due, run.now):
            warned.append(kept[-1])
        recent = [length for when, length in kept if when >= run.now - WINDOW]
        assert run.lateness.last_minute(run.now) == max(recent)
        assert run.lateness.longest == max(length for _, length in kept)
    assert all(length > run.lateness.limit.max_jitter for _, length in warned)
    for (when, length), (later, longer) in pairwise(warned):
        assert later - when >= WINDOW or longer >= 1.5 * length
    assert warned or all(length <= run.lateness.limit.max_jitter for _, length in kept)


def test_a_silence_is_the_computers_fault_and_never_the_vehicles():
    run = Run()
    run.beat(0.31)
    assert (
        run.lateness.explain_silence(run.now, run.now + HEARTBEAT_INTERVAL)
        == "this computer was late by 0.31 s"
    )
    run.beats(30.0)
    assert (
        run.lateness.explain_silence(run.now, run.now + HEARTBEAT_INTERVAL)
        == "this computer was late to wake its guard"
    )


def test_a_guard_may_tell_of_a_silence_before_the_late_beat_has_gone():
    pulse = HeartbeatJitter(JitterMonitor(JitterLimit(SILENCE)))
    assert [pulse.on_heartbeat(when) for when in (5.0, 5.05, 5.1)] == [None, None, None]
    silent = "the host was silent for over 200 ms"
    assert pulse.explain(silent, 5.65) == f"{silent}, since this computer was late by 0.50 s"
    assert pulse.explain("the setpoint has expired (time-to-live 1 s)", 5.65).endswith("(time-to-live 1 s)")
    assert "late by 0.50 s" in pulse.on_heartbeat(5.65)
    assert pulse.explain(silent, 5.66) == f"{silent}, since this computer was late by 0.50 s"


def test_beats_that_were_not_to_be_are_not_late():
    pulse = HeartbeatJitter(lateness := JitterMonitor(JitterLimit(SILENCE)))
    pulse.on_heartbeat(5.0)
    pulse.pause()
    assert pulse.on_heartbeat(9.0) is None
    assert lateness.longest == 0.0
    assert "late by 0.45 s" in pulse.on_heartbeat(9.5)
