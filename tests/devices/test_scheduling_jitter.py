"""Scheduling delays: the limit, the figures and the warnings for given times of heartbeats."""

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


@pytest.mark.parametrize("prompt", [False, True], ids=["normal priority", "real-time priority"])
@pytest.mark.parametrize(
    ("silence", "late", "accepted"),
    [
        (0.1, 0.0, True),
        (0.1, 0.02, True),  # one delay of a healthy small computer
        (0.1, 0.05, False),
        (0.1, 0.12, False),
        (0.2, 0.05, True),
        (0.2, 0.12, False),
        (2.0, 0.9, True),
        (2.0, 1.9, False),
        (10.0, 9.96, False),
    ],
)
def test_maximum_delay_by_silence_and_priority(silence, late, accepted, prompt):
    assert (late <= JitterLimit(silence, prompt).max_jitter) is accepted


@given(st.floats(0.0, 20.0), st.booleans())
def test_shortest_silence_is_sufficient_and_minimal(late, prompt):
    silence = JitterLimit(SILENCE, prompt).shortest_silence(late)
    assert silence >= 0.1
    assert late <= JitterLimit(silence, prompt).max_jitter + 1e-6
    assert silence == 0.1 or late > JitterLimit(silence - 0.1, prompt).max_jitter - 1e-6


def test_report_and_remedy_name_the_shortest_silence():
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


def test_real_time_priority_shortens_the_silence_and_the_remedy():
    limit = JitterLimit(0.2, is_realtime=True)
    assert limit.shortest_silence(0.12) == 0.3
    assert limit.shortest_silence(0.09) == 0.2 < JitterLimit(0.2).shortest_silence(0.09)
    assert limit.remedy(0.12) == (
        "reduce the load of this computer or write 'silence: 0.3' "
        "if the vehicles may move for so long without their host"
    )


def test_report_suggests_no_silence_above_the_maximum():
    assert JitterLimit(10.0).report(6.0).endswith("up to 6.00 s late, and no silence is long enough")
    assert JitterLimit(10.0, is_realtime=True).remedy(7.0) == "reduce the load of this computer"


# --- monitor ------------------------------------------------------------------------------------


class Run:
    """Heartbeats with given delays, on a clock of the test."""

    def __init__(self, silence=SILENCE):
        self.now = 1000.0
        self.monitor = JitterMonitor(JitterLimit(silence))

    def beat(self, late=0.0):
        due = self.now + HEARTBEAT_INTERVAL
        self.now = due + late
        return self.monitor.sample(due, self.now)

    def beats(self, seconds):
        return [warning for _ in range(round(seconds / HEARTBEAT_INTERVAL)) if (warning := self.beat())]


def test_heartbeats_on_time_give_no_warning():
    run = Run()
    assert run.beats(100.0) == []
    assert run.monitor.longest < 1e-6
    assert run.monitor.last_minute(run.now) < 1e-6


def test_early_heartbeat_has_no_delay():
    monitor = JitterMonitor(JitterLimit(SILENCE))
    assert monitor.sample(5.0, 4.9) is None
    assert monitor.longest == 0.0


def test_delay_near_the_limit_gives_a_warning():
    run = Run()
    assert run.beat(0.07) is None
    assert run.beat(0.08) == (
        "heartbeats to the guards late by 80 ms (longest so far 80 ms): this computer is overloaded; reduce "
        "its load, since guards make their devices safe at 0.15 s"
    )


def test_warning_is_repeated_each_minute_or_for_a_longer_delay():
    run = Run()
    assert run.beat(0.08)
    assert [run.beat(0.08) for _ in range(100)] == [None] * 100
    assert run.beat(0.11) is None
    assert "late by 0.13 s" in run.beat(0.13)
    assert run.beat(0.14) is None
    run.beats(WINDOW)
    assert "late by 80 ms (longest so far 0.14 s)" in run.beat(0.08)


def test_figure_of_the_last_minute_expires_and_the_longest_is_kept():
    run = Run()
    run.beat(0.3)
    run.beats(30.0)
    run.beat(0.1)
    assert run.monitor.last_minute(run.now) == pytest.approx(0.3)
    run.beats(31.0)
    assert run.monitor.last_minute(run.now) == pytest.approx(0.1)
    run.beats(31.0)
    assert run.monitor.last_minute(run.now) == pytest.approx(0.0)
    assert run.monitor.longest == pytest.approx(0.3)


@given(st.lists(st.tuples(st.floats(0.0, 20.0), st.floats(0.0, 1.0)), min_size=1, max_size=60))
def test_figures_match_all_samples_and_warnings_are_limited(steps):
    run, samples, warned = Run(), [], []
    for pause, late in steps:
        due = run.now + pause
        run.now = due + late
        samples.append((run.now, run.now - due))
        if run.monitor.sample(due, run.now):
            warned.append(samples[-1])
        recent = [length for when, length in samples if when >= run.now - WINDOW]
        assert run.monitor.last_minute(run.now) == max(recent)
        assert run.monitor.longest == max(length for _, length in samples)
    assert all(length > run.monitor.limit.max_jitter for _, length in warned)
    for (when, length), (later, longer) in pairwise(warned):
        assert later - when >= WINDOW or longer >= 1.5 * length
    assert warned or all(length <= run.monitor.limit.max_jitter for _, length in samples)


def test_silence_is_explained_by_the_delay_of_the_computer():
    run = Run()
    run.beat(0.31)
    assert (
        run.monitor.explain_silence(run.now, run.now + HEARTBEAT_INTERVAL)
        == "this computer was late by 0.31 s"
    )
    run.beats(30.0)
    assert (
        run.monitor.explain_silence(run.now, run.now + HEARTBEAT_INTERVAL)
        == "this computer was late to wake its guard"
    )


def test_silence_reported_before_the_late_heartbeat_is_explained():
    jitter = HeartbeatJitter(JitterMonitor(JitterLimit(SILENCE)))
    assert [jitter.on_heartbeat(when) for when in (5.0, 5.05, 5.1)] == [None, None, None]
    silent = "the host was silent for over 200 ms"
    assert jitter.explain(silent, 5.65) == f"{silent}, since this computer was late by 0.50 s"
    assert jitter.explain("the setpoint has expired (time-to-live 1 s)", 5.65).endswith("(time-to-live 1 s)")
    assert "late by 0.50 s" in jitter.on_heartbeat(5.65)
    assert jitter.explain(silent, 5.66) == f"{silent}, since this computer was late by 0.50 s"


def test_paused_heartbeats_are_not_late():
    jitter = HeartbeatJitter(monitor := JitterMonitor(JitterLimit(SILENCE)))
    jitter.on_heartbeat(5.0)
    jitter.pause()
    assert jitter.on_heartbeat(9.0) is None
    assert monitor.longest == 0.0
    assert "late by 0.45 s" in jitter.on_heartbeat(9.5)
