"""Without a devices file, every resource of a driver runs on a fake of the correct kind."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from lfield.clock import SystemClock
from lfield.driver.plugins import discover
from lfield.errors import BindingError
from lfield.mission import bundle
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.operator.diagnostics import DiagnosticFinding, endpoints

ROOT = Path(__file__).parents[2]
#: `driver/file.L` of every shipped resource.
STOCK = sorted(
    f"{file.parts[-3].removeprefix('lfield_')}/{file.name}" for file in ROOT.glob("drivers/*/L/*.L")
)
#: The kind that a fake must report, for a driver with several kinds.
KINDS = {"mavlink/copter.L": "copter", "mavlink/rover.L": "rover"}


def mission(folder: Path, program: str, resource: str) -> Mission:
    """A mission with one agent without bindings, on fakes."""
    (folder / "m.L").write_text(program, encoding="utf-8")
    (folder / "m.dL").write_text(f"//{resource}:one@alpha\n", encoding="utf-8")
    return load_mission(folder / "m.dL", simulate=True)


def stock_mission(folder: Path, include: str) -> Mission:
    """The mission of a shipped resource, which is named like its file."""
    return mission(folder, f"include <{include}>;\n", Path(include).stem.title().replace("_", ""))


@pytest.mark.process
@pytest.mark.few(2)
@pytest.mark.parametrize("include", STOCK)
def test_stock_resource_opens_on_a_fake_of_its_kind(tmp_path: Path, include: str) -> None:
    found: list[DiagnosticFinding] = []
    devices = stock_mission(tmp_path, include).bindings.all
    asyncio.run(endpoints(discover(), devices, SystemClock(), found.append))
    assert [finding.what for finding in found if finding.state != "ok"] == []
    assert len(found) == len(devices)
    assert KINDS.get(include, "") in found[0].what


def test_bundle_keeps_the_kind_of_a_fake(tmp_path: Path) -> None:
    """A robot has no L files and no manifests; the bundle contains the necessary data."""
    built = stock_mission(tmp_path, "mavlink/rover.L")
    read = bundle.decode(bundle.encode(built))
    unbound = read.with_bindings(type(read.bindings)()).on_fakes()
    (device,) = unbound.bindings.all
    assert device.option("kind") == "rover"


@pytest.mark.parametrize(
    ("resource", "device", "words"),
    [
        (
            "Rover",
            "Mavlink",
            "one.d: simulated with kind rover; to change this, bind the device in a devices file",
        ),
        (
            "Boat",
            "Mavlink",
            "one.d: the kind of a Boat is not known, so it is simulated with kind copter; "
            "to change this, bind the device in a devices file",
        ),
        (
            "Hoist",
            "CanAxis",
            "one.d: simulated with protocol cia402, node 1, counts 4096, homing_method 37; "
            "to change this, bind the device in a devices file",
        ),
    ],
)
def test_chosen_fake_is_reported_once(tmp_path: Path, resource: str, device: str, words: str) -> None:
    built = mission(tmp_path, f"resource {resource} {{ {device} d; init(string[] arg) {{ }} }}\n", resource)
    assert built.warnings == (words,)
    assert bundle.decode(bundle.encode(built)).on_fakes().warnings == (words,)


def test_bound_device_gives_no_warning(tmp_path: Path) -> None:
    (tmp_path / "m.devices.yaml").write_text(
        "agents: {one: {devices: {d: {driver: mavlink, kind: rover}}}}\n", encoding="utf-8"
    )
    assert mission(tmp_path, "resource Boat { Mavlink d; init(string[] arg) { } }\n", "Boat").warnings == ()


def test_missing_option_without_default_is_an_error(tmp_path: Path) -> None:
    program = "resource Jaw { CanSignals jaw; init(string[] arg) { } }\n"
    with pytest.raises(BindingError) as error:
        mission(tmp_path, program, "Jaw")
    assert str(error.value) == "one.jaw (CanSignals) needs dbc also when simulated: bind it in a devices file"
