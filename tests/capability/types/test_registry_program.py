"""The shipped registry compared with the shipped resources and manifests."""

from __future__ import annotations

from pathlib import Path

import pytest
from registry_expectations import BASE, ROVER

from lfield.bytecode.encoding import encode
from lfield.capability.model import Registry
from lfield.capability.program_types.live_units import convert_live_units
from lfield.capability.program_types.program_check import check_against, check_classes, satisfied
from lfield.capability.registry_reader.registry_files import check_files, read_registry
from lfield.capability.registry_reader.unit_signatures import Signature, signatures_of
from lfield.driver.plugins import discover
from lfield.errors import ProgramError
from lfield.lang.parser import parse_file
from lfield.mission.loader import compile_file, load_mission
from lfield.text.source_text import Diagnostics, Source
from lfield.units import is_unit

SOURCES = sorted(Path(__file__).parents[3].glob("drivers/*/L/*.L"))

PROGRAM = """
resource Crane {
    Rover fc;
    int count;

    init(string port) { }

    portal reel(real millimetres) emit int { return 1; }
    portal reel(string far) { }
    portal grip() { }
    private void secret() { }
}

class Both coordinator specific {
    private Grip hand;

    public Both(Grip hand) { this.hand = hand; }
    public Both() { }
    public real lift(real height) { return height; }
    private void lower() { }
}
"""


def signatures(text: str = PROGRAM) -> dict[str, Signature]:
    found = Diagnostics()
    units = signatures_of([parse_file(Source("program.L", text), found)])
    assert [d.render() for d in found.found] == []
    return units


def registry_of(tmp_path: Path, provider: str) -> Registry:
    path = tmp_path / "registry.yaml"
    path.write_text(f"registry: 1\nproviders:\n  Crane: {provider}\n", encoding="utf-8")
    registry, found = check_files([BASE, path])
    assert [d.render() for d in found] == []
    assert registry is not None
    return registry


def test_signatures_of_a_program() -> None:
    units = signatures()
    assert units["Crane"] == Signature(
        "Crane",
        {"reel": [(("real",), "int"), (("string",), "void")], "grip": [((), "void")]},
        {"fc": "Rover", "count": "int"},
        [],
        "resource",
        "resource",
    )
    assert units["Both"] == Signature(
        "Both", {"lift": [(("real",), "real")]}, {}, [("Grip",), ()], "class", "coordinator"
    )


@pytest.mark.parametrize(
    ("mapped", "codes"),
    [
        ("reel", []),
        ("{portal: reel, arguments: [{parameter: height, unit: mm}], emit: {unit: mm}}", []),
        ("{portal: reel, arguments: [2]}", []),
        ("{portal: reel, arguments: [{constant: far}], emit: {parameter: height}}", []),
        ("{portal: reel, arguments: [{constant: far}]}", ["C146"]),
        ("{portal: reel, arguments: [true]}", ["C171"]),
        ("{portal: reel, arguments: []}", ["C171"]),
        ("{portal: secret, arguments: []}", ["C170"]),
        ("{portal: grip, arguments: [], emit: {constant: 1}}", []),
        ("{portal: grip, arguments: [], emit: {constant: true}}", ["C146"]),
        ("{portal: grip, arguments: [], emit: {unit: m}}", ["C146"]),
    ],
)
def test_mapped_call_is_checked_against_the_program(tmp_path: Path, mapped: str, codes: list[str]) -> None:
    registry = registry_of(tmp_path, f"{{serves: {{Lift: {{portals: {{lift: {mapped}}}}}}}}}")
    found = Diagnostics()
    check_against(registry, signatures(), found)
    assert [d.code for d in found.in_order()] == codes


def test_live_attribute_is_converted_from_the_unit_of_its_manifest(tmp_path: Path) -> None:
    registry = registry_of(
        tmp_path, "{live: {battery: fc.battery, heat: {from: fc.heat, unit: K}, down: 'fc.position[2]'}}"
    )
    found = Diagnostics()
    settled = convert_live_units(registry, {"Crane": {"fc": "Rover"}}, {"Rover": ROVER}, found)
    assert found.found == []
    live = settled.providers["Crane"].live
    assert {name: (source.factor, source.offset) for name, source in live.items()} == {
        "battery": (0.01, 0.0),
        "heat": (1.0, -273.15),
        "down": (1.0, 0.0),
    }
    # The unit in the file takes precedence over the manifest; types of other programs are unchanged.
    assert convert_live_units(registry, {}, {}, found) == registry


def test_live_attribute_of_an_unknown_device_is_dropped_with_a_finding(tmp_path: Path) -> None:
    registry = registry_of(tmp_path, "{live: {battery: fc.battery, heat: other.heat}}")
    found = Diagnostics()
    settled = convert_live_units(registry, {"Crane": {"fc": "Rover"}}, {"Rover": ROVER}, found)
    assert list(settled.providers["Crane"].live) == ["battery"]
    assert [d.code for d in found.found] == ["C172"]


def test_every_unit_of_a_driver_is_known() -> None:
    devices = discover().device_types.values()
    reported = {quantity.unit for device in devices for quantity in device.telemetry}
    units = {p.unit for device in devices for i in device.instructions for p in i.parameters}
    assert [unit for unit in reported | units if not is_unit(unit)] == []
    assert "°C" in reported


def test_shipped_registry_fits_the_shipped_resources() -> None:
    registry, found = read_registry(), Diagnostics()
    files = [parse_file(Source(str(path), path.read_text(encoding="utf-8")), found) for path in SOURCES]
    units = signatures_of(files)
    check_against(registry, units, found)
    check_classes(registry, found)
    devices = {name: unit.devices for name, unit in units.items() if unit.kind == "resource"}
    convert_live_units(registry, devices, discover().device_types, found)
    assert [d.render() for d in found.in_order()] == []
    assert set(registry.providers) <= set(units)


#: A mission without queries; its registry file is checked all the same.
MISSION = """
resource Crane {
    init(string[] arg) { }
    portal reel(real millimetres) emit int { return 1; }
    portal level() emit string { return "full"; }
}
coordinator Boss { init(string[] arg) { } }
"""
RULE = """equivalences:
  by-two:
    serves: Haul
    needs: {one: Lift, other: Lift}
    through: Together
    source: together.L
"""


@pytest.mark.parametrize(
    ("added", "codes"),
    [
        ("providers: {Crane: {serves: {Photograph: {portals: {photograph: click}}}}}", ["C170"]),
        ("providers: {Crane: {serves: {Grip: {portals: {grip: level, release: level}}}}}", ["C146"]),
        ("providers: {Crane: {live: {battery: nothing()}}}", ["C178"]),
        ("providers: {Crane: {live: {battery: level()}}}", ["C174"]),
        (RULE, ["C156"]),
    ],
)
@pytest.mark.parametrize("compiled", [False, True])
def test_registry_of_a_mission_is_checked_without_queries(
    tmp_path: Path, added: str, codes: list[str], compiled: bool
) -> None:
    (tmp_path / "mission.L").write_text(MISSION)
    (tmp_path / "mission.dL").write_text("//Crane:crane@yard\n//Boss:boss@yard\n")
    (tmp_path / "together.L").write_text("class Together { }")
    program = tmp_path / "mission.lb" if compiled else None
    if program is not None:
        program.write_bytes(encode(compile_file(tmp_path / "mission.L")[0]))
    (tmp_path / "mission.capabilities.yaml").write_text(f"registry: 1\n{added}\n")
    with pytest.raises(ProgramError) as raised:
        load_mission(tmp_path / "mission.dL", program, simulate=True)
    assert [mistake.code for mistake in raised.value.diagnostics] == codes


def test_unsatisfied_entries_are_not_in_the_registry_of_the_hosts(tmp_path: Path) -> None:
    registry = registry_of(
        tmp_path,
        "{serves: {Lift: {portals: {lift: secret}}, Grip: {}}, live: {battery: gone()}}",
    )
    crane = satisfied(registry, signatures()).providers["Crane"]
    assert (list(crane.serves), dict(crane.live)) == (["Grip"], {})
    assert satisfied(registry, {}) == registry
