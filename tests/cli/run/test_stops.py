"""Every way to stop a host that flies: what the vehicle does, who is named, with which status it ends.

The vehicle is a fake of its own that outlives the host, and a second client watches it.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from witness import Witness

pytestmark = pytest.mark.process

#: A copter that hovers, and a coordinator that waits.
PROGRAM = """
resource Copter {
    Mavlink fc;
    init(string[] arg) { fc.arm(); fc.takeoff(3.0); write("flies\\n"); }
    portal stay(real seconds) { sleep(seconds); }
}
coordinator Pilot { init(string[] arg) { findCopter(arg[1]).stay(s2f(arg[2])); } }
"""
DEPLOYMENT = "//Copter:lead@alpha\n//Pilot:pilot@alpha?lead&{stay}\n"
DEVICES = """
silence: 2.0
agents:
  lead:
    devices:
      fc:
        {{driver: mavlink, endpoint: '{endpoint}', system: 1,
         waivers: [device_watchdog], rest_within: {within}}}
"""
CLIMB = ("--climb", "6", "--acceleration", "10")
#: Three metres at this speed take some seconds.
SLOW = ("--land", "0.5", "--descend", "0.5")
SLOWEST = ("--land", "0.25", "--descend", "0.25")
BRISK = ("--land", "6", "--descend", "6")


class Flight:
    """A copter in the air under one host."""

    def __init__(self, lfield, environment, *, land=BRISK, within=60.0, stay="1000", options=()):
        self._lfield, self._environment = lfield, environment
        listen = ("--listen", "udp:127.0.0.1:0", "--until-stdin-closes")
        self.fake = lfield.start("sim", "mavlink", *listen, *CLIMB, *land, stdin=True, env=environment)
        endpoint = self.fake.wait_for(r"^ready (\S+)")[1]
        devices = DEVICES.format(endpoint=endpoint, within=within)
        deployment = lfield.mission(PROGRAM, DEPLOYMENT.format(stay=stay), devices)
        self.words = ("--deploy", deployment, *lfield.maps(["alpha"]))
        self.host = lfield.start("up", *self.words, "--host", "alpha", *options, env=environment)
        self.host.wait_for("flies")
        self.witness = Witness(endpoint)
        self.witness.until(lambda seen: seen.height > 2.0 and seen.armed)

    @property
    def guard(self) -> int:
        """The process of its guard."""
        for pid in self._lfield.left():
            if b"lfield.guard.process" in Path(f"/proc/{pid}/cmdline").read_bytes():
                return pid
        raise AssertionError("there is no guard")

    def fault(self, *settings: str) -> None:
        told = self._lfield("sim", "fault", "mavlink", *settings, env=self._environment)
        assert self._lfield.status(told) == 0, told.said

    def is_down(self) -> None:
        """It stands on the ground now; the word that its motors are off may be a heartbeat late."""
        assert self.witness.height < 0.3
        self.landed(3.0)

    def landed(self, bound: float = 60.0) -> None:
        """Wait until the vehicle says that it is down, its motors off."""
        self.witness.until(lambda seen: not seen.armed and seen.height < 0.3, bound)


@pytest.fixture
def flight(alone, lfield):
    made: list[Flight] = []

    def begin(**options) -> Flight:
        made.append(Flight(lfield, alone, **options))
        return made[-1]

    yield begin
    for flown in made:
        flown.witness.close()
    lfield.end()


@pytest.mark.parametrize("before", [0.0, 0.05, 0.15])
def test_a_guard_killed_just_before_its_host_is_stopped_is_started_again_and_lands(flight, before):
    flown = flight()
    os.kill(flown.guard, signal.SIGKILL)
    time.sleep(before)
    flown.host.signal(signal.SIGTERM)
    assert flown.host.wait() == 0, flown.host.said
    assert "lead.fc: is in its safe state 'land': its guard died and was started again" in flown.host.said
    flown.is_down()


def test_a_guard_that_hangs_when_its_host_is_stopped_is_replaced_and_lands(flight):
    flown = flight()
    os.kill(flown.guard, signal.SIGSTOP)
    flown.host.signal(signal.SIGTERM)
    assert flown.host.wait() == 0, flown.host.said
    assert "the guard of lead.fc hangs" in flown.host.said
    flown.is_down()


@pytest.mark.parametrize("how", ["SIGTERM", "SIGINT", "SIGHUP", "until done"])
def test_a_vehicle_that_fell_silent_is_named_with_what_was_last_known_and_the_status_says_it(flight, how):
    done = how == "until done"
    flown = flight(within=2.0, stay="2" if done else "1000", options=("--until-done",))
    flown.fault("silence=true")
    if not done:
        flown.host.signal(signal.Signals[how])
    assert flown.host.wait() == 3, flown.host.said
    (line,) = [line for line in flown.host.err if "NOT SAFE" in line]
    assert line.startswith("lead.fc: NOT SAFE: its safe state was not seen; last heard ")
    assert "armed yes" in line


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_the_host_stays_and_answers_until_its_vehicle_is_down(lfield, alone, flight, how):
    flown = flight(land=SLOWEST)
    flown.host.signal(how)
    flown.witness.until(lambda seen: seen.mode == "LAND")
    answered, shown = 0, ""
    while flown.witness.height > 1.0:
        asked = lfield("ps", *flown.words, env=alone)
        assert lfield.status(asked) == 0, asked.said
        answered, shown = answered + 1, shown + asked.said
    assert answered >= 3
    assert "safe: " in shown
    assert "m up, sinking at 0." in shown
    assert flown.host.popen.poll() is None
    assert flown.host.wait() == 0, flown.host.said
    flown.is_down()
    assert [mode for _, mode in flown.witness.modes][-1] == "LAND"
    assert "lead.fc: is at rest" in flown.host.said


def test_a_second_word_in_a_hurry_is_the_first_and_a_later_one_ends_the_wait(flight):
    flown = flight(land=("--land", "0.1", "--descend", "0.1"))
    for _ in range(3):
        flown.host.signal(signal.SIGINT)
        time.sleep(0.1)
    flown.host.wait_for("waiting for the devices to come to rest; a second Ctrl-C or SIGTERM")
    flown.host.wait_for("lead.fc: .* up")
    assert flown.host.popen.poll() is None
    flown.host.signal(signal.SIGINT)
    assert flown.host.wait() == 3, flown.host.said
    (line,) = [line for line in flown.host.err if "NOT SAFE" in line]
    assert "lead.fc: NOT SAFE: it is in its safe state and not at rest: " in line
    assert flown.witness.mode == "LAND"


def test_a_guard_does_not_end_by_signals_while_its_host_lives(flight):
    flown = flight(land=SLOW)
    guard = flown.guard
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        os.kill(guard, number)
        flown.host.wait_for(f"{number.name} does not end it: it ends with its host")
    assert flown.guard == guard
    assert flown.witness.mode == "GUIDED"
    # A service manager tells the whole group at once.
    flown.host.signal(signal.SIGTERM)
    os.kill(guard, signal.SIGTERM)
    assert flown.host.wait() == 0, flown.host.said
    flown.is_down()


def test_a_killed_host_leaves_its_guard_until_the_safe_state_is_confirmed(lfield, flight):
    flown = flight()
    guard = flown.guard
    flown.host.signal(signal.SIGKILL)
    os.kill(guard, signal.SIGTERM)
    flown.landed()
    end = time.monotonic() + 30
    while guard in lfield.left() and time.monotonic() < end:
        time.sleep(0.05)
    assert guard not in lfield.left()
    flown.host.popen.wait()
    flown.host.wait_for("lead.fc: is in its safe state: ")
