"""Answers to users are checked against the portals of the program, as the answers to programs are."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.capability.matching.matcher import Matcher
from lfield.capability.program_types.program_resources import resources_of
from lfield.capability.registry_reader.unit_signatures import signatures_of
from lfield.driver.plugins import discover
from lfield.errors import ProgramError
from lfield.mission import bundle
from lfield.mission.loader import compile_file, load_mission
from lfield.mission.registry_check import program_files
from lfield.operator.targets import open_team
from lfield.operator.team_query import read_context, roster_from_files
from lfield.text.source_text import Diagnostics

EXAMPLES = Path(__file__).parents[2] / "examples"

# : A Copter that is not the one of the stock library: it can only move and circle.
PROGRAM = """
resource Copter {
    init(string[] arg) { while (true) yield(); }
    portal %s(real north, real east, real down) emit boolean { return true; }
    portal land() { }
}
coordinator Boss { init(string[] arg) { %s } }
"""
DEPLOYMENT = "//Copter:lead@alpha\n//Boss:boss@alpha\n"
WRONG = "registry: 1\nproviders: {Copter: {serves: {Lift: {portals: {lift: nope, lower: nope}}}}}\n"


@pytest.fixture
def mission(tmp_path):
    """`mission(portal, asks)`: the deployment of a team whose copter has this portal."""

    def made(portal: str = "wander", asks: str = "", **files: str) -> Path:
        (tmp_path / "mission.L").write_text(PROGRAM % (portal, asks))
        (tmp_path / "mission.dL").write_text(DEPLOYMENT)
        for name, text in files.items():
            (tmp_path / f"mission.{name}.yaml").write_text(text)
        return tmp_path / "mission.dL"

    return made


def offered(path: Path, primitive: str, capabilities: Path | None = None) -> list[str]:
    """The providers of a primitive, as a query reports them."""
    team = open_team(path)
    context = read_context(path, team, capabilities)
    matcher = Matcher(
        context.registry, roster_from_files(context.registry, team.deployed), context.realisations
    )
    return [offer.agent for offer in matcher.find(primitive).offers]


def test_a_resource_with_only_the_name_of_a_stock_one_promises_nothing():
    assert offered(EXAMPLES / "01-first-flight/mission.dL", "Orbit") == []


@pytest.mark.parametrize("asks", ["", "GoTo[] who = findGoTo();", "Lift[] who = findLift();"])
def test_a_resource_with_the_portals_serves_a_primitive_for_any_program(mission, asks):
    path = mission("flyTo", asks)
    assert offered(path, "GoTo") == ["lead"]
    assert offered(path, "Orbit") == offered(path, "Climb") == []


def test_a_resource_without_the_portals_does_not_stand_in_for_others(mission):
    """By composition rules, a climbing resource lifts, and one that goes to places follows paths."""
    assert offered(mission("flyTo"), "FollowPath") == ["lead"]
    assert offered(mission("flyTo"), "Lift") == []
    assert offered(mission("wander"), "FollowPath") == []


@pytest.mark.parametrize("asks", ["", "Orbit[] who = findOrbit();"])
def test_a_bundle_without_source_is_checked_against_its_program(mission, tmp_path, asks):
    path = tmp_path / "mission.lfm"
    path.write_bytes(bundle.encode(load_mission(mission("flyTo", asks), simulate=True)))
    added = tmp_path / "added.yaml"
    added.write_text("registry: 1\n")
    assert offered(path, "Orbit", added) == []
    assert offered(path, "GoTo", added) == ["lead"]
    if asks:
        assert offered(path, "Orbit") == []
        assert offered(path, "GoTo") == ["lead"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"devices": "agents: {nobody: {}}\n"},
        {"devices": "agents: {lead: {heap: much}}\n"},
        {"asks": 'print("unfinished" + 1.5);'},
    ],
)
def test_errors_elsewhere_do_not_make_a_promise_valid(mission, wrong):
    path = mission("flyTo", **wrong)
    assert offered(path, "GoTo") == ["lead"]
    assert offered(path, "Orbit") == []


@pytest.mark.parametrize("asks", ["", "Lift[] who = findLift();", 'print("unfinished" + 1.5);'])
def test_a_wrong_promise_of_a_mission_is_reported(mission, asks):
    path = mission("wander", asks, capabilities=WRONG)
    with pytest.raises(ProgramError) as raised:
        offered(path, "Lift")
    assert {mistake.code for mistake in raised.value.diagnostics} == {"C170"}


def test_stated_attributes_count_where_the_program_asks_for_nothing(mission):
    path = mission("flyTo", devices="agents: {lead: {attributes: {mass: 7 kg}}}\n")
    context = read_context(path, open_team(path))
    assert context.stated == {"lead": {"mass": 7.0}}


@pytest.mark.few(4)
@pytest.mark.parametrize(
    "path", sorted(EXAMPLES.glob("0*/*.L")), ids=lambda path: f"{path.parent.name}-{path.stem}"
)
def test_a_compiled_program_has_the_portals_of_its_source(path):
    read = signatures_of(program_files(path, discover(), Diagnostics()))
    compiled = resources_of(compile_file(path)[0])
    assert {name: unit.portals for name, unit in compiled.items()} == {
        name: unit.portals for name, unit in read.items() if unit.kind == "resource"
    }
