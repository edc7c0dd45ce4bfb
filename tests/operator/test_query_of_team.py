"""The team of a query, from files and from running hosts."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from scripted_snapshots import states_of

from lfield.capability.condition_compiler import compile_constraint
from lfield.capability.matching.matcher import Matcher
from lfield.capability.offer import Fact
from lfield.capability.registry_reader.registry_files import check_files, shipped
from lfield.errors import AddressError, WireError
from lfield.operator.client import unanswered
from lfield.operator.team_query import directory_views, roster_from_files, roster_from_hosts
from lfield.wire.observer_messages import AttributeReading, DirectoryEntry, Status

REGISTRY = """
registry: 1
providers:
  Hoist:
    attributes: {payload: 5.0}
    live: {battery: motor.battery, armed: motor.armed, fix: gps.fix, note: motor.words}
    serves: {Lift: {}}
attributes:
  note: {type: text, live: true, max_age: 5.0}
agents:
  second: {payload: 1.2, battery: 0.5}
"""


@dataclass(frozen=True)
class Agent:
    id: str
    type: str
    host: str


AGENTS = [Agent("first", "Hoist", "alpha"), Agent("second", "Hoist", "bravo"), Agent("boss", "Boss", "alpha")]


@pytest.fixture(scope="module")
def registry(tmp_path_factory):
    path = tmp_path_factory.mktemp("registry") / "mission.capabilities.yaml"
    path.write_text(REGISTRY)
    made, found = check_files(shipped(), mission=path)
    assert made is not None, [d.render() for d in found]
    return made


def told(refusal="", unknown=None, **facts):
    return (
        refusal,
        {name: AttributeReading(value, age) for name, (value, age) in facts.items()},
        unknown or {},
    )


def status(**agents):
    directory = [DirectoryEntry(agent, *entry) for agent, entry in agents.items()]
    return Status("alpha", "", 0.0, b"", b"", [], [], [], [], directory)


def refusals(registry, team, condition):
    constraint = compile_constraint(condition, registry.attributes)
    return [str(refusal) for refusal in Matcher(registry, team).explain("Lift", constraint)][:2]


def hosts(registry, answers, at=""):
    return roster_from_hosts(
        registry, AGENTS, directory_views(states_of(answers)), unanswered(answers), at
    ).candidates("Hoist")


def test_from_files_only_stated_attributes_are_known(registry):
    first, second = roster_from_files(registry, AGENTS).candidates("Hoist")
    assert (first.agent, first.host, dict(first.stated)) == ("first", "alpha", {})
    assert second.stated == {"payload": Fact(1.2), "battery": Fact(0.5)}
    assert (dict(first.facts), dict(second.facts)) == ({}, {})
    assert set(first.unknown) == {"battery", "armed", "fix", "note"}
    assert set(second.unknown) == {"armed", "fix", "note"}
    assert roster_from_files(registry, AGENTS).candidates("Boss") == ()


def test_a_condition_on_a_live_attribute_is_not_met_from_files(registry):
    team = roster_from_files(registry, AGENTS)
    assert refusals(registry, team, "battery >= 0.6") == [
        "first: battery is not known: the team is not running",
        "second: battery 0.5 < 0.6",
    ]


def test_hops_are_counted_from_the_host_of_the_query(registry):
    assert [c.hops for c in roster_from_files(registry, AGENTS).candidates("Hoist")] == [1, 1]
    assert [c.hops for c in roster_from_files(registry, AGENTS, "bravo").candidates("Hoist")] == [1, 0]


def test_live_values_come_with_their_age(registry):
    answers = {"alpha": status(first=told(battery=[0.8, 2.5], armed=[True, 0.1], note=["well", 1.0]))}
    first, _ = hosts(registry, answers)
    assert first.facts == {
        "battery": Fact(0.8, 2.5, "measured"),
        "armed": Fact(True, 0.1, "measured"),
        "note": Fact("well", 1.0, "measured"),
    }
    assert first.unknown == {"fix": "fix is unknown: no host reports it"}


def test_the_host_names_the_reason_of_an_unknown_value(registry):
    answers = {"alpha": status(first=told(unknown={"battery": "motor has not reported battery"}))}
    first, _ = hosts(registry, answers)
    assert first.unknown["battery"] == "motor has not reported battery"


def test_stated_values_of_a_mission_override_live_ones(registry):
    answers = {"bravo": status(second=told(battery=[0.9, 1.0]))}
    second = hosts(registry, answers)[1]
    assert (second.fact("battery"), dict(second.facts)) == (Fact(0.5), {})


def test_an_agents_own_host_counts_before_others_and_the_asked_host_first(registry):
    answers = {
        "alpha": status(first=told(battery=[0.8, 0.0]), second=told("unreachable for 3 s")),
        "bravo": status(first=told(battery=[0.7, 4.0]), second=told()),
    }
    first, second = hosts(registry, answers)
    assert (first.facts["battery"].value, second.refusal) == (0.8, "")
    first, second = hosts(registry, answers, at="alpha")
    assert (first.facts["battery"].value, second.refusal) == (0.8, "unreachable for 3 s")
    first, second = hosts(registry, answers, at="bravo")
    assert (first.facts["battery"].value, second.refusal) == (0.7, "")


def test_agents_of_a_silent_host_are_reported_by_others_or_refused(registry):
    unreachable = AddressError("10.0.0.1:1", "no program listens there")
    answers = {"alpha": status(second=told("unreachable for 9 s")), "bravo": unreachable}
    assert hosts(registry, answers)[1].refusal == "unreachable for 9 s"
    assert (
        hosts(registry, {"alpha": status(), "bravo": unreachable})[1].refusal
        == "its host bravo does not answer"
    )


@pytest.mark.parametrize(
    "facts",
    [
        {"battery": ["full", 1.0]},
        {"battery": [True, 1.0]},
        {"armed": [1, 1.0]},
        {"note": [3, 1.0]},
        {"payload": ["heavy", 1.0]},
        {"agent": ["first", 1.0]},
        {"nonsense": [9.0, 1.0]},
    ],
)
def test_invalid_live_values_are_left_out(registry, facts):
    first, _ = hosts(registry, {"alpha": status(first=told(**facts))})
    assert first.facts == {}


def test_a_host_with_an_invalid_answer_counts_as_silent(registry):
    answers = {"alpha": WireError("a message cannot be read: Expected `array`, got `int`"), "bravo": status()}
    assert directory_views(states_of(answers)) == {"bravo": {}}
    assert unanswered(answers) == {"alpha": answers["alpha"]}
    assert hosts(registry, answers)[0].refusal == "its host alpha does not answer"


def test_a_host_without_a_directory_has_answered():
    answers = {"alpha": status()}
    assert (directory_views(states_of(answers)), unanswered(answers)) == ({"alpha": {}}, {})
