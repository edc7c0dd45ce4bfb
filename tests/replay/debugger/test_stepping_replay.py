"""Executing statement by statement changes nothing: the digests are those of the recording."""

from __future__ import annotations

import pytest
from debugger_recordings import EXAMPLES

from lfield.replay.debugger.moment import Moment
from lfield.replay.debugger.targets import StatementTarget
from lfield.replay.debugger.team_timeline import TeamTimeline
from lfield.testing.recorded_run import record_mission


class Counter:
    """Counts the statements that a search passes."""

    stops = None

    def __init__(self) -> None:
        self.count = 0

    def start(self, moment: Moment) -> None:
        self.count = 0

    def is_met(self, moment: Moment) -> bool:
        self.count += moment.running is not None
        return False


@pytest.mark.parametrize("example", ["04-the-mission-survives", "10-client-server", "12-peer-to-peer"])
def test_a_replay_in_steps_equals_the_recording(example):
    recordings, mission = record_mission(EXAMPLES / example / "mission.dL", 5.0)
    for host in TeamTimeline(recordings, mission).hosts:
        counter = Counter()
        assert host.find(counter, (0, -1), (host.turns, 0)) is None
        assert counter.count > 0
        assert host.divergence is None


@pytest.mark.few(0)
def test_a_replay_in_steps_equals_the_recording_with_devices(first_flight):
    for host in first_flight.hosts:
        counter = Counter()
        assert host.find(counter, (0, -1), (host.turns, 0)) is None
        assert counter.count > 50
        assert host.divergence is None


@pytest.mark.few(0)
def test_forward_and_backward_pass_the_same_statements(first_flight):
    target = StatementTarget("pilot")
    backward = [first_flight.find(target, first_flight.end, backward=True)]
    for _ in range(20):
        backward.append(first_flight.find(target, backward[-1], backward=True))
    forward = [backward[-1]]
    while place := first_flight.find(target, forward[-1]):
        forward.append(place)
    assert forward == backward[::-1]


def test_a_position_has_the_same_state_from_either_direction(first_flight):
    place = first_flight.find(StatementTarget("pilot"), first_flight.end, backward=True)
    moment, _ = first_flight.moment_at(place)
    images = {name: bytes(agent.block.image()) for name, agent in moment.agents.items()}
    first_flight.moment_at(first_flight.start)
    again, _ = first_flight.moment_at(place)
    assert {name: bytes(agent.block.image()) for name, agent in again.agents.items()} == images
    assert again.line == moment.line
