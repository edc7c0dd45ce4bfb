"""Deployment files: their contents and their hash."""

from pathlib import Path

import pytest
from lang_expectations import GOLDEN

from lfield.errors import InputFileError
from lfield.lang.deployment import Deployment, parse_deployment, read_deployment
from lfield.lang.tree import UnitKind

UNITS: dict[str, UnitKind] = {"Arm": "resource", "Boss": "coordinator"}


def deployment(text: str) -> Deployment:
    found, diagnostics = parse_deployment(text, "mission.dL", UNITS)
    assert found is not None, [d.render() for d in diagnostics]
    return found


def test_every_form_of_a_line() -> None:
    mission = read_deployment(GOLDEN / "deployments" / "ok" / "forms.dL", UNITS)
    assert [(a.type, a.id, a.kind, a.host, a.port, a.arguments) for a in mission.agents] == [
        ("Arm", "arm1", "resource", "olive.example.org", 8200, ("a&b", "#", "café noir")),
        ("Arm", "arm-2", "resource", "10.0.0.7", None, ()),
        ("Boss", "boss_1", "coordinator", "olive.example.org", None, ("arm1", "", "x=#y")),
        ("Boss", "boss.2", "coordinator", "10.0.0.7", None, ()),
        ("Arm", "arm3", "resource", "[::1]", 8181, ()),
        ("Arm", "arm4", "resource", "[2001:db8::12]", None, ("a:b",)),
    ]
    agents, witnesses = ("olive.example.org", "10.0.0.7", "[::1]", "[2001:db8::12]"), mission.hosts[4:]
    assert (mission.hosts[:4], witnesses) == (agents, ("witness.example.org", "10.0.0.8"))
    assert mission.port("10.0.0.8") == 9000
    assert mission.on("10.0.0.8") == ()
    assert [a.id for a in mission.on("10.0.0.7")] == ["arm-2", "boss.2"]
    assert (mission.index("boss_1"), mission.agent("boss_1").type) == (2, "Boss")
    assert (mission.port("olive.example.org"), mission.port("10.0.0.7")) == (8200, None)
    assert mission.agents[2].span.line == 5


def test_hash_depends_on_the_content_and_not_on_the_notation() -> None:
    plain = deployment("//Arm:a@x?1&2\n//Boss:b@y\n").hash
    assert len(plain) == 64
    assert deployment("# team\n\n  pitp://Arm:a@x:9000?%31&2   # first\nBoss:b@y").hash == plain
    for different in ("//Boss:b@y\n//Arm:a@x?1&2", "//Arm:a@x?1\n//Boss:b@y", "//Arm:a@y?1&2\n//Boss:b@y"):
        assert deployment(different).hash != plain
    assert deployment("//Arm:a@x?12").hash != deployment("//Arm:a@x?1&2").hash


def test_witnesses_come_last_and_count_for_the_hash() -> None:
    mixed = deployment("//@w\n//Arm:a@x\n//@v:9\n//Boss:b@y\n")
    assert mixed.hosts == ("x", "y", "w", "v")
    assert mixed.hash == deployment("//Arm:a@x\n//Boss:b@y\n@w\n//@v").hash
    for different in (
        "//Arm:a@x\n//Boss:b@y\n//@v\n//@w",
        "//Arm:a@x\n//Boss:b@y\n//@w",
        "//Arm:a@x\n//Boss:b@y",
    ):
        assert deployment(different).hash != mixed.hash


def test_deployment_of_witnesses_only_is_refused() -> None:
    _, (found,) = parse_deployment("//@w\n//@v", "mission.dL", UNITS)
    assert (found.code, found.message) == ("L712", "the deployment is empty")


def test_types_are_not_checked_without_the_program() -> None:
    found, diagnostics = parse_deployment("//Anything:a@x", "mission.dL", None)
    assert diagnostics == []
    assert found is not None
    assert found.agents[0].kind == "unknown"


def test_all_errors_of_a_file_and_a_line_are_reported() -> None:
    _, found = parse_deployment("//Amr:a!@x?%\n//Arm:a@x\n//Arm:a@x:0", "mission.dL", UNITS)
    assert [(d.code, d.span.line) for d in found] == [("L704", 1), ("L710", 1), ("L707", 3)]
    _, found = parse_deployment("//Amr:a@x\n//Arm:a@x", "mission.dL", UNITS)
    assert (found[0].code, found[0].hint) == ("L702", "did you mean 'Arm'?")


def test_caret_is_below_the_wrong_part() -> None:
    _, (found,) = parse_deployment("//Arm:a@x:99999?1", "mission.dL", UNITS)
    assert found.render().split("\n")[:3] == [
        "mission.dL:1:11: error[L707]: the port '99999' is not valid",
        "    //Arm:a@x:99999?1",
        "              ^~~~~",
    ]


def test_missing_deployment_file_is_an_input_file_error(tmp_path: Path) -> None:
    with pytest.raises(InputFileError):
        read_deployment(tmp_path / "missing.dL", UNITS)


SIX = "//Arm:a@alpha\n//Arm:b@bravo\n//Arm:c@chrlie\n//Arm:d@zulu\n//Arm:e@port\n//Arm:f@post\n"


@pytest.mark.parametrize(
    ("inventory", "unknown"),
    [
        ((), []),
        # No host of the deployment is in this inventory: it belongs to another team.
        (("xray", "yankee"), []),
        (("alpha", "bravo", "charlie", "port", "post"), ["chrlie", "zulu"]),
        (("alpha", "bravo", "chrlie", "zulu", "port", "post"), []),
    ],
)
def test_host_missing_in_the_inventory_of_its_team_is_unknown(inventory, unknown) -> None:
    _, found = parse_deployment(SIX, "mission.dL", UNITS, inventory)
    assert [diagnostic.span.text for diagnostic in found if diagnostic.code == "L908"] == unknown
    hints = {diagnostic.span.text: diagnostic.hint for diagnostic in found}
    assert hints.get("chrlie") in (None, "did you mean 'charlie'?")
