"""Registry files of a driver's package, and providers without a resource type."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.capability.registry_reader.registry_files import check_files, read_registry
from lfield.cli.main import main
from lfield.driver.plugin import Plugin
from lfield.driver.plugins import InstalledPlugin, Plugins
from lfield.errors import ProgramError
from lfield.mission import loader, registry_check
from lfield.mission.loader import load_mission

PROGRAM = """include <hall/lorry.L>;
coordinator Shift {
    init(string[] arg) {
        Lift[] who = findLift("payload >= 400.0");
        if (who.length() > 0) who[0].lift(0.5);
    }
}
"""
LORRY = """resource Lorry {
    init(string[] arg) { while (true) yield(); }
    portal synchronized raise(real metres) emit real { return metres; }
}
"""
REGISTRY = """registry: 1
providers:
  Lorry:
    include: hall/lorry.L
    attributes: {payload: 2 t}
    serves: {Lift: {portals: {lift: {portal: raise, arguments: [height]}, lower: raise}}}
"""


@pytest.fixture
def hall(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The package of a driver with a resource type and a registry file for it."""
    package = tmp_path / "lfield_hall"
    (package / "L").mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "L" / "lorry.L").write_text(LORRY)
    (package / "capabilities.yaml").write_text(REGISTRY)
    monkeypatch.syspath_prepend(str(tmp_path))
    plugin = Plugin("hall", "lfield_hall", "lfield_hall.driver:None", manifests=())
    known = Plugins({"hall": InstalledPlugin("hall", "lfield_hall:PLUGIN", {}, {}, "", plugin=plugin)})
    for module in (loader, registry_check):
        monkeypatch.setattr(module, "discover", lambda: known)
    folder = tmp_path / "mission"
    folder.mkdir()
    (folder / "m.L").write_text(PROGRAM)
    (folder / "m.dL").write_text("//Lorry:blue@hall\n//Shift:shift@hall\n")
    return folder


def test_registry_of_a_driver_applies_to_every_mission(hall: Path) -> None:
    registry = load_mission(hall / "m.dL").registry
    assert registry is not None
    assert registry.providers["Lorry"].attributes == {"payload": 2000.0}


def test_mission_overrides_the_registry_of_a_driver(hall: Path) -> None:
    (hall / "m.capabilities.yaml").write_text(
        "registry: 1\nproviders: {Lorry: {attributes: {payload: 5.0}}}\n"
    )
    registry = load_mission(hall / "m.dL").registry
    assert registry is not None
    assert registry.providers["Lorry"].attributes == {"payload": 5.0}


def test_two_drivers_that_define_one_type_are_reported(hall: Path) -> None:
    package = hall.parent / "lfield_hall" / "capabilities.yaml"
    other = hall / "capabilities.yaml"
    other.write_text(REGISTRY)
    _, found = check_files(libraries=[package, other])
    assert [finding.code for finding in found] == ["C104"]


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["Lory", "lorry", "LORRY"])
def test_provider_without_a_resource_type_is_an_error(hall: Path, name: str, capsys) -> None:
    mission = hall / "m.capabilities.yaml"
    mission.write_text(f"registry: 1\nproviders: {{{name}: {{attributes: {{payload: 5.0}}}}}}\n")
    with pytest.raises(ProgramError) as error:
        load_mission(hall / "m.dL")
    assert [finding.code for finding in error.value.diagnostics] == ["C102" if name == "lorry" else "C175"]
    assert main(["check", str(hall / "m.dL"), str(hall / "m.L"), f"{hall}/../mission/m.dL"]) == 65
    assert capsys.readouterr().err.count("error[") == 1
    assert main(["capabilities", "check", str(mission)]) == 65


def test_unknown_include_is_an_error(hall: Path) -> None:
    mission = hall / "m.capabilities.yaml"
    mission.write_text("registry: 1\nproviders: {Barge: {include: hall/barge.L}}\n")
    with pytest.raises(ProgramError) as error:
        load_mission(hall / "m.dL")
    assert [finding.code for finding in error.value.diagnostics] == ["C176"]


def test_stock_registry_includes_existing_files() -> None:
    from lfield.driver.plugins import discover

    plugins = discover()
    includes = {p.include for p in read_registry().providers.values() if p.include}
    assert includes
    assert [path for path in includes if plugins.find_source(path) is None] == []
