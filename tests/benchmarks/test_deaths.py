"""Failures of processes: the verdict from a device's log, and one real failure of each kind."""

from __future__ import annotations

import io

import pytest
from deaths.deaths import Fleet, rows
from deaths.device_log import Change, DeviceLog, Verdict, judge
from deaths.devices import DEVICES
from deaths.trial import DEATHS, Outcome
from harness.checkout import Checkout
from harness.processes import Processes
from harness.table import print_figure
from rich.console import Console

BY_NAME = {device.name: device for device in DEVICES}
COPTER, SERVO = BY_NAME["ArduCopter"], BY_NAME["Dynamixel"]
FLYING = {"mode": "GUIDED", "armed": "yes", "airborne": "yes", "moving": "yes", "failsafe": "no"}
TURNING = {"torque": "yes", "goals": "90,0,0", "moving": "yes", "watchdog_bit": "no"}
LANDING = [Change(10.5, "mode", "LAND"), Change(12.0, "airborne", "no"), Change(12.1, "armed", "no")]


def test_copter_is_safe_when_landing_and_at_rest_when_disarmed():
    assert judge(COPTER, FLYING, LANDING, 10.0) == Verdict(0.5, pytest.approx(2.1))


def test_changes_before_the_failure_are_ignored():
    turned = [Change(9.9, "goals", "80,0,0"), Change(10.2, "moving", "no")]
    assert judge(SERVO, TURNING, turned, 10.0) == Verdict()


def test_device_in_its_safe_state_is_safe_at_once():
    assert judge(COPTER, {**FLYING, "mode": "LAND"}, LANDING[1:], 10.0) == Verdict(0.0, pytest.approx(2.1))


def test_servo_is_safe_with_another_goal():
    held = [Change(10.25, "goals", "55,0,0"), Change(10.5, "moving", "no")]
    assert judge(SERVO, TURNING, held, 10.0) == Verdict(0.25, 0.5)


def test_device_that_leaves_its_safe_state_is_not_safe():
    assert judge(COPTER, FLYING, [*LANDING[:1], Change(11.0, "mode", "GUIDED")], 10.0) == Verdict()
    again = [*LANDING[:1], Change(11.0, "mode", "GUIDED"), Change(13.0, "mode", "LAND")]
    assert judge(COPTER, FLYING, again, 10.0) == Verdict(3.0)


def test_device_that_moves_again_is_not_at_rest():
    held = [Change(10.25, "goals", "55,0,0"), Change(10.5, "moving", "no"), Change(11.0, "moving", "yes")]
    assert judge(SERVO, TURNING, held, 10.0) == Verdict(0.25)


@pytest.mark.parametrize(("at", "own"), [(10.5, True), (10.8, False)])
def test_own_watchdog_counts_first_when_both_appear_in_one_sample(at, own):
    failsafe = Change(at, "failsafe", "yes")
    assert judge(COPTER, FLYING, sorted([*LANDING, failsafe]), 10.0).own is own


def test_log_is_read_as_it_grows(tmp_path):
    path = tmp_path / "device.log"
    path.write_text("1.5 1 mode=LAND\n2.5 1 arm")
    log = DeviceLog(path)
    assert (log.mark_start(), log.changes) == ({"mode": "LAND"}, [])
    with path.open("a") as file:
        file.write("ed=no\n")
    log.read()
    assert log.changes == [Change(2.5, "armed", "no")]


def test_failed_trials_are_reported_and_counted():
    good = Outcome("PX4", "host SIGKILL", "move", Verdict(0.1, 2.0, own=True))
    bad = Outcome("PX4", "host SIGKILL", "setpoints", why="not safe within 15 s", starts=2)
    safe, rest, failed, again = rows({"quiet": [good, good, bad], "busy": []})
    assert (safe.case, safe.measured, safe.samples) == (
        "PX4, host SIGKILL", "quiet: safe 2/3, own 2", [0.1, 0.1],
    )  # fmt: skip
    assert (rest.case, rest.measured, rest.samples) == ("", "quiet: at rest 2/3", [2.0, 2.0])
    assert failed.error == "1 of 3 trials failed: setpoints: not safe within 15 s"
    assert again.samples == [1]
    out = Console(file=io.StringIO(), width=160)
    print_figure(out, "deaths", "Deaths", [safe, rest, failed], ())
    assert "PX4, host SIGKILL quiet: 1 of 3 trials failed" in out.file.getvalue()


@pytest.mark.few(0)
@pytest.mark.process
@pytest.mark.timeout(400)
def test_servo_stops_after_failures_of_host_and_guard():
    """Two of the failures; `make bench ONLY=deaths` runs all."""
    with Processes() as processes:
        # A bound of silence that a busy computer can keep.
        fleet = Fleet(Checkout.own(), processes, [SERVO], 2, [0.9])
        outcomes = next(fleet.round(len(DEATHS) - 1, 0.9))
    assert [(outcome.death, outcome.why) for outcome in outcomes] == [
        ("both SIGSTOP", ""), ("host SIGKILL", ""),
    ]  # fmt: skip
    assert outcomes[0].verdict.own
