"""The distance travelled by a boat, on virtual time: `lfield test examples/20-gps-driver`."""

from __future__ import annotations

import itertools
import math
import re

import pytest

#: Speed of the simulated device in m/s.
SPEED = 2.0


def survey_result(team):
    """The distance in metres and the number of positions that the surveyor printed."""
    (line,) = (line.text for line in team.log if " m over " in line.text)
    distance, positions = re.search(r"([\d.]+) m over (\d+) places", line).groups()
    return float(distance), int(positions)


def test_surveyor_measures_the_distance_with_one_hop(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    assert team.ended == {"surveyor": "done"}
    distance, positions = survey_result(team)
    assert distance == pytest.approx(20.0 * SPEED, abs=1.5)
    assert positions == 21
    assert [hop.target for hop in team.hops] == ["afloat"]


def test_reported_positions_agree_with_the_true_track(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    track = [point for point in team.tracks["boat.gps"] if point.at > 1.0]
    length = sum(math.dist(a[1:3], b[1:3]) for a, b in itertools.pairwise(track))
    assert length == pytest.approx(SPEED * (track[-1].at - track[0].at), rel=0.02)
    latitudes = [call.result for call in team.calls if call.portal == "latitude"]
    north = (max(latitudes) - min(latitudes)) * 111_320.0
    assert north == pytest.approx(max(p.north for p in track) - min(p.north for p in track), abs=2.0)


def test_outage_of_the_fix_is_bridged_by_a_straight_line(lfield_mission):
    team = lfield_mission("mission.dL")
    team.at(8.0, lambda: team.fake("boat.gps").set("no_fix=true"))
    team.at(14.0, lambda: team.fake("boat.gps").set("no_fix=false"))
    team.run(until_done=True)
    distance, positions = survey_result(team)
    # The outage lasts 6 s, and the last position is valid for 2.5 s.
    missing = team.said("not known where it is")
    assert 2 <= missing <= 5
    assert positions == 21 - missing
    assert 35.0 < distance < 20.0 * SPEED


def test_survey_ends_with_an_error_without_satellites(lfield_mission):
    team = lfield_mission("mission.dL", fakes={"boat.gps": ["no_fix=true"]})
    team.run(until_done=True)
    assert team.ended == {"surveyor": "died"}
    assert team.said("no fix within 10 s")
    assert 10.0 < team.now < 20.0


@pytest.mark.parametrize("fault", ["noise=0.02", "half=0.3"])
def test_damaged_sentences_do_not_change_the_distance(lfield_mission, fault):
    team = lfield_mission("mission.dL", fakes={"boat.gps": [fault]})
    team.run(until_done=True)
    assert survey_result(team)[0] == pytest.approx(20.0 * SPEED, abs=3.0)
