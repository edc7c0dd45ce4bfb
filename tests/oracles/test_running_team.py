"""The output of commands for a running, simulated team is in `golden/running team.txt`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from simulated_team import SimulatedTeam

Desk = Callable[[str], str]


def looked_at(team: SimulatedTeam) -> Iterator[str]:
    team.fleet.run(20.0)
    yield from ("ps", "ps --json", "logs", "logs --json", "logs --host alpha", "logs --host nowhere")
    for form in ("", "--json ", "--csv "):
        yield f"events {form}--no-follow"
    yield from ("events --no-follow --kinds hopped,printed --host bravo", "events --kinds nothing")
    yield from ("query Climb", "query Climb --json")


def stopped(team: SimulatedTeam) -> Iterator[str]:
    team.fleet.run(5.0)
    yield from ("estop --reason fog", "ps", "estop --lift", "ps")


def stopped_by_one_who_does_not_look(team: SimulatedTeam) -> Iterator[str]:
    team.fleet.run(5.0)
    yield from ("estop --no-wait", "start", "estop --lift", "start")


def paused(team: SimulatedTeam) -> Iterator[str]:
    team.fleet.run(5.0)
    yield from ("pause", "ps", "resume", "ps")


def begun_without_a_host(team: SimulatedTeam) -> Iterator[str]:
    team.fleet.power_off("charlie")
    team.fleet.run(5.0)
    yield from ("ps", "start", "start --without nowhere", "start --without charlie", "ps")


def recovered(team: SimulatedTeam) -> Iterator[str]:
    team.fleet.run(5.0)
    yield from ("recover patrol --yes", "recover nobody --yes")
    team.wait_for("patrol", "bravo")
    team.fleet.lose("bravo")
    team.fleet.run(12.0)
    yield from ("ps", "recover patrol", "recover patrol --yes", "ps", "estop")


def forgotten(team: SimulatedTeam) -> Iterator[str]:
    team.fleet.run(5.0)
    yield from ("forget patrol", "forget nobody")
    team.wait_for("patrol", "bravo")
    team.fleet.lose("bravo")
    team.fleet.run(12.0)
    yield from ("forget patrol", "ps")


SCENARIOS = (
    looked_at, stopped, stopped_by_one_who_does_not_look, paused, begun_without_a_host, recovered, forgotten,
)  # fmt: skip


@pytest.fixture
def team(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SimulatedTeam]:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("COLUMNS", "120")
    made = SimulatedTeam(tmp_path, monkeypatch)
    yield made
    made.fleet.close()


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.__name__)
def test_a_command_prints_of_a_running_team_what_it_did(golden, team: SimulatedTeam, scenario) -> None:
    golden("running team").check(scenario.__name__, "".join(team(line) for line in scenario(team)))


def test_the_golden_file_has_no_other_scenarios(golden) -> None:
    golden("running team").has_only([scenario.__name__ for scenario in SCENARIOS])
