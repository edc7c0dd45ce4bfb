"""The lanes of the figure of poor radio, from the output lines of their processes, without a radio."""

from __future__ import annotations

import itertools
import time

import pytest
from emulator.radio import Count, Flow
from harness.processes import ChildError
from radio.radio_lanes import Lane, StopLane, collect, outages


class Printing:
    """A child that prints one of these lines at each poll."""

    def __init__(self, *lines):
        self._lines = iter(lines)

    def lines(self):
        return [line] if (line := next(self._lines, None)) else []


class Air:
    """A radio with given counts."""

    def __init__(self, *sizes):
        self._sizes = iter(sizes)

    def set(self, cell):
        """Accept any cell."""

    def reset(self):
        """Do nothing: the counts are fixed."""

    def counts(self):
        other = {Flow("h0", "h1", 6, 8181): Count(9, 9000)}
        return {Flow("desk", "h0", 6, 8181): Count(1, next(self._sizes))} | other

    def cut(self, seconds, robot):
        assert robot == "h1"
        return time.monotonic() + seconds


def test_first_sample_of_a_cell_is_dropped_and_lanes_have_equal_counts():
    quick = Lane(Air(), Printing("up", "hops = 9", *["hops = 1"] * 50), "hops")
    slow = Lane(Air(), Printing(*["linked"] * 10, "hops = 9", "hops = 2", "hops = 2"), "hops")
    assert collect([quick, slow], "20 %", 4) == [1.0, 1.0, 2.0, 2.0]


def test_failing_lane_states_its_reason():
    with pytest.raises(ChildError, match="no keys"):
        collect([Lane(Air(), Printing("error: no keys"), "hops")], "20 %", 1)


def test_bytes_of_a_stop_exclude_the_traffic_at_rest(monkeypatch):
    monkeypatch.setattr(time, "monotonic", itertools.count(1000.0, 2.0).__next__)
    lines = "lifted", "stopping", "stop = 0.5", "again: not reached", "lifting"
    lane = StopLane(Air(0, 100, 400), Printing(), "stop")
    for line in lines:
        lane.child = Printing(line)
        lane.read_output()
    # 100 bytes in 2 s at rest; 400 in the 4 s of the stop, of which 200 are the traffic at rest.
    assert (lane.idle, lane.sizes) == ([50.0], [200.0])
    assert lane.again == ["again: not reached"]


def test_outage_ends_with_the_first_sample_after_the_return(monkeypatch):
    now = [1000.0]
    lane = Lane(Air(), Printing(*["hops = 1"] * 3), "hops")

    def lines(child):
        now[0] += 0.004
        return ["hops = 1"]

    lane.child = type("Child", (), {"lines": lines})()
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    (delay,) = outages([lane], "h1", 0.05)
    assert delay == pytest.approx(0.002)
