"""lfield on real autopilots: kit, examples, failed processes, limits, arming, bad link (`make test-sitl`)."""

from __future__ import annotations

import os
import signal
import time

import pytest
from sitl_missions import ARM, AWAY, HOP, OPEN, READY, REAL, ROOT, SPEED, TOUR
from sitl_relay import Relay

#: Repetitions of arming after opening, and of a mission over a poor link; the share of lost packets.
OPENINGS = int(os.environ.get("OPENINGS", "50"))
MISSIONS, LOSS = int(os.environ.get("MISSIONS", "20")), 0.2
#: Tolerance of a limit: the default of the option `limit_tolerance`.
TOLERANCE = 0.2
#: The failed process: the signal of the host or guard, and the seconds until the mode must be LAND.
FAILURES = {
    "guard": (signal.SIGKILL, 3.0),
    "host": (signal.SIGKILL, 3.0),
    "stopped host": (signal.SIGSTOP, 5.0),
    "both": (signal.SIGKILL, 12.0),
}
EXAMPLES = ("01-first-flight", "02-equivalent-lift", "03-mixed-team")


def test_set_up(field, figure):
    """Sets the vehicle up for the bindings of these tests. All other checks need this set-up."""
    mission = field.mission(OPEN, "//Vehicle:it@here\n//Nothing:nothing@here\n")
    host = field.up(mission, "--until-done")
    status = host.wait(READY)
    if status:
        assert "lfield setup" in host.output, host.last_lines
    field.lfield("setup", "--deploy", mission.deploy, "--yes").succeeds(60.0)
    figure("was set up already" if not status else "up refused a stock vehicle and named lfield setup")


def test_kit(field, figure):
    """The conformance checks of the driver pass."""
    simulator = field.vehicle
    settings = [
        f"system={simulator.system}",
        f"kind={field.kind.vehicle}",
        "waivers=[device_watchdog]",
        f"limits={{speed: {SPEED}, altitude: 30, radius: 100}}",
    ]
    arguments = [argument for setting in settings for argument in ("--set", setting)]
    kit = field.lfield(
        "kit", "mavlink", "--endpoint", simulator.endpoint, *arguments, "--silence", "1.0", "--yes"
    )
    status = kit.wait(600.0)
    figure(kit.output.splitlines()[-1] if kit.output else "no output")
    failed = "\n".join(line for line in kit.output.splitlines() if line.startswith("FAILED"))
    assert status == 0, f"{failed or f'the kit ended with status {status}'}\n{kit.last_lines}"


def test_limits(field, figure):
    """The vehicle does not exceed the speed limit of its binding in any motion."""
    kind = field.kind.vehicle
    mission = field.mission(TOUR[kind], f"//{kind.title()}:it@here\n//Tour:tour@here?it\n")
    start = time.monotonic()
    field.up(mission, "--until-done").succeeds(300.0)
    top = field.watcher.top_speed(start)
    figure(f"highest speed {top:.2f} m/s with a limit of {SPEED:g}")
    assert 0.5 * SPEED < top <= SPEED * (1.0 + TOLERANCE), field.watcher.history(start)


def test_arming_right_after_opening(field, figure):
    """Arming succeeds directly after the vehicle is opened."""
    mission = field.mission(ARM, "//Motors:it@here\n")
    done, failed = 0, []
    for _ in range(OPENINGS):
        host = field.up(mission)
        if host.prints("armed and disarmed", READY):
            done += 1
        else:
            failed.append(host.last_lines)
        host.end()
    figure(f"{done} of {OPENINGS}")
    assert done == OPENINGS, "\n\n".join(failed)


@pytest.mark.parametrize("failed_process", FAILURES)
def test_failed_process(field, figure, failed_process):
    """The vehicle lands after a process is killed or stopped: by the remaining process or by a failsafe."""
    if field.kind.vehicle != "copter":
        pytest.skip("only copters fly away in this check")
    mission = field.mission(AWAY, "//Copter:it@here\n")
    host = field.up(mission)
    watcher = field.watcher
    try:
        host.wait_for("on its way", READY + 60.0)
        watcher.until(lambda observed: observed.speed > 0.5, 20.0, "motion")
        number, bound = FAILURES[failed_process]
        failed_at = time.monotonic()
        guard = host.guard
        if failed_process in ("guard", "both"):
            os.kill(guard, signal.SIGKILL)
        if failed_process != "guard":
            os.kill(host.process.pid, number)
        delay = watcher.until(lambda observed: "LAND" in observed.mode, bound, "a landing")
        watcher.until(lambda observed: not observed.armed, 90.0, "disarming")
        figure(f"landing after {delay:.2f} s, motors off after {time.monotonic() - failed_at:.1f} s")
    finally:
        if host.process.poll() is None:
            os.kill(host.process.pid, signal.SIGCONT)
        host.end()


def test_missions_over_a_bad_link(field, figure):
    """A fifth of the packets is lost in each direction; no mission fails."""
    if field.kind.vehicle != "copter":
        pytest.skip("only copters fly over a bad link")
    done, failed = 0, []
    for number in range(MISSIONS):
        relay = Relay(field.vehicle.endpoint, LOSS, seed=number)
        try:
            mission = field.mission(HOP, "//Copter:it@here\n//Hop:hop@here?it\n", relay.endpoint)
            command = field.up(mission, "--until-done")
            if command.wait(300.0) == 0:
                done += 1
            else:
                failed.append(command.last_lines)
        finally:
            relay.close()
    figure(f"{done} of {MISSIONS} with {LOSS:.0%} loss")
    assert done == MISSIONS, "\n\n".join(failed)


@pytest.mark.parametrize("name", EXAMPLES)
def test_example(field, figure, name):
    """An unchanged example, bound to simulators by the devices files of the guide."""
    bindings = REAL / field.kind.name / f"{name}.devices.yaml"
    if not bindings.exists():
        pytest.skip(f"no example is bound to {field.kind.name}")
    if field.vehicle.endpoint not in bindings.read_text():
        pytest.skip(f"{bindings.relative_to(ROOT)} is for the ports that the guide names")
    deploy = ROOT / "examples" / name / "mission.dL"
    with field.rest_of_team(name):
        field.lfield("setup", "--deploy", deploy, "--devices", bindings, "--yes").succeeds(120.0)
        start = time.monotonic()
        arguments = ("up", "--deploy", deploy, "--devices", bindings, "--all", "--until-done")
        field.lfield(*arguments).succeeds(400.0)
        figure(f"{time.monotonic() - start:.0f} s")


def test_no_motor_is_left_armed(field):
    """The vehicle is disarmed after all checks."""
    field.watcher.until(lambda observed: not observed.armed, 90.0, "disarming")
