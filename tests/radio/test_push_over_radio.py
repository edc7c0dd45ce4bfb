"""Pushes over a radio with packet loss and frequent outages; the desk or a service is killed."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from emulator.cells import Cell, Link
from emulator.radio import Radio
from emulator.tun import missing
from radio_fleet import DESK, HOSTS, RadioFleet, result_of

pytestmark = [pytest.mark.skipif(bool(why := missing()), reason=why), pytest.mark.process]


@contextmanager
def repeated_outages(radio: Radio, interval: float, duration: float) -> Iterator[None]:
    """Cut the radio of the desk for `duration` seconds, every `interval` seconds."""
    ended = threading.Event()

    def work() -> None:
        while not ended.wait(interval):
            radio.cut(duration, DESK)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        radio.mend()


@pytest.mark.few(0)
def test_push_completes_despite_outages_and_a_killed_desk(tmp_path: Path) -> None:
    with Radio(*HOSTS, DESK) as radio:
        fleet = RadioFleet(radio, tmp_path)
        fleet.up()
        radio.set(Cell(Link(delay=0.02, loss=0.2)))
        mission = fleet.mission(lines=150)
        with repeated_outages(radio, interval=2.0, duration=1.0):
            desk = fleet.desk("push", mission, "--json")
            time.sleep(3.0)
            desk.kill()
            desk.wait()
            completed_push = result_of(fleet.desk("push", mission, "--json"), 120)
        assert completed_push["outcome"] == "activated"
        # The second desk did not send the data again that the robots received from the killed desk.
        assert all(sent["bytes"] < completed_push["size"] for sent in completed_push["sent"].values())

        radio.set(Cell())
        fleet.mission(lines=150, last="changed")
        changed = result_of(fleet.desk("push", mission, "--json"), 60)
        assert changed["outcome"] == "activated"
        assert all(0 < sent["bytes"] < completed_push["size"] / 5 for sent in changed["sent"].values())
        states = result_of(fleet.desk("status", "--json"), 60)
        assert {state["bundle"] for state in states.values()} == {changed["bundle"]}


@pytest.mark.few(0)
@pytest.mark.parametrize("seconds", [0.3, 0.6, 0.9, 1.2, 1.6, 2.0])
@pytest.mark.parametrize("killed", [DESK, "alpha"])
def test_killed_desk_or_service_leaves_one_active_bundle(tmp_path: Path, killed: str, seconds: float) -> None:
    with Radio(*HOSTS, DESK) as radio:
        fleet = RadioFleet(radio, tmp_path)
        fleet.up()
        radio.set(Cell(Link(delay=0.1, loss=0.05)))
        mission = fleet.mission(lines=40)
        desk = fleet.desk("push", mission)
        time.sleep(seconds)
        killed_process = desk if killed == DESK else fleet.services[killed]
        killed_process.kill()
        killed_process.wait()
        radio.set(Cell())
        if killed != DESK:
            fleet.up(killed)
        desk.communicate(timeout=120)
        end = time.monotonic() + 90
        while True:
            states = result_of(fleet.desk("status", "--json"), 60)
            ballots = [state["ballot"] for state in states.values()]
            if not any(ballot is not None and ballot["outcome"] == "open" for ballot in ballots):
                break
            assert time.monotonic() < end
            time.sleep(0.5)
        assert len({state["bundle"] for state in states.values()}) == 1
        assert result_of(fleet.desk("push", mission, "--json"), 60)["outcome"] == "activated"
