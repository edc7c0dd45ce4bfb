"""The order of several recordings: no coordinator arrives before its departure, with any clocks."""

from __future__ import annotations

from itertools import pairwise

import pytest
from debugger_recordings import EXAMPLES
from msgspec.structs import replace

from lfield.errors import RecordingError
from lfield.host.recording.host_records import StartRecord, decode_frame, encode_frame
from lfield.replay.debugger.team_timeline import TeamTimeline
from lfield.replay.host_recording import HostRecording
from lfield.replay.team_order import TeamOrder
from lfield.testing.recorded_run import record_mission

YEARS = 3.2e8


def _with_clock(recording: HostRecording, rate: float, ahead: float) -> HostRecording:
    """The recording of a host whose clocks run at another rate, and are set to another time."""
    frames = []
    for frame in recording.frames:
        records = []
        for record in decode_frame(frame.data):
            changes = {"at": record.at * rate + ahead} if hasattr(record, "at") else {}
            if isinstance(record, StartRecord):
                changes["wall"] = record.wall + ahead
            records.append(replace(record, **changes))
        header = frame.header._replace(at=frame.header.at * rate + ahead)
        frames.append(encode_frame(records, header))
    return HostRecording(frames)


def _transits(team: TeamTimeline) -> list[float]:
    order = TeamOrder([host.recording for host in team.hosts])
    return [
        team.times[arrival.part][arrival.turn] - team.times[sent.part][sent.turn]
        for hop, sent in order.sends.items()
        for arrival in order.arrivals[hop]
    ]


@pytest.mark.few(0)
@pytest.mark.parametrize("rate", [0.95, 1.0, 1.05])
@pytest.mark.parametrize("ahead", [-5.0, 0.0, YEARS])
def test_hops_are_in_order_and_short(first_flight, rate, ahead):
    one, other = (host.recording for host in first_flight.hosts)
    transits = _transits(TeamTimeline([one, _with_clock(other, rate, ahead)], first_flight.mission))
    assert len(transits) == 11
    assert min(transits) > 0.0
    assert max(transits) < 5.0


@pytest.mark.few(0)
@pytest.mark.parametrize("ahead", [-YEARS, -0.001, 0.0, 0.001, YEARS])
def test_hops_in_one_direction_do_not_move_a_host(ahead):
    """A run of five seconds: the coordinator has migrated to the other host, and not returned."""
    (one, other), mission = record_mission(EXAMPLES / "01-first-flight" / "mission.dL", 5.0)
    team = TeamTimeline([one, _with_clock(other, 1.0, ahead)], mission)
    assert len(_transits(team)) == 1
    assert 0.0 < _transits(team)[0] < 0.1
    assert 4.5 < team.duration <= 5.0


def test_times_of_each_host_never_go_back(first_flight):
    one, other = (host.recording for host in first_flight.hosts)
    team = TeamTimeline([_with_clock(one, 1.05, YEARS), other], first_flight.mission)
    for times in team.times:
        assert all(a <= b for a, b in pairwise(times))
    assert min(times[0] for times in team.times) == 0.0


def test_a_single_host_has_an_order(first_flight):
    team = TeamTimeline([first_flight.hosts[1].recording], first_flight.mission)
    assert team.start[:2] == (0, 0)
    assert team.end.turn == team.hosts[0].turns


def test_a_recording_without_a_turn_is_refused(first_flight):
    with pytest.raises(RecordingError):
        TeamTimeline([], first_flight.mission)
