"""Capabilities as types of L: when the registry is read, the generated providers, and error positions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from lang_expectations import CAPABILITIES, REGISTRY

from lfield.capability.model import Registry
from lfield.capability.program_types import registry_types
from lfield.capability.program_types.class_generator import classes
from lfield.capability.program_types.registry_types import RegistryTypes
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.lang.frontend import CheckResult, check_text

CRANE = """
resource Crane {
    init(string[] arg) { }
    portal lift(real height) emit real { return height; }
    portal stop() { }
}
"""
BOSS = "coordinator Boss { init(string[] arg) { %s } }\n"


def never() -> Registry:
    raise AssertionError("the registry was read")


def checked(text: str, types: RegistryTypes = CAPABILITIES) -> CheckResult:
    return check_text(text, "team.L", capabilities=types)


def drawn(found: CheckResult) -> list[str]:
    return [d.render().split("\n")[0] for d in found.diagnostics]


def class_of(name: str, *resources: str) -> str:
    found = classes(CAPABILITIES.registry, [name], resources)
    return next(source.text for source in found if source.name == f"{name}.L")


def test_registry_is_not_read_without_a_capability_in_the_program() -> None:
    text = CRANE + BOSS % 'Crane c = findCrane("a"); find(); finder(); findPath(); Exception e = null;'
    own = "private void find() { } private void finder() { } private void findPath() { } init("
    text = text.replace("coordinator Boss { init(", "coordinator Boss { " + own)
    found = checked(text, RegistryTypes(never))
    assert drawn(found) == []


def test_capability_is_imported_by_its_type_or_a_query_alone() -> None:
    for body in ("Lift[] who;", "findLift();", "explainLift();", "Lift who = null;"):
        program = checked(CRANE + BOSS % body).or_raise()
        assert [unit.name for unit in program.units if unit.capability] == ["Lift"], body


def test_generated_class_is_readable_l() -> None:
    text = class_of("Lift", "Winch")
    assert text.startswith(
        "// Lift: raises a load by some height\n// Made from the registry (skill.lifting).\n"
    )
    assert (
        """
    // raises the load (m)
    // height (m): by how much
    public real lift(real height) {
        if (byWinch != null) {
            return byWinch.reel(height * 1000.0, 3, true, "slow") * 0.001;
        }
"""
        in text
    )
    assert "byCrane" not in text


def test_generated_class_has_only_the_available_providers() -> None:
    assert "as_climb_lifts" not in class_of("Lift", "Hand", "Claw")
    assert "as_climb_lifts" in class_of("Lift", "Copter")
    assert "of_grip_and_climb" not in class_of("Lift", "Copter")
    assert "of_grip_and_climb" in class_of("Lift", "Copter", "Claw")
    names = [source.name for source in classes(CAPABILITIES.registry, ["Lift"], ["Copter", "Claw"])]
    assert names == ["Climb.L", "FirmGrip.L", "Grip.L", "Lift.L"]
    generated = classes(CAPABILITIES.registry, ["Lift"], ["Copter", "Claw"], reserved=["Climb"])
    assert [source.name for source in generated] == ["Lift.L"]


def test_caret_is_below_the_characters_of_a_condition() -> None:
    (found,) = checked(CRANE + BOSS % 'findLift("payload > 1 && paylod < 3");').diagnostics
    assert found.render().split("\n") == [
        "team.L:7:66: error[L422]: there is no attribute 'paylod'",
        '    coordinator Boss { init(string[] arg) { findLift("payload > 1 && paylod < 3"); } }',
        " " * 69 + "^~~~~~",
        "    hint: did you mean 'payload'?",
    ]


def test_condition_with_escapes_is_underlined_completely() -> None:
    (found,) = checked(CRANE + BOSS % r'findLift("\u{70}aylod > 1");').diagnostics
    assert found.span.text == r'"\u{70}aylod > 1"'


def test_unknown_name_gets_a_similar_capability_as_hint() -> None:
    (unknown_type,) = checked(CRANE + BOSS % "Lft who = null;").diagnostics
    (unknown_find,) = checked(CRANE + BOSS % "explainLft();").diagnostics
    assert unknown_type.hint == "did you mean 'Lift'?"
    assert unknown_find.hint == "did you mean 'explainLift'?"


def test_class_named_offer_conflicts_with_queries() -> None:
    found = checked(CRANE + "class Offer { }\n" + BOSS % "findLift();")
    assert drawn(found) == ["team.L:7:7: error[L307]: 'Offer' is already declared in Offer.L, line 4"]
    assert drawn(checked("class Offer { }\n" + BOSS % "")) == []


def test_mission_registry_must_fit_its_program() -> None:
    found = checked(CRANE.replace("lift(", "hoist(") + BOSS % "findLift();")
    (line,) = drawn(found)
    assert line.startswith(f"{REGISTRY}:")
    assert "Crane" in line
    assert found.program is None


def test_shipped_provider_does_not_apply_to_another_type_of_its_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A program may define a Crane of its own that differs from the shipped one."""
    monkeypatch.setattr(
        registry_types, "is_shipped", lambda finding: finding.span.source.name == str(REGISTRY)
    )
    program = checked(CRANE.replace("lift(", "hoist(") + BOSS % "findLift();").or_raise()
    lift = next(unit for unit in program.units if unit.name == "Lift")
    assert [field.name for field in lift.fields] == ["facts"]


@pytest.fixture
def with_class(tmp_path: Path) -> Callable[[str], RegistryTypes]:
    """The registry with another text of the class that combines the parts."""

    def make(text: str) -> RegistryTypes:
        registry = tmp_path / "registry.yaml"
        registry.write_text(REGISTRY.read_text(encoding="utf-8"), encoding="utf-8")
        (tmp_path / "lifting_grip_and_climb.inc").write_text(text, encoding="utf-8")
        return RegistryTypes(lambda: read_registry([registry]))

    return make


PARTS = """
resource Copter { init(string[] arg) { } portal climb(real m) emit real { return m; } portal stop() { } }
resource Hand { init(string[] arg) { } portal grip() emit boolean { return true; } }
"""


def test_errors_in_the_class_of_a_rule_have_their_source_position(
    with_class: Callable[[str], RegistryTypes],
) -> None:
    good = REGISTRY.with_name("lifting_grip_and_climb.inc").read_text(encoding="utf-8")
    text = PARTS + BOSS % "findLift();"
    assert drawn(checked(text, with_class(good))) == []
    (bad,) = checked(text, with_class(good.replace("lifts + 1", "lifst + 1"))).diagnostics
    assert Path(bad.span.source.name).name == "lifting_grip_and_climb.inc"
    assert (bad.code, bad.span.text) == ("L301", "lifst")


def test_class_of_a_rule_may_use_more_capabilities(
    with_class: Callable[[str], RegistryTypes],
) -> None:
    good = REGISTRY.with_name("lifting_grip_and_climb.inc").read_text(encoding="utf-8")
    more = good.replace("lifts = lifts + 1;", "lifts = lifts + findFirmGrip().length();")
    program = checked(PARTS + BOSS % "findLift();", with_class(more)).or_raise()
    units = sorted(unit.name for unit in program.units if unit.capability)
    assert units == ["Climb", "FirmGrip", "Grip", "Lift"]
