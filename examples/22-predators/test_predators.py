"""Four predators and a prey, on virtual time: `lfield test examples/22-predators`."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import hunt_statistics
import pytest

#: Radii of a predator and of the prey in metres.
PREDATOR, PREY = 0.15, 0.2
#: The host of each predator.
PACK = {"grey": "north", "black": "east", "white": "south", "brown": "west"}


def is_prey_surrounded(team, without=""):
    """Whether predators are on all sides of the prey, without a gap that is wide enough for the prey."""
    prey = team.fake("prey").place[:2]
    places = [team.fake(f"{name}.wheels").place[:2] for name in PACK if name != without]

    def bearing(place):
        return math.atan2(place[1] - prey[1], place[0] - prey[0])

    circle = sorted(places, key=bearing)
    for first, second in zip(circle, [*circle[1:], circle[0]], strict=True):
        turn = (bearing(second) - bearing(first)) % math.tau
        if turn >= math.pi or math.dist(first, second) - 2.0 * PREDATOR >= 2.0 * PREY:
            return False
    return True


@pytest.mark.few(0)
def test_four_predators_surround_the_prey(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    assert team.ended == {"hunt": "done"}
    assert team.said("caught by 4") == 1
    assert is_prey_surrounded(team)
    assert team.fake("prey").place[0] > 3.0, "the prey must flee"
    # A step needs 2(N-1) = 6 hops.
    steps = sum(call.portal == "driveTo" for call in team.calls) // 4
    assert len(team.hops) <= 6 * steps + 3


@pytest.mark.few(0)
def test_caught_prey_stays_caught(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    place = team.fake("prey").place
    team.run(10.0)
    assert is_prey_surrounded(team)
    assert math.dist(team.fake("prey").place, place) < 0.2


@pytest.mark.few(0)
@pytest.mark.parametrize("failed", PACK)
def test_three_predators_catch_the_prey_when_a_computer_fails(lfield_mission, failed):
    team = lfield_mission("mission.dL", seed=len(failed))
    team.at(8.0, lambda: team.power_off(PACK[failed]))
    team.run(until_done=True)
    assert team.ended == {"hunt": "done"}
    assert team.said("caught by 3") == 1
    assert is_prey_surrounded(team, without=failed)


@pytest.mark.few(0)
@pytest.mark.process
def test_processes_share_one_simulated_plane():
    """Each host and each simulated device is a process, in real time."""
    mission = Path(__file__).parent / "mission.dL"
    up = ("up", "--deploy", str(mission), "--all", "--sim", "--until-done")
    command = [sys.executable, "-m", "lfield", *up]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert "hunt: caught by 4" in done.stderr + done.stdout


def line_of(text):
    """The line of mission.L that contains a text, as for `team.when`."""
    lines = (Path(__file__).parent / "mission.L").read_text().splitlines()
    (number,) = [number for number, line in enumerate(lines, 1) if text in line]
    return f"mission.L:{number}"


def test_another_host_continues_the_coordinator_when_its_host_fails(lfield_mission):
    team, killed = lfield_mission("mission.dL", seed=2), []

    def kill_coordinators_host():
        killed.append(team.hops[-1].target)
        team.crash(killed[0])

    team.run(6.0)
    team.when(line_of("sights[i] = circle[i].rover.driveTo"), kill_coordinators_host)
    team.run(until="recovered on this host")
    team.run(until_done=True)
    assert team.ended == {"hunt": "done"}
    assert team.said("caught by 3") == 1
    failed = next(name for name, host in PACK.items() if host == killed[0])
    assert is_prey_surrounded(team, without=failed)


@pytest.mark.few(0)
def test_predator_with_a_restarted_host_returns_to_the_hunt(lfield_mission):
    team = lfield_mission("mission.dL", seed=1)
    team.at(3.0, lambda: team.crash("east"))
    team.at(4.0, lambda: team.boot("east"))
    team.run(until_done=True)
    assert team.said("black hunts again") == 1
    assert team.said("caught by 4") == 1
    assert is_prey_surrounded(team)


@pytest.mark.few(0)
@pytest.mark.parametrize(
    "world", ["mind=random size=8", "prey=2", "predators=5 mind=away", "moves=4 prey_moves=4 predators=3"]
)
def test_predators_catch_the_prey_in_other_worlds(world):
    result = hunt_statistics.hunt(world, 1)
    assert result.caught == result.prey
    assert 0 < result.steps < 200 * result.prey


@pytest.mark.few(0)
def test_readme_has_the_table_of_the_script():
    world = dict(hunt_statistics.WORLDS)["prey stands still"]
    readme = (Path(__file__).parent / "README.md").read_text(encoding="utf-8")
    results = [hunt_statistics.hunt(world, seed) for seed in range(hunt_statistics.RUNS)]
    assert hunt_statistics.table_row("prey stands still", results) in readme
    assert all(f"| {name} | " in readme for name, _ in hunt_statistics.WORLDS)
