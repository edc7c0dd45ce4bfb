"""The hosts for which a new start does not wait: from the devices file into the bundle."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from lfield.errors import BindingError, BundleError
from lfield.mission import bundle
from lfield.mission.bindings import MissionStart
from lfield.mission.loader import load_mission

PROGRAM = """
resource Post { init(string[] arg) { } portal say() { } }
coordinator Boss { init(string[] arg) { findPost("p0").say(); } }
"""


def write(folder: Path, start: str = "") -> Path:
    (folder / "m.L").write_text(PROGRAM)
    (folder / "m.dL").write_text("//Post:p0@h0\n//Post:p1@h1\n//Boss:boss@h2\n//@h3\n")
    if start:
        (folder / "m.devices.yaml").write_text(f"start: {start}\n")
    return folder / "m.dL"


@pytest.mark.parametrize(
    ("written", "told", "hint"),
    [
        ("{without: [h1, h7]}", "the deployment has no host 'h7'", "h0"),
        ("{without: [h1, h1]}", "'h1' is named twice", "name it once"),
        ("{without: h1}", "'without' must be a list", ""),
        ("{without: [2]}", "'without' must be a list of texts, not the number 2", ""),
        ("{witout: [h1]}", "'start' has no key 'witout'", "without"),
        ("[h1]", "'start' must be a mapping", ""),
    ],
)
def test_mistakes_in_the_start_section_are_reported_at_their_place(
    tmp_path: Path, written: str, told: str, hint: str
) -> None:
    with pytest.raises(BindingError) as error:
        load_mission(write(tmp_path, written))
    (finding,) = error.value.problems
    assert told in finding
    assert "m.devices.yaml:1:" in finding
    assert "error[Y11" in finding
    assert hint in finding


def test_the_start_section_is_in_the_bundle_and_its_digest(tmp_path: Path) -> None:
    plain = load_mission(write(tmp_path))
    mission = load_mission(write(tmp_path, "{without: [h1]}"))
    data = bundle.encode(mission)
    assert bundle.decode(data).bindings.start == MissionStart(("h1",))
    assert bundle.contents(data).digest != bundle.contents(bundle.encode(plain)).digest
    assert mission.on_fakes().bindings.start.without == ("h1",)
    assert mission.team.hosts_with_resources == ("h0", "h1")


@pytest.mark.parametrize("without", [("h9",), ("h1", "h1")])
def test_a_bundle_with_an_invalid_start_section_is_refused(tmp_path: Path, without: tuple[str, ...]) -> None:
    mission = load_mission(write(tmp_path))
    changed = mission.with_bindings(replace(mission.bindings, start=MissionStart(without)))
    with pytest.raises(BundleError, match="'start: without' has hosts that are not in the team"):
        bundle.decode(bundle.encode(changed))
