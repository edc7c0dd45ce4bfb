"""The registry of a mission: read when its program names a capability, the same on all hosts."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.bytecode.encoding import encode
from lfield.errors import ProgramError
from lfield.mission.loader import check_file, compile_file, load_mission

CRANE = """
resource Crane {
    init(string[] arg) { while (true) yield(); }
    portal hoist(real height) emit real { return height; }
}
"""
PLAIN = CRANE + "coordinator Boss { init(string[] arg) { Crane[] all = findCrane(); } }"
ASKING = CRANE + 'coordinator Boss { init(string[] arg) { Lift[] who = findLift("payload > 1.0"); } }'
DEPLOYMENT = "//Crane:small@a\n//Boss:boss@b\n"
CAPABILITIES = """
registry: 1
providers:
  Crane:
    attributes: {payload: 50.0}
    serves: {Lift: {portals: {lift: hoist, lower: hoist}}}
agents:
  small: {payload: 1.5}
"""
DEVICES = """
agents:
  small:
    devices:
      boom: {driver: dynamixel, endpoint: "serial:/dev/ttyUSB0:57600", id: 1}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for ending, text in {".L": ASKING, ".dL": DEPLOYMENT, ".capabilities.yaml": CAPABILITIES}.items():
        (tmp_path / f"mission{ending}").write_text(text)
    return tmp_path


def write(folder: Path, ending: str, text: str) -> None:
    (folder / f"mission{ending}").write_text(text)


def codes(caught: pytest.ExceptionInfo[ProgramError]) -> list[str]:
    return [d.code for d in caught.value.diagnostics]


def test_a_mission_joins_its_own_registry_with_the_packaged_one(folder: Path) -> None:
    registry = load_mission(folder / "mission.dL").registry
    assert registry is not None
    assert registry.agents["small"] == {"payload": 1.5}
    assert {"Crane", "Copter", "Winch"} <= registry.providers.keys()


def test_without_a_capability_in_the_program_the_mission_has_no_registry(folder: Path) -> None:
    write(folder, ".L", PLAIN)
    assert load_mission(folder / "mission.dL").registry is None
    assert check_file(folder / "mission.L") == []


def test_a_wrong_registry_is_reported_even_if_it_is_not_used(folder: Path) -> None:
    write(folder, ".L", PLAIN)
    write(folder, ".capabilities.yaml", "no registry: at all")
    with pytest.raises(ProgramError):
        load_mission(folder / "mission.dL")


def test_a_compiled_program_has_the_registry_too(folder: Path) -> None:
    compiled = folder / "mission.lb"
    compiled.write_bytes(encode(compile_file(folder / "mission.L")[0]))
    (folder / "mission.L").unlink()
    mission = load_mission(folder / "mission.dL", compiled)
    assert mission.registry is not None
    assert mission.registry.agents.keys() == {"small"}


def test_another_registry_file_may_be_given(folder: Path) -> None:
    other = folder / "other.yaml"
    other.write_text(CAPABILITIES.replace("payload: 1.5", "payload: 2.5"))
    here, there = load_mission(folder / "mission.dL"), load_mission(folder / "mission.dL", capabilities=other)
    assert here.registry is not None
    assert there.registry is not None
    assert there.registry.agents["small"] == {"payload": 2.5}
    assert here.registry.digest != there.registry.digest
    assert here.program.digest == there.program.digest


def test_errors_of_the_registry_are_errors_of_the_mission(folder: Path) -> None:
    write(folder, ".capabilities.yaml", CAPABILITIES.replace("  small:", "  smal:").replace("50.0", "heavy"))
    with pytest.raises(ProgramError) as error:
        load_mission(folder / "mission.dL")
    assert len(codes(error)) == 2
    assert all(code.startswith("C") for code in codes(error))
    assert [d.code for d in check_file(folder / "mission.L")] == codes(error)


def test_a_missing_portal_is_reported_where_the_registry_names_it(folder: Path) -> None:
    write(folder, ".capabilities.yaml", CAPABILITIES.replace("lift: hoist", "lift: raise"))
    with pytest.raises(ProgramError) as error:
        load_mission(folder / "mission.dL")
    (found,) = error.value.diagnostics
    assert Path(found.span.source.name).name == "mission.capabilities.yaml"
    assert "Crane" in found.message


async def test_a_hello_has_the_digest_of_the_registry(team, /) -> None:
    asking = team.mission(ASKING, DEPLOYMENT, capabilities=CAPABILITIES)
    plain = team.mission(PLAIN, DEPLOYMENT, name="plain")
    assert team.make(asking, "a").host.hello().registry == asking.registry.digest
    assert team.make(plain, "a").host.hello().registry == b""


def test_live_attributes_are_converted_to_their_units(folder: Path) -> None:
    """A servo reports radians; the attribute of this mission is in degrees."""
    turning = (CRANE + "coordinator").replace("resource Crane {", "resource Crane { Dynamixel boom;", 1)
    write(folder, ".L", ASKING.replace(CRANE + "coordinator", turning))
    write(folder, ".devices.yaml", DEVICES)
    attribute = "attributes: {boom: {type: real, unit: deg, live: true}}\n"
    live = CAPABILITIES.replace("    attributes:", "    live: {boom: boom.position}\n    attributes:")
    write(folder, ".capabilities.yaml", live + attribute)
    registry = load_mission(folder / "mission.dL").registry
    assert registry is not None
    assert registry.providers["Crane"].live["boom"].factor == pytest.approx(57.29578)


def test_a_live_attribute_of_an_unknown_device_is_refused(folder: Path) -> None:
    write(
        folder,
        ".capabilities.yaml",
        CAPABILITIES.replace("    attributes:", "    live: {fault: x.fault}\n    attributes:"),
    )
    with pytest.raises(ProgramError) as error:
        load_mission(folder / "mission.dL")
    assert codes(error) == ["C172"]
