"""Missions with a common robot: the previous bundles of their robots differ; a rollback names commands."""

from __future__ import annotations

import re

import pytest
from robots import program, told

pytestmark = pytest.mark.process

FIRST, SECOND = "//Walker:tom@alpha?post\n//Post:post@bravo\n", "//Walker:tom@bravo?post\n//Post:post@carol\n"


@pytest.mark.few(0)
def test_a_rollback_names_for_each_robot_the_command_to_its_previous_bundle(lfield, here, robots) -> None:
    team = robots("alpha", "bravo", "carol")
    team.up()
    first, second = (
        lfield.mission(program(), text, name=name) for name, text in (("first", FIRST), ("second", SECOND))
    )
    before = told(here("push", first, "--json"))
    assert told(here("push", second, "--json"))["outcome"] == "activated"

    refused = here("rollback", status=64)
    text = " ".join(refused.err)
    assert {"first", before["bundle"][:16]} <= set(re.findall(r"\w+", text))
    (command,) = re.findall(r"'lfield (rollback [^']*)'", text)
    assert command == "rollback --without carol"
    back = told(here(*command.split(), "--json"))
    assert (back["outcome"], back["bundle"]) == ("activated", before["bundle"])
    states = told(here("status", "--json"))
    assert [states[host]["bundle"] == before["bundle"] for host in team.hosts] == [True, True, False]


@pytest.mark.few(0)
def test_a_rollback_names_a_push_for_a_mission_with_another_robot(lfield, here, robots) -> None:
    """The previous bundles of alpha and bravo differ."""
    team = robots("alpha", "bravo")
    team.up()
    alone = "//Walker:tom@alpha?post\n//Post:post@alpha\n"
    for name, deployment in (("first", FIRST), ("alone", alone), ("last", FIRST)):
        mission = lfield.mission(program(text=name), deployment, name=name)
        assert told(here("push", mission, "--json"))["outcome"] == "activated"
    refused = here("rollback", status=64)
    text = " ".join(refused.err)
    assert re.findall(r"'lfield ([^']*)'", text) == ["rollback --without bravo", "push"]
    here("rollback", "--without", "bravo", status=0)
