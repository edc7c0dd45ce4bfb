"""The monitors on recordings of real autopilots: no false alarms in normal flights, faults found in time."""

from __future__ import annotations

import pytest
from recorded_flight import Watched

PATROL = ((40.0, 0.0, -8.0), (0.0, 0.0, -8.0))


def watch(name, *goals, **given):
    watched = Watched(name, *goals)
    for _ in watched.play(**given):
        pass
    return watched


NORMAL = [
    ("ap-copter.loss20", PATROL),
    ("ap-copter.delay500", PATROL),
    ("ap-copter.ops-0", ((0.0, 0.0, -6.0),)),
    ("ap-copter.deaths-33", ((200.0, 0.0, -8.0),)),
    ("px4-copter.deaths-6", ((200.0, 0.0, -8.0),)),
]
#: Flown by scripts: the commanded heights are unknown, but no fault occurred.
SCRIPTED = [
    "ap-copter.c-speed",
    "ap-copter.d-velocity",
    "ap-copter.e-gcs-loss",
    "ap-copter.f-fence-breach",
    "ap-copter.f-fence-landing",
    "ap-copter.g-mission",
    "ap-copter.i-heights",
    "ap-copter.i-home-moves",
    "px4-copter.c-speed",
    "px4-copter.d-velocity",
    "px4-copter.e-gcs-loss",
    "px4-copter.f-fence-landing",
    "px4-copter.g-mission",
    "px4-copter.i-heights",
    "px4-copter.i-home-moves",
]


@pytest.mark.parametrize(("name", "goals"), NORMAL)
def test_normal_recorded_flight_has_no_findings(name, goals):
    watched = watch(name, *goals)
    assert watched.found == []
    assert watched.reports.lock_outs == []


@pytest.mark.few(0)
@pytest.mark.parametrize("name", SCRIPTED)
def test_scripted_recorded_flight_has_no_findings(name):
    watched = watch(name)
    assert watched.found == []
    assert watched.reports.lock_outs == []


def faulty(name, note, *, within=60.0, goals=PATROL):
    """The findings from the note of a fault on, as seconds and text; and the watched vehicle."""
    watched, begins = Watched(name, *goals), None
    for event in watched.play():
        if note in event.note and begins is None:
            begins = event.at
            watched.found.clear()
            watched.monitor.release()
        if begins is not None and event.at > begins + within:
            break
    return [(at - begins, text) for at, text in watched.found], watched


def test_recorded_weak_motor_is_a_fall_before_the_impact():
    """The impact was 4.2 s after the fault; "Potential Thrust Loss" was sent after 3.1 s."""
    found, watched = faulty("ap-copter.gauntlet-b", "set SIM_ENGINE_FAIL = 1", within=10.0)
    (falls_at, falls), (crashes_at, crashes) = found
    assert falls.startswith("it falls: ")
    assert falls_at < 2.0
    assert crashes == "it hit the ground at 2.7 m/s"
    assert 4.0 < crashes_at < 5.0
    assert watched.reports.lock_outs == [f"it crashed: {crashes}"]
    assert watched.monitor.crashed == crashes


def test_recorded_disarm_in_flight_is_a_crash_before_the_impact():
    """The impact was 1.3 s later, at 11 m/s; 0.1 s after that the vehicle could be armed."""
    found, watched = faulty(
        "ap-copter.gauntlet-b", "forced disarm by a second station in the air", within=1.3
    )
    ((at, text),) = found
    assert text.startswith("its motors went off in the air, ")
    assert at < 0.8
    assert watched.reports.lock_outs[-1] == f"it crashed: {text}"


def test_recorded_flight_termination_is_a_fall():
    watched = watch("px4-copter.g-commands-armed")
    assert [text.split(" ")[1] for _, text in watched.found][:1] in (["sinks"], ["falls:"], ["is"])


def test_recorded_gps_loss_is_found_within_a_second():
    """The mode and the sensor health of the vehicle did not change for another 7 s."""
    watched, fix_lost = Watched("ap-copter.gauntlet-a", *PATROL), None
    for event in watched.play():
        message = event.message
        is_fix_report = (
            message is not None and message.get_type() == "GPS_RAW_INT" and watched.vehicle.state.armed
        )
        if is_fix_report and message.fix_type < 3 and fix_lost is None:
            fix_lost = event.at
        if fix_lost is not None and watched.monitor.lost_position:
            break
    assert event.at - fix_lost < 1.0
    assert watched.vehicle.state.mode == "GUIDED"
    assert "fix is lost" in watched.monitor.lost_position


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("name", "begins", "ends"),
    [
        ("ap-copter.gauntlet-a", "base: begins", "GPS off for 25 s: begins"),
        ("ap-copter.gauntlet-a", "all compasses fail", "fence of 15 m switched on"),
        ("ap-copter.gauntlet-a", "battery low", "battery low (10 V), BATT_FS_LOW_ACT 1 land: ends"),
        ("ap-copter.gauntlet-b", "wind 9 m/s from the north: begins", "motor 1 at 60 %: begins"),
    ],
)
def test_recorded_wind_and_sensor_faults_are_no_falls(name, begins, ends):
    watched, on = Watched(name, *PATROL), False
    for event in watched.play():
        if begins in event.note:
            on = True
            watched.found.clear()
        if on and ends in event.note:
            break
    assert on
    assert watched.found == []
    assert watched.reports.lock_outs == []
