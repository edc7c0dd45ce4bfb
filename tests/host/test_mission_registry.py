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


def test_a_mission_joins_its_own_file_to_what_we_ship(folder: Path) -> None:
    registry = load_mission(folder / "mission.dL").registry
    assert registry is not None
    assert registry.agents["small"] == {"payload": 1.5}
    assert {"Crane", "Copter", "Winch"} <= registry.providers.keys()


def test_without_a_capability_in_the_program_the_mission_has_no_registry(folder: Path) -> None:
    write(folder, ".L", PLAIN)
    assert load_mission(folder / "mission.dL").registry is None
    assert check_file(folder / "mission.L") == []


def test_a_wrong_registry_beside_a_mission_is_told_though_nothing_asks_it(folder: Path) -> None:
    write(folder, ".L", PLAIN)
    write(folder, ".capabilities.yaml", "no registry: at all")
    with pytest.raises(ProgramError):
        load_mission(folder / "mission.dL")


def test_a_program_file_has_the_registry_too(folder: Path) -> None:
    compiled = folder / "mission.lb"
    compiled.write_bytes(encode(compile_file(folder / "mission.L")[0]))
    (folder / "mission.L").unlink()
    mission = load_mission(folder / "mission.dL", compiled)
    assert mission.registry is not None
    assert mission.registry.agents.keys() == {"small"}


def test_another_file_may_be_given(folder: Path) -> None:
    other = folder / "other.yaml"
    other.write_text(CAPABILITIES.replace("payload: 1.5", "payload: 2.5"))
    here, there = load_mission(folder / "mission.dL"), load_mission(folder / "mission.dL", capabilities=other)
    assert here.registry is not None
    assert there.registry is not None
    assert there.registry.agents["small"] == {"payload": 2.5}
    assert here.registry.digest != there.registry.digest
    assert here.program.digest == there.program.digest


def test_mistakes_in_the_registry_are_those_of_the_mission(folder: Path) -> None:
    write(folder, ".capabilities.yaml", CAPABILITIES.replace("  small:", "  smal:").replace("50.0", "heavy"))
    with pytest.raises(ProgramError) as caught:
        load_mission(folder / "mission.dL")
    assert len(codes(caught)) == 2
    assert all(code.startswith("C") for code in codes(caught))
    assert [d.code for d in check_file(folder / "mission.L")] == codes(caught)


def test_a_portal_that_the_resource_does_not_have_is_told_where_it_is_promised(folder: Path) -> None:
    write(folder, ".capabilities.yaml", CAPABILITIES.replace("lift: hoist", "lift: raise"))
    with pytest.raises(ProgramError) as caught:
        load_mission(folder / "mission.dL")
    (found,) = caught.value.diagnostics
    assert Path(found.span.source.name).name == "mission.capabilities.yaml"
    assert "Crane" in found.message


async def test_a_host_greets_with_its_registry(team, /) -> None:
    asking = team.mission(ASKING, DEPLOYMENT, capabilities=CAPABILITIES)
    plain = team.mission(PLAIN, DEPLOYMENT, name="plain")
    assert team.make(asking, "a").host.hello().registry == asking.registry.digest
    assert team.make(plain, "a").host.hello().registry == b""


def test_live_attributes_come_in_their_own_units(folder: Path) -> None:
    """A servo tells radians; the attribute of this mission is in degrees."""
    turning = (CRANE + "coordinator").replace("resource Crane {", "resource Crane { Dynamixel boom;", 1)
    write(folder, ".L", ASKING.replace(CRANE + "coordinator", turning))
    write(folder, ".devices.yaml", DEVICES)
    attribute = "attributes: {boom: {type: real, unit: deg, live: true}}\n"
    live = CAPABILITIES.replace("    attributes:", "    live: {boom: boom.position}\n    attributes:")
    write(folder, ".capabilities.yaml", live + attribute)
    registry = load_mission(folder / "mission.dL").registry
    assert registry is not None
    assert registry.providers["Crane"].live["boom"].factor == pytest.approx(57.29578)


def test_a_mission_that_names_no_device_of_its_program_is_refused(folder: Path) -> None:
    write(
        folder,
        ".capabilities.yaml",
        CAPABILITIES.replace("    attributes:", "    live: {fault: x.fault}\n    attributes:"),
    )
    with pytest.raises(ProgramError) as caught:
        load_mission(folder / "mission.dL")
    assert codes(caught) == ["C172"]
