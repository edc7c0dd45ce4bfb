"""Every way to stop a host in flight: the vehicle's behaviour, the named devices, the exit status. The
vehicle is a separate fake that outlives the host, and a second client observes it.
"""

from __future__ import annotations

import os
import signal
import time

import pytest
from copter_flight import SLOW, SLOWEST, signal_at_once

pytestmark = pytest.mark.process


@pytest.mark.few(0)
@pytest.mark.parametrize("before", [0.0, 0.05, 0.15])
def test_a_guard_killed_just_before_the_stop_is_restarted_and_lands(flight, before):
    flown = flight()
    os.kill(flown.guard, signal.SIGKILL)
    time.sleep(before)
    flown.host.signal(signal.SIGTERM)
    assert flown.host.wait() == 0, flown.host.said
    assert "lead.fc in safe state 'land': its guard died and was restarted" in flown.host.said
    flown.is_down()


@pytest.mark.few(0)
def test_a_guard_that_hangs_at_the_stop_is_replaced_and_lands(flight):
    flown = flight()
    os.kill(flown.guard, signal.SIGSTOP)
    flown.host.signal(signal.SIGTERM)
    assert flown.host.wait() == 0, flown.host.said
    assert "guard of lead.fc unresponsive" in flown.host.said
    flown.is_down()


@pytest.mark.few(0)
@pytest.mark.parametrize("how", ["SIGTERM", "until done"])
def test_a_silent_vehicle_is_named_with_its_last_state_and_sets_the_status(flight, how):
    done = how == "until done"
    flown = flight(within=2.0, stay="2" if done else "1000", options=("--until-done",))
    flown.fault("silence=true")
    if not done:
        flown.host.signal(signal.Signals[how])
    assert flown.host.wait() == 3, flown.host.said
    (line,) = [line for line in flown.host.err if "NOT SAFE" in line]
    assert line.startswith("lead.fc NOT SAFE: its safe state was not confirmed; last contact ")
    assert "armed yes" in line


@pytest.mark.few(0)
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGHUP])
def test_a_host_stays_and_answers_until_its_vehicle_is_down(alone, flight, here, monkeypatch, how):
    flown = flight(land=SLOWEST)
    for name, value in alone.items():
        monkeypatch.setenv(name, value)
    flown.host.signal(how)
    # The copter was above 2 m, so below 1.8 m it descends; it lands in seven seconds.
    # This is too short for the start of a process on a busy computer.
    flown.witness.until(lambda seen: seen.mode == "LAND" and seen.height < 1.8)
    result = here("ps", *flown.command, status=0)
    output = "\n".join(result.out)
    assert "safe: " in output
    assert "m up, sinking at 0." in output
    assert flown.host.wait() == 0, flown.host.said
    flown.is_down()
    assert [mode for _, mode in flown.witness.modes][-1] == "LAND"
    assert "lead.fc at rest" in flown.host.said


@pytest.mark.few(0)
def test_a_second_signal_at_once_is_ignored_and_a_later_one_ends_the_wait(flight):
    flown = flight(land=("--land", "0.1", "--descend", "0.1"))
    signal_at_once(flown.host, signal.SIGINT, signal.SIGTERM)
    flown.host.wait_for("waiting for its devices to come to rest; a second Ctrl-C or SIGTERM")
    flown.host.wait_for("lead.fc still moving: .* up")
    assert flown.host.popen.poll() is None
    flown.host.signal(signal.SIGINT)
    assert flown.host.wait() == 3, flown.host.said
    (line,) = [line for line in flown.host.err if "NOT SAFE" in line]
    assert "lead.fc NOT SAFE: it is in its safe state and not at rest: " in line
    flown.witness.until(lambda seen: seen.mode == "LAND")


@pytest.mark.few(0)
def test_a_guard_ignores_signals_while_its_host_lives(flight):
    flown = flight(land=SLOW)
    guard = flown.guard
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        os.kill(guard, number)
        flown.host.wait_for(f"{number.name} ignored: the guard ends with its host")
    assert flown.guard == guard
    assert flown.witness.mode == "GUIDED"
    # A service manager signals all processes of the group.
    flown.host.signal(signal.SIGTERM)
    os.kill(guard, signal.SIGTERM)
    assert flown.host.wait() == 0, flown.host.said
    flown.is_down()


@pytest.mark.few(0)
def test_a_killed_host_leaves_its_guard_until_the_vehicle_is_down(lfield, flight):
    flown = flight()
    guard = flown.guard
    flown.host.signal(signal.SIGKILL)
    os.kill(guard, signal.SIGTERM)
    flown.landed()
    end = time.monotonic() + 60
    while guard in lfield.left() and time.monotonic() < end:
        time.sleep(0.05)
    assert guard not in lfield.left()
    flown.host.popen.wait()
    flown.host.wait_for("lead.fc in safe state 'land': the host is gone")


@pytest.mark.few(0)
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
def test_no_failsafe_takes_over_the_landing_of_a_dead_or_hanging_host(flight, flavour, number):
    flown = flight(land=("--flavour", flavour, *SLOWEST))
    flown.host.signal(number)
    flown.landed()
    flight_modes = [mode for height, mode in flown.witness.modes if height > 0.5]
    assert flight_modes.count(flight_modes[-1]) == 1, f"its landing was taken over: {flown.witness.modes}"


@pytest.mark.few(0)
def test_a_vehicle_under_pilot_control_is_left_alone_and_named(flight):
    flown = flight(within=2.0)
    flown.witness.take_over("LOITER")
    flown.host.signal(signal.SIGTERM)
    assert flown.host.wait() == 3, flown.host.said
    (line,) = [line for line in flown.host.err if "NOT SAFE" in line]
    assert "flown by a pilot in LOITER, " in line
    # The position is no evidence: without a transmitter an ArduCopter descends in LOITER.
    assert flown.witness.mode == "LOITER"
