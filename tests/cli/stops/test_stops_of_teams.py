"""A flying team under `up --all`, and every way to end it: the vehicles' behaviour. The vehicles are separate
fakes that outlive all processes, each with a second client that observes it.
"""

from __future__ import annotations

import fcntl
import os
import signal
import termios
import threading
import time

import pytest
from copter_flight import BRISK, SLOW, copter, devices, landed, signal_at_once
from mavlink_observer import MavlinkObserver

pytestmark = pytest.mark.process

#: A copter on each of two hosts, and a coordinator that waits.
PROGRAM = """
resource Copter {
    Mavlink fc;
    init(string[] arg) { fc.arm(); fc.takeoff(3.0); }
    portal stay(real seconds) { sleep(seconds); }
}
coordinator Pilot { init(string[] arg) { findCopter(arg[1]).stay(1000.0); } }
"""
DEPLOYMENT = "//Copter:lead@alpha\n//Copter:wing@bravo\n//Pilot:pilot@alpha?wing\n"


class Team:
    """Two flying copters under `up --all`; `started` is for its process."""

    def __init__(self, lfield, environment, *, land=BRISK, **started):
        endpoints = {agent: copter(lfield, environment, land) for agent in ("lead", "wing")}
        file = lfield.mission(PROGRAM, DEPLOYMENT, devices(endpoints, 60.0))
        arguments = ("up", "--deploy", file, "--all", "--until-done")
        self.run = lfield.start(*arguments, env=environment, **started)
        self.witnesses = [MavlinkObserver(endpoint) for endpoint in endpoints.values()]
        for witness in self.witnesses:
            witness.until(lambda seen: seen.height > 2.0 and seen.armed)

    def have_landed(self) -> None:
        """Wait until both copters have landed on command with their motors off."""
        for witness in self.witnesses:
            landed(witness)
            assert [mode for _, mode in witness.modes][-1] == "LAND"

    def are_down(self) -> None:
        """Assert that both copters are on the ground."""
        for witness in self.witnesses:
            witness.catch_up()
            assert witness.height < 0.3
        self.have_landed()

    def land(self) -> None:
        """Wait until both copters have received the command to land."""
        for witness in self.witnesses:
            witness.until(lambda seen: seen.mode == "LAND")


@pytest.fixture
def team(alone, lfield):
    """`team(**options)`: two flying copters."""
    teams: list[Team] = []

    def begin(**options) -> Team:
        teams.append(Team(lfield, alone, **options))
        return teams[-1]

    yield begin
    for flown in teams:
        for witness in flown.witnesses:
            witness.close()
    lfield.end()


class Terminal:
    """A pseudo-terminal; its output is read and stored until it is closed."""

    def __init__(self) -> None:
        self._master, self.end = os.openpty()
        self.said = b""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        try:
            while some := os.read(self._master, 4096):
                self.said += some
        except OSError:
            return

    @property
    def options(self) -> dict[str, object]:
        """Options of a process that leads a session on this terminal."""

        def controlled() -> None:
            fcntl.ioctl(self.end, termios.TIOCSCTTY, 0)

        return {"stdout": self.end, "stderr": self.end, "preexec_fn": controlled}

    def close_user_end(self) -> None:
        """Close this process's copy of the user's end."""
        os.close(self.end)

    def press(self, keys: bytes) -> None:
        os.write(self._master, keys)

    def close(self) -> None:
        """Close the terminal, like a closed window."""
        master, self._master = self._master, -1
        # This wakes the reader, which releases the terminal.
        os.write(master, b"\n")
        os.close(master)


@pytest.mark.few(0)
def test_two_signals_at_once_count_as_one_and_land_the_team(team):
    _lands_before_it_ends(team, signal.SIGINT, signal.SIGTERM)


@pytest.mark.few(0)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_other_signals_land_the_team_too(team, number):
    _lands_before_it_ends(team, number)


def _lands_before_it_ends(team, *numbers: signal.Signals) -> None:
    flown = team(land=SLOW)
    signal_at_once(flown.run, *numbers)
    assert flown.run.wait() == 130, flown.run.said
    flown.are_down()


@pytest.mark.few(0)
def test_a_later_second_ctrl_c_ends_the_team_and_names_devices_in_the_air(team):
    flown = team(land=("--land", "0.2", "--descend", "0.2"))
    flown.run.signal(signal.SIGINT)
    flown.land()
    for host in ("alpha", "bravo"):
        flown.run.wait_for(
            rf"{host} \| {host} stopping: waiting for its devices to come to rest; a second Ctrl-C or SIGTERM"
        )
    flown.run.signal(signal.SIGINT)
    assert flown.run.wait() == 3, flown.run.said
    named = [line for line in flown.run.err if "NOT SAFE" in line and " | " in line]
    assert len(named) == 2
    for line, device in zip(sorted(named), ("lead.fc", "wing.fc"), strict=True):
        assert f"{device} NOT SAFE: it is in its safe state and not at rest: " in line
    # The autopilots land by their own failsafe.
    flown.have_landed()


@pytest.mark.few(0)
def test_the_team_of_a_killed_parent_lands_and_ends(lfield, team):
    flown = team(land=SLOW)
    hosts = set(lfield.left())
    flown.run.signal(signal.SIGKILL)
    flown.have_landed()
    flown.run.popen.wait()
    _ended(lfield, hosts)


@pytest.mark.few(0)
def test_a_team_on_a_closed_terminal_lands(lfield, team):
    terminal = Terminal()
    flown = team(land=SLOW, **terminal.options)
    terminal.close_user_end()
    terminal.close()
    assert flown.run.wait() == 130
    flown.are_down()


def test_ctrl_c_on_a_terminal_ends_the_whole_team(team):
    terminal = Terminal()
    flown = team(**terminal.options)
    terminal.close_user_end()
    terminal.press(b"\x03")
    assert flown.run.wait() == 130, terminal.said
    flown.are_down()
    assert b"Traceback" not in terminal.said
    terminal.close()


@pytest.mark.few(0)
def test_a_host_on_a_closed_terminal_lands(flight):
    terminal = Terminal()
    flown = flight(land=SLOW, **terminal.options)
    terminal.close_user_end()
    terminal.close()
    assert flown.host.wait() == 0
    flown.is_down()


def _ended(lfield, processes: set[int]) -> None:
    """Wait until all processes except those of the fakes have ended."""
    end = time.monotonic() + 60
    fakes = {process.pid for process in lfield.started}
    while left := (processes & set(lfield.left())) - fakes:
        assert time.monotonic() < end, left
        time.sleep(0.05)
