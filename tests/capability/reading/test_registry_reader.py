"""Valid registry files, and the files of missions that extend them."""

from __future__ import annotations

from pathlib import Path

import pytest
from registry_expectations import BASE, GOLDEN

from lfield.capability import realisations
from lfield.capability.model import Argument, LiveAttribute, Registry, Weights
from lfield.capability.program_types.class_generator import prelude
from lfield.capability.registry_reader.registry_files import check_files, read_registry, shipped
from lfield.errors import InputFileError, ProgramError
from lfield.lang.capability_port import OFFER_METHODS
from lfield.lang.parser import parse_file
from lfield.text.source_text import Diagnostic, Diagnostics

CRANE = """
registry: 1
providers:
  Crane:
    include: can/crane.L
    attributes: {payload: "1500 g", environment: terrestrial, heat: "300 K", limbs: 2, legal: true,
                 chassis: hull}
    live: {battery: {from: "fc.battery", unit: "%"}, north: "fc.position[0]"}
    serves:
      Lift:
        when: "legal && payload > 1"
        attributes: {payload: 1.0}
        portals:
          lift:
            portal: reel
            arguments: [{parameter: height, unit: mm}, 2, {constant: fast}]
            emit: {unit: cm}
      Grip:
"""


@pytest.fixture
def write(tmp_path: Path):
    """Write a registry file."""

    def written(text: str, name: str = "more.yaml") -> Path:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return written


def places_of(found: list[Diagnostic]) -> list[str]:
    return [f"{d.code} {d.span.line}:{d.span.column} {d.span.text}" for d in found]


def good(*files: Path, mission: Path | None = None) -> Registry:
    registry, found = check_files([BASE, *files], mission=mission)
    assert [d.render() for d in found] == []
    assert registry is not None
    return registry


def test_provider_values_are_converted_to_si(write) -> None:
    crane = good(write(CRANE)).providers["Crane"]
    assert crane.include == "can/crane.L"
    assert crane.attributes == {
        "payload": 1.5,
        "environment": frozenset({"terrestrial"}),
        "heat": pytest.approx(26.85),
        "limbs": 2,
        "legal": True,
        "chassis": "hull",
    }
    assert crane.live["battery"] == LiveAttribute(
        "battery", "fc", "battery", crane.live["battery"].span, 0.01, 0.0, None, "%"
    )
    assert (crane.live["north"].index, crane.live["north"].unit) == (0, "")
    lift = crane.serves["Lift"]
    assert lift.attributes == {"payload": 1.0}
    assert lift.when is not None
    assert lift.when.text == "legal && payload > 1"
    mapped = lift.portals["lift"]
    assert mapped.target == "reel"
    assert mapped.arguments == (
        Argument("height", factor=1000.0),
        Argument(constant=2),
        Argument(constant="fast"),
    )
    assert mapped.result == Argument(factor=0.01)


def test_unmapped_portal_is_served_by_the_same_name(write) -> None:
    mapped = good(write(CRANE)).providers["Crane"].serves["Grip"].portals["grip"]
    assert (mapped.target, mapped.arguments, mapped.result) == ("grip", (), None)


def test_alias_of_a_term_means_the_term(write) -> None:
    text = "registry: 1\nprimitives:\n  Raise: {id: skill.raising, portals: {up: {}}}\n"
    assert good(write(text)).primitives["Raise"].id == "skill.lifting"


def test_deprecated_term_is_replaced_with_a_warning(write) -> None:
    text = "registry: 1\nprimitives:\n  Raise: {id: skill.hoisting, portals: {up: {}}}\n"
    registry, found = check_files([BASE, write(text)])
    assert registry is not None
    assert registry.primitives["Raise"].id == "skill.lifting"
    assert [(d.severity, d.hint) for d in found] == [("warning", "write skill.lifting")]


def test_alias_of_a_deprecated_term_is_replaced(write) -> None:
    text = (
        "registry: 1\ntaxonomy:\n  skill.heaving: {aliases: [skill.hauling], deprecated: skill.raising}\n"
        "primitives:\n  Haul: {id: skill.hauling, portals: {up: {}}}\n"
    )
    assert good(write(text)).primitives["Haul"].id == "skill.lifting"


GENTLE = """
registry: 1
taxonomy:
  skill.lifting.gentle: {}
  skill.lifting.gentle.slow: {}
primitives:
  LiftGently:
    id: skill.lifting.gentle
    portals:
      lift: {parameters: {how_far: {type: real, unit: m}}, emit: real, unit: m}
      rest: {}
  LiftSlowly:
    id: skill.lifting.gentle.slow
    portals:
      lift: {parameters: {height: {type: real, unit: m}}, emit: real, unit: m}
  LiftByTime:
    id: skill.lifting.gentle
    portals:
      lift: {parameters: {time: {type: real, unit: s}}, emit: real, unit: m}
"""


def test_specific_primitive_serves_the_general_one(write) -> None:
    rules = good(write(GENTLE)).equivalences
    # LiftSlowly lacks a portal of LiftGently; LiftByTime has another meaning for the same portal name.
    assert set(rules) == {"LiftGently-is-Lift", "LiftSlowly-is-Lift"}
    rule = rules["LiftGently-is-Lift"]
    assert (rule.serves, rule.by, rule.loss, rule.when) == ("Lift", "LiftGently", 0.0, None)
    assert rule.portals["lift"].arguments == (Argument("height"),)
    assert rule.portals["lift"].target == "lift"
    assert realisations.equivalent(rule.name) == "as_LiftGently_is_Lift"


def test_mission_file_extends_the_shipped_registry(write) -> None:
    mission = write(
        """
registry: 1
taxonomy:
  skill.lifting: {aliases: [skill.heaving]}
  skill.sewing: {}
attributes:
  payload: {type: real, unit: kg, better: more, typical: 2.0, meaning: said again}
  depth: {type: real}
providers:
  Crane:
    attributes: {payload: 3.0}
    live: {battery: other.charge}
    serves: {Lift: {portals: {lift: heave}}}
  Ours: {serves: {Grip: {}}}
agents:
  arm2: {payload: "1200 g"}
ranking:
  weights: {loss: 9.0}
  attributes: {payload: 3.0}
""",
        "m.capabilities.yaml",
    )
    registry = good(write(CRANE), mission=mission)
    crane = registry.providers["Crane"]
    assert crane.include == "can/crane.L"
    assert (crane.attributes["payload"], crane.attributes["limbs"]) == (3.0, 2)
    assert (crane.live["battery"].device, crane.live["north"].device) == ("other", "fc")
    assert crane.serves["Lift"].portals["lift"].target == "heave"
    assert crane.serves["Lift"].when is None
    assert "Grip" in crane.serves
    assert "Ours" in registry.providers
    assert registry.agents == {"arm2": {"payload": 1.2}}
    assert registry.weights == Weights(loss=9.0, attributes={"payload": 3.0})
    assert registry.terms["skill.lifting"].aliases == ("skill.raising", "skill.heaving")


def test_mission_replaces_a_rule(write) -> None:
    rule = "{serves: Lift, by: Climb, portals: {lift: {portal: climb, emit: {parameter: height}}}, loss: %s}"
    path = write(f"registry: 1\nequivalences:\n  up: {rule % 0.1}\n")
    source = GOLDEN / "L" / "grip_and_climb.L"
    mission = write(
        "registry: 1\nequivalences:\n  up:\n    serves: Lift\n    needs: {a: {capability: Grip}}\n"
        f"    through: Up\n    source: {source}\n",
        "m.capabilities.yaml",
    )
    assert good(path).equivalences["up"].loss == 0.1
    registry = good(path, mission=mission)
    assert registry.equivalences == {}
    assert registry.compositions["up"].source == source


def test_errors_in_an_expression_are_located_in_the_file(write) -> None:
    text = """registry: 1
providers:
  A: {serves: {Lift: {when: payload >= 1 && paylod < 3}}}
  B: {serves: {Lift: {when: "payload >= 1 && paylod < 3"}}}
  C: {serves: {Lift: {when: 'payload >= 1 && paylod < 3'}}}
  D: {serves: {Lift: {when: "payload >= 1 \\u0026& paylod < 3"}}}
"""
    _, found = check_files([BASE, write(text)])
    assert places_of(found) == [
        "C154 3:45 paylod",
        "C154 4:46 paylod",
        "C154 5:46 paylod",
        'C154 6:29 "payload >= 1 \\u0026& paylod < 3"',
    ]


def test_errors_of_all_files_are_reported_in_one_run(write) -> None:
    files = [
        write("registry: 1\ntaxonomy: {a.b: {}}\n", "a.yaml"),
        write("registry: 1\nproviders: {X: {serves: {Lfit: {}}, colour: red}}\n", "b.yaml"),
        write("registry: 1\nagents: {a: {payload: &x 3}}\n", "c.yaml"),
        write("registry: 1\nagents: {a: {payload: x}, b: {payload: 3 m}}\n", "d.yaml"),
    ]
    with pytest.raises(ProgramError) as error:
        read_registry([BASE, *files])
    assert [d.code for d in error.value.diagnostics] == ["C110", "C130", "Y111", "Y103", "C121", "C124"]


def test_missing_registry_file_is_an_input_file_error(tmp_path: Path) -> None:
    with pytest.raises(InputFileError):
        read_registry([tmp_path / "none.yaml"])


def test_shipped_registry_has_no_diagnostics() -> None:
    registry, found = check_files()
    assert [d.render() for d in found] == []
    assert registry is not None
    assert shipped()


# --- digest -------------------------------------------------------------------------------------------


def test_digest_ignores_notation_and_order_of_files(write) -> None:
    digest = good(write(CRANE)).digest
    assert len(digest) == 32
    same = "# a comment\n" + CRANE.replace("include:", "meaning: it lifts\n    include:").replace(
        '"1500 g"', "1.5"
    )
    assert good(write(same, "same.yaml")).digest == digest
    more = write(GENTLE, "gentle.yaml")
    assert good(write(CRANE), more).digest == good(more, write(CRANE)).digest


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"1500 g"', '"1501 g"'),
        ("limbs: 2, ", ""),
        ("payload > 1", "payload > 2"),
        ("portal: reel", "portal: haul"),
        ("unit: cm", "unit: m"),
        ("position[0]", "position[1]"),
        ('unit: "%"', 'unit: ""'),
        ("      Grip:\n", ""),
        ("constant: fast", "constant: slow"),
    ],
)
def test_digest_changes_when_answers_change(write, old: str, new: str) -> None:
    assert old in CRANE
    assert good(write(CRANE)).digest != good(write(CRANE.replace(old, new), "other.yaml")).digest


def test_digest_depends_on_the_order_of_needs(write) -> None:
    def rule(needs: str) -> str:
        source = GOLDEN / "L" / "grip_and_climb.L"
        return (
            f"registry: 1\nequivalences:\n  both: {{serves: Lift, needs: {{{needs}}}, through: Both, "
            f"source: {source}}}\n"
        )

    one = rule("a: {capability: Grip}, b: {capability: Climb}")
    two = rule("b: {capability: Climb}, a: {capability: Grip}")
    assert good(write(one, "one.yaml")).digest != good(write(two, "two.yaml")).digest


# --- places -------------------------------------------------------------------------------------------


def test_finding_is_rendered_with_a_caret_and_a_hint(write) -> None:
    path = write("registry: 1\nproviders:\n  Crane: {attributes: {paylod: 3}}\n")
    _, found = check_files([BASE, path])
    assert [d.render() for d in found] == [
        f"{path}:3:24: error[C120]: there is no attribute 'paylod'\n"
        "      Crane: {attributes: {paylod: 3}}\n"
        "                           ^~~~~~\n"
        "    hint: did you mean 'payload'?"
    ]


def test_method_names_of_offers_are_reserved_for_portals():
    offer = parse_file(prelude(), Diagnostics()).units[0]
    assert {method.name for method in offer.methods if method.public} == OFFER_METHODS
