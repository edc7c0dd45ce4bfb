"""Four predators and a prey, on virtual time: `lfield test examples/22-predators`."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import hunts
import pytest

#: The radii of a predator and of the prey, in metres.
PREDATOR, PREY = 0.15, 0.2
PACK = {"grey": "north", "black": "east", "white": "south", "brown": "west"}


def surrounded(team, without=""):
    """Whether the prey fits through no gap between two predators, which are on all sides."""
    prey = team.fake("prey").place[:2]
    places = [team.fake(f"{who}.wheels").place[:2] for who in PACK if who != without]

    def bearing(place):
        return math.atan2(place[1] - prey[1], place[0] - prey[0])

    around = sorted(places, key=bearing)
    for one, other in zip(around, [*around[1:], around[0]], strict=True):
        turn = (bearing(other) - bearing(one)) % math.tau
        if turn >= math.pi or math.dist(one, other) - 2.0 * PREDATOR >= 2.0 * PREY:
            return False
    return True


@pytest.mark.few(0)
def test_four_predators_surround_the_prey(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    assert team.ended == {"hunt": "done"}
    assert team.said("caught by 4") == 1
    assert surrounded(team)
    assert team.fake("prey").place[0] > 3.0, "it ran"
    # Two hops for each but the first in a step; broadcasting would take N(N-1) = 12.
    steps = sum(call.portal == "driveTo" for call in team.calls) // 4
    assert len(team.hops) <= 6 * steps + 3


@pytest.mark.few(0)
def test_caught_prey_stays_caught(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    place = team.fake("prey").place
    team.run(10.0)
    assert surrounded(team)
    assert math.dist(team.fake("prey").place, place) < 0.2


@pytest.mark.few(0)
@pytest.mark.parametrize("who", PACK)
def test_three_predators_catch_the_prey_when_a_computer_fails(lfield_mission, who):
    team = lfield_mission("mission.dL", seed=len(who))
    team.at(8.0, lambda: team.power_off(PACK[who]))
    team.run(until_done=True)
    assert team.ended == {"hunt": "done"}
    assert team.said("caught by 3") == 1
    assert surrounded(team, without=who)


@pytest.mark.few(0)
@pytest.mark.process
def test_processes_share_one_simulated_plane():
    """As in the README: a process for each host and each simulated device, in real time."""
    mission = Path(__file__).parent / "mission.dL"
    command = [
        sys.executable,
        "-m",
        "lfield",
        "up",
        "--deploy",
        str(mission),
        "--all",
        "--sim",
        "--until-done",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert "hunt: caught by 4" in done.stderr + done.stdout


def line_of(phrase):
    """The line of the mission that contains these words."""
    text = (Path(__file__).parent / "mission.L").read_text().splitlines()
    (number,) = [number for number, line in enumerate(text, 1) if phrase in line]
    return f"mission.L:{number}"


def test_coordinator_continues_elsewhere_when_its_computer_fails(lfield_mission):
    team, killed = lfield_mission("mission.dL", seed=2), []

    def kill():
        # The coordinator's last destination.
        killed.append(team.hops[-1].target)
        team.crash(killed[0])

    team.run(6.0)
    team.when(line_of("sights[i] = circle[i].rover.driveTo"), kill)
    team.run(until="recovered on this host")
    team.run(until_done=True)
    assert team.ended == {"hunt": "done"}
    assert team.said("caught by 3") == 1
    assert surrounded(team, without=next(who for who, host in PACK.items() if host == killed[0]))


@pytest.mark.few(0)
def test_restarted_predator_hunts_again(lfield_mission):
    team = lfield_mission("mission.dL", seed=1)
    team.at(3.0, lambda: team.crash("east"))
    team.at(4.0, lambda: team.boot("east"))
    team.run(until_done=True)
    assert team.said("black hunts again") == 1
    assert team.said("caught by 4") == 1
    assert surrounded(team)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "world", ["mind=random size=8", "prey=2", "predators=5 mind=away", "moves=4 prey_moves=4 predators=3"]
)
def test_predators_catch_the_prey_in_other_worlds(world):
    end = hunts.hunt(world, 1)
    assert end.caught == end.prey
    assert 0 < end.steps < 200 * end.prey


@pytest.mark.few(0)
def test_table_of_the_page_equals_the_script():
    (world,) = [world for name, world in hunts.WORLDS if name == "prey stands still"]
    page = (Path(__file__).parent / "README.md").read_text(encoding="utf-8")
    ends = [hunts.hunt(world, seed) for seed in range(hunts.RUNS)]
    assert hunts.row("prey stands still", ends) in page
    assert all(f"| {name} | " in page for name, _ in hunts.WORLDS)
