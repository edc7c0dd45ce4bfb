"""The march on virtual time: `lfield test examples/20-formation`."""

from __future__ import annotations

import math
from itertools import combinations, permutations

import pytest
import terrain_marches

COPTERS, ROVERS = ("ada", "bob", "cat"), ("dan", "eve")
HOSTS = dict(zip((*COPTERS, *ROVERS), ("alpha", "bravo", "carol", "delta", "echo"), strict=True))
#: Metres: spacing, and tolerance of a slot at the end of a leg.
SPACING, OFF = 4.0, 0.6
#: The end of each leg, north and east, and the heading there.
LEGS = {"wedge": (18.0, 0.0, 0.0), "column": (18.0, 18.0, math.pi / 2), "line": (0.0, 18.0, math.pi)}
#: Seconds since the start: in the middle of the second leg, which is flown as a column.
MID = 38.0


def places(formation, many):
    """The slots of a formation at the end of its leg, computed independently of the mission."""
    north, east, heading = LEGS[formation]
    if formation == "wedge":
        steps = [(-rank, side * rank) for rank, side in ((0, 0), (1, -1), (1, 1), (2, -1), (2, 1))]
        body = [(ahead * SPACING / math.sqrt(2), right * SPACING / math.sqrt(2)) for ahead, right in steps]
    else:
        body = [(-SPACING * i, 0.0) for i in range(many)]
    if formation == "line":
        body = [(0.0, SPACING * (i - (many - 1) / 2)) for i in range(many)]
    cos, sin = math.cos(heading), math.sin(heading)
    return [(north + a * cos - r * sin, east + a * sin + r * cos) for a, r in body[:many]]


def reported_size(team, formation):
    """The size of a formation, and its time."""
    (line,) = [line for line in team.log if f"a {formation} of" in line.text]
    return int(line.text.split(" of ")[1].split()[0]), line.at


def at(team, who, moment):
    return min(team.tracks[f"{who}.fc"], key=lambda point: abs(point.at - moment))


def worst(team, formation, members=(*COPTERS, *ROVERS)):
    """The largest deviation from a slot at the end of the leg, in metres; in any order."""
    many, moment = reported_size(team, formation)
    assert many == len(members)
    here = [at(team, who, moment)[1:3] for who in members]
    slots = places(formation, many)
    return min(max(map(math.dist, here, order)) for order in permutations(slots))


def closest(team, group):
    """The least distance of any two of a group during the run."""
    tracks = [team.tracks[f"{who}.fc"] for who in group]
    return min(math.dist(a[1:], b[1:]) for x, y in combinations(tracks, 2) for a, b in zip(x, y, strict=True))


def agreements(team):
    """The number of agreements: one per slot that was reached, and one for the landing."""
    return max(sum(call.resource == who for call in team.calls) for who in HOSTS)


def assert_in_step(team):
    """During the march no vehicle is farther from the others than half a step allows."""
    start, end = reported_size(team, "wedge")[1] + 10.0, reported_size(team, "column")[1]
    for tenth in range(int(start * 10), int(end * 10)):
        column = sorted(at(team, who, tenth / 10).east for who in HOSTS)
        assert column[-1] - column[0] < 4 * SPACING + 6.0, "a step is 6 m"


def assert_simultaneous_steps(team):
    """In each step one visit to start and one to fetch, except for the coordinator's host."""
    goes = [call for call in team.calls if call.portal in ("flyTo", "driveTo")]
    steps = [goes[i : i + 5] for i in range(0, len(goes), 5)]
    assert len(steps) == agreements(team) - 1 == 12
    assert all(max(call.at for call in step) < min(call.ended for call in step) for step in steps)
    # Broadcasting would take N(N-1) = 20 messages each time.
    assert len(team.hops) <= 8 * 13


def marched(lfield_mission, **options):
    team = lfield_mission("mission.dL", **options)
    team.run(until_done=True)
    assert team.ended == {"march": "done"}
    return team


def stopped(lfield_mission, act, moment=MID):
    """A march with an event in the middle of the second leg."""
    team = lfield_mission("mission.dL")
    team.at(moment, lambda: act(team))
    team.run(until_done=True, at_most=200.0)
    assert team.ended == {"march": "done"}
    assert worst(team, "wedge") < OFF
    assert reported_size(team, "wedge")[1] < moment < reported_size(team, "column")[1]
    return team


@pytest.mark.few(0)
def test_every_formation_is_reached_without_a_collision(lfield_mission):
    team = marched(lfield_mission)
    assert [worst(team, formation) < OFF for formation in LEGS] == [True] * 3
    assert closest(team, COPTERS) > SPACING - 0.5
    assert closest(team, ROVERS) > SPACING / 2
    assert 3.5 < max(point.up for point in team.tracks["ada.fc"]) < 4.5
    assert not any(team.fake(f"{who}.fc").facts["airborne"] for who in COPTERS), "they have landed"
    assert_in_step(team)
    assert_simultaneous_steps(team)


@pytest.mark.few(0)
@pytest.mark.parametrize("who", ["bob", "cat", "dan"])
def test_formation_closes_after_a_motor_failure(lfield_mission, who):
    team = stopped(lfield_mission, lambda team: team.fake(f"{who}.fc").set("motor_failure=true"))
    others = [each for each in HOSTS if each != who]
    assert team.said(f"march: {who}.fc is left behind") == 1
    assert worst(team, "column", others) < OFF
    assert worst(team, "line", others) < OFF


@pytest.mark.few(0)
@pytest.mark.parametrize("group", [COPTERS, ROVERS])
def test_lost_host_is_left_behind(lfield_mission, group):
    lost = []

    def act(team):
        # The failure of the coordinator's own host is another test.
        lost.extend([who for who in group if HOSTS[who] != team.hops[-1].target][:1])
        team.crash(HOSTS[lost[0]])

    team = stopped(lfield_mission, act)
    others = [each for each in HOSTS if each not in lost]
    assert team.said(f"march: {lost[0]} is left behind: {HOSTS[lost[0]]} could not be reached") == 1
    assert worst(team, "line", others) < OFF
    assert not team.fake(f"{lost[0]}.fc").facts["moving"], "it is in its safe state"


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("moment", "many"), [(MID, 2), (MID + 2.0, 3)], ids=["both rovers drive", "one rover drives"]
)
def test_march_continues_when_the_coordinators_host_is_lost(lfield_mission, moment, many):
    lost = []

    def act(team):
        lost.append(team.hops[-1].target)
        team.power_off(lost[0])

    team = stopped(lfield_mission, act, moment)
    assert team.said("march recovered on this host") == 1
    (gone,) = (who for who, host in HOSTS.items() if host == lost[0])
    assert team.said(f"march: {gone} is left behind") == 1
    # Those that move when the failed coordinator is fenced are put into their safe states.
    held = {
        who for who in HOSTS if team.said(f"{who}.fc entering safe state 'hold': march, which has used it")
    }
    assert all(team.said(f"march: {who}.fc is left behind: fc: held in its safe state") == 1 for who in held)
    others = [who for who in HOSTS if who != gone and who not in held]
    assert len(others) == many
    assert worst(team, "line", others) < OFF


@pytest.mark.few(0)
def test_two_simultaneous_failures(lfield_mission):
    def act(team):
        team.fake("bob.fc").set("motor_failure=true")
        (
            team.cut("echo", "alpha"),
            team.cut("echo", "bravo"),
            team.cut("echo", "carol"),
            team.cut("echo", "delta"),
        )

    team = stopped(lfield_mission, act)
    assert team.said("is left behind") == 2
    assert worst(team, "line", ["ada", "cat", "dan"]) < OFF


@pytest.mark.few(0)
def test_formation_holds_in_wind_and_gusts(lfield_mission):
    wind = ["wind=7", "gusts=4", "wind_from=0.8"]
    blown = marched(lfield_mission, fakes={f"{who}.fc": wind for who in COPTERS})
    assert [worst(blown, formation) < OFF for formation in LEGS] == [True] * 3


@pytest.mark.few(0)
def test_vehicle_carried_off_by_a_storm_is_left_behind(lfield_mission):
    team = stopped(lfield_mission, lambda team: team.fake("ada.fc").set("wind=20"))
    assert team.said("march: ada.fc is left behind") == 1
    assert worst(team, "line", ["bob", "cat", "dan", "eve"]) < OFF


@pytest.mark.few(0)
def test_vehicle_with_a_low_battery_does_not_march(lfield_mission):
    team = marched(lfield_mission, fakes={"bob.fc": ["battery=0.25"]})
    assert worst(team, "line", [who for who in HOSTS if who != "bob"]) < OFF
    assert not any(point.up > 0.1 for point in team.tracks["bob.fc"])


@pytest.mark.few(0)
def test_same_seed_gives_the_same_march(lfield_mission):
    first, again = (marched(lfield_mission, seed=1) for _ in range(2))
    assert first.tracks == again.tracks
    assert first.log == again.log


@pytest.mark.few(0)
@pytest.mark.parametrize("ground", [terrain_marches.mud, terrain_marches.hill, terrain_marches.valley])
def test_formation_holds_over_terrain(ground):
    """Mud slows rovers and wind moves copters: the step takes longer, and the formation holds."""
    found = terrain_marches.march(ground)
    assert found.arrived == 5
    assert found.spread < 2.5 * SPACING
