"""A recorded team at a time: poses, hops, log, stacks; moves in both directions; the newest command
counts.
"""

from __future__ import annotations

import json

import pytest

from lfield.replay.recording_files import TeamRecording
from lfield.replay.web.replay_player import ReplayPlayer, Superseded, command_of
from lfield.replay.web.replay_session import ReplaySession


class Time:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class Shown:
    """A session without its thread."""

    def __init__(self, recording: TeamRecording) -> None:
        self.time = Time()
        self.session = ReplaySession("team", recording, self.time)
        self.settle()

    def settle(self) -> None:
        while self.session.has_work:
            self.session.advance()

    def go(self, go: str, **more: object) -> dict:
        assert self.session.request({"go": go, **more}) == ""
        self.settle()
        return self.position

    @property
    def position(self) -> dict:
        return json.loads(self.session.published().position)

    @property
    def state(self):
        return self.session.snapshot()


@pytest.fixture
def shown(recording: TeamRecording) -> Shown:
    return Shown(recording)


def test_the_slider_shows_poses_and_tracks_of_the_guards(shown):
    assert shown.go("time", seconds=2.5)["problems"] == []
    one = shown.state.vehicles["one"]
    assert (one.position.north, one.fresh, one.latched) == (4.0, True, False)
    (track,) = shown.position["tracks"]
    assert track["agent"] == "one"
    assert [place[0] for place, _ in track["points"]] == [0.0, 4.0]
    shown.go("time", seconds=1.5)
    assert shown.state.vehicles["one"].position.north == 0.0


def test_a_latch_and_a_note_of_a_guard_are_shown(shown):
    shown.go("time", seconds=5.0)
    (device,) = shown.state.vehicles["one"].devices
    assert (device.latched, device.confirmed) == ("the battery is empty", True)
    assert "one.fc: battery at 3 %" in [line.text for line in shown.state.log]
    shown.go("time", seconds=3.5)
    assert not shown.state.vehicles["one"].latched
    assert "one.fc: battery at 3 %" not in [line.text for line in shown.state.log]


def test_a_log_has_another_epoch_after_a_move_back(shown):
    shown.go("time", seconds=5.0)
    later = shown.session.published().epoch
    shown.go("time", seconds=5.5)
    assert shown.session.published().epoch == later
    shown.go("time", seconds=1.0)
    assert shown.session.published().epoch != later


def test_hops_statements_and_variables_are_shown_in_both_directions(shown):
    position = shown.go("hop")
    at = position["seconds"]
    boss = shown.state.coordinators["boss"]
    assert (boss.host, [(hop.source, hop.target) for hop in boss.trail]) == ("bravo", [("alpha", "bravo")])
    (program,) = position["coordinators"]
    assert (program["agent"], program["host"]) == ("boss", "bravo")
    frame = program["frames"][0]
    assert 'findPost("two")' in dict(frame["source"])[frame["line"]]
    variables = {each["name"]: each for each in program["frames"][0]["variables"]}
    assert (variables["sum"]["type"], variables["sum"]["value"]) == ("real", "2.0")
    later = shown.go("statement", agent="boss")
    assert later["seconds"] >= at
    assert later["coordinators"][0]["frames"][0]["method"] == "Post.climb"
    earlier = shown.go("statement", agent="boss", backward=True)
    assert earlier["seconds"] <= at
    assert shown.go("hop", backward=True)["problem"] != ""


@pytest.mark.few(0)
def test_events_are_reached_in_order_in_both_directions(shown):
    times = []
    while not (position := shown.go("event"))["problem"]:
        times.append(position["seconds"])
    assert times == sorted(times)
    assert len(times) > 5
    back = []
    while not (position := shown.go("event", backward=True))["problem"]:
        back.append(position["seconds"])
    assert back[::-1] == times[:-1]


def test_playback_follows_the_clock_and_stops_at_the_end(shown):
    shown.go("time", seconds=1.0)
    start = shown.go("play", speed=2.0)["seconds"]
    shown.time.now += 1.5
    shown.session.advance()
    assert shown.position["seconds"] == pytest.approx(start + 3.0, abs=0.2)
    shown.time.now += 100.0
    shown.session.advance()
    assert shown.position["speed"] == 0.0
    assert shown.position["seconds"] == shown.position["duration"]


def test_only_the_newest_command_is_executed(shown):
    shown.session.request({"go": "hop"})
    shown.session.request({"go": "time", "seconds": 3.0})
    shown.session.advance()
    position = shown.position
    assert position["requested"] == position["executed"] == 2
    assert position["seconds"] == pytest.approx(3.0, abs=0.2)


def test_a_newer_command_cancels_a_search(shown):
    session = shown.session
    player = ReplayPlayer(session._debugger, session._events, lambda: True)
    command = command_of({"go": "hop"})
    place = session._debugger.place
    with pytest.raises(Superseded):
        player.execute(command, 0.0)
    assert session._debugger.place == place
    assert shown.go("hop")["problem"] == ""


@pytest.mark.parametrize(
    "body",
    [
        [],
        {},
        {"go": "stop"},
        {"go": "time", "seconds": -1.0},
        {"go": "time", "seconds": float("nan")},
        {"go": "time", "seconds": float("inf")},
        {"go": "time", "seconds": "1"},
        {"go": "play", "speed": 0.0},
        {"go": "hop", "more": 1},
    ],
)
def test_invalid_requests_are_refused(body):
    assert isinstance(command_of(body), str)


def test_a_time_after_the_end_is_the_end(shown):
    position = shown.go("time", seconds=1e9)
    assert position["seconds"] == position["duration"]
    assert position["progress"] == 1.0


def test_hosts_without_a_recording_are_named(recording, records):
    from lfield.replay.recording_files import load_team

    (alpha,) = records.glob("alpha-*")
    shown = Shown(load_team([alpha]))
    assert shown.position["missing"] == ["bravo"]
    shown.go("time", seconds=2.5)
    assert [host.linked for host in shown.state.hosts.values()] == [True, False]
