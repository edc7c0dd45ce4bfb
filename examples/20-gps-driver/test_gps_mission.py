"""The distance travelled by a boat, on virtual time: `lfield test examples/20-gps-driver`."""

from __future__ import annotations

import itertools
import math
import re

import pytest

#: Speed of the simulated device in m/s.
SPEED = 2.0


def survey_result(team):
    """The result of the surveyor: metres, and the number of positions."""
    (line,) = (line.text for line in team.log if " m over " in line.text)
    way, places = re.search(r"([\d.]+) m over (\d+) places", line).groups()
    return float(way), int(places)


def test_distance_of_the_boat_is_measured(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    assert team.ended == {"surveyor": "done"}
    way, places = survey_result(team)
    assert way == pytest.approx(20.0 * SPEED, abs=1.5)
    assert places == 21
    # One hop: the portals of a receiver are called on its host.
    assert [hop.target for hop in team.hops] == ["afloat"]


def test_boat_moves_as_its_fake_reports(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    track = [point for point in team.tracks["boat.gps"] if point.at > 1.0]
    gone = sum(math.dist(a[1:3], b[1:3]) for a, b in itertools.pairwise(track))
    assert gone == pytest.approx(SPEED * (track[-1].at - track[0].at), rel=0.02)
    asked = [call.result for call in team.calls if call.portal == "latitude"]
    north = (max(asked) - min(asked)) * 111_320.0
    assert north == pytest.approx(max(p.north for p in track) - min(p.north for p in track), abs=2.0)


def test_missing_positions_are_bridged_by_a_straight_line(lfield_mission):
    team = lfield_mission("mission.dL")
    team.at(8.0, lambda: team.fake("boat.gps").set("no_fix=true"))
    team.at(14.0, lambda: team.fake("boat.gps").set("no_fix=false"))
    team.run(until_done=True)
    way, places = survey_result(team)
    # A position is valid for 2.5 s.
    lost = team.said("not known where it is")
    assert 2 <= lost <= 5
    assert places == 21 - lost
    assert 35.0 < way < 20.0 * SPEED


def test_no_vehicle_starts_without_satellites(lfield_mission):
    team = lfield_mission("mission.dL", fakes={"boat.gps": ["no_fix=true"]})
    team.run(until_done=True)
    assert team.ended == {"surveyor": "died"}
    assert team.said("no fix within 10 s")
    assert 10.0 < team.now < 20.0


@pytest.mark.parametrize("fault", ["noise=0.02", "half=0.3"])
def test_damaged_sentences_cause_no_position_jumps(lfield_mission, fault):
    team = lfield_mission("mission.dL", fakes={"boat.gps": [fault]})
    team.run(until_done=True)
    assert survey_result(team)[0] == pytest.approx(20.0 * SPEED, abs=3.0)
