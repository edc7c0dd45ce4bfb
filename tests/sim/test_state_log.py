"""The state log of fakes: every change once, with its time."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from lfield.errors import OutputFileError
from lfield.testing.driver_bench import running_fake
from lfield_sim.state_log import StateLog


def entries(path: Path) -> list[list[str]]:
    """The log lines without their times."""
    return [line.split()[1:] for line in path.read_text(encoding="utf-8").splitlines()]


def test_every_change_is_logged_once(tmp_path):
    path, now, facts = tmp_path / "log", iter([1.0, 3.5]), {"mode": "AUTO LAND", "armed": True}
    log = StateLog(str(path), {"3": lambda: facts}, lambda: next(now))
    log.write_changes()
    facts["armed"] = False
    log.write_changes()
    log.close()
    log.write_changes()
    assert path.read_text().splitlines() == [
        "1.000000 3 mode=AUTO_LAND",
        "1.000000 3 armed=yes",
        "3.500000 3 armed=no",
    ]


def test_without_a_file_the_state_is_not_read():
    def read_state():
        raise AssertionError

    StateLog("", {"1": read_state}).write_changes()


def test_unwritable_log_file_is_an_error(tmp_path):
    with pytest.raises(OutputFileError, match="cannot write"):
        StateLog(str(tmp_path / "no" / "log"), {})


@pytest.mark.process
@pytest.mark.parametrize(
    ("kind", "words", "facts"),
    [
        (
            "mavlink",
            ["--listen", "udp:127.0.0.1:0", "--vehicle", "7:copter:px4"],
            [["7", "mode=AUTO.LOITER"], ["7", "armed=no"], ["7", "airborne=no"], ["7", "failsafe=no"]],
        ),
        (
            "can",
            ["--device", "cia402:5", "--device", "odrive:3"],
            [["5", "state=SWITCH_ON_DISABLED"], ["5", "moving=no"], ["3", "state=IDLE"], ["3", "goal=0"]],
        ),
        (
            "dynamixel",
            ["--servo", "1:XM430-W350", "--servo", "2:XL430-W250"],
            [["1", "goals=2048,0,0"], ["1", "watchdog_bit=no"], ["2", "goals=2048,0"], ["2", "torque=no"]],
        ),
    ],
)
def test_fake_logs_its_initial_state(tmp_path, kind, words, facts):
    path, start = tmp_path / "log", time.monotonic()
    with running_fake(kind, *words, "--log", str(path)):
        end = time.monotonic() + 30.0
        while any(fact not in entries(path) for fact in facts):
            assert time.monotonic() < end, entries(path)
            time.sleep(0.01)
    times = [float(line.split()[0]) for line in path.read_text().splitlines()]
    assert times == sorted(times)
    assert start < times[0] <= times[-1] < time.monotonic()
