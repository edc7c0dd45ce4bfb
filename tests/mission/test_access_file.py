"""Access files: their rules, and a caret under every entry that fits no program, team or registry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.authority.identity import Right
from lfield.capability.model import Registry
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.cli.main import main
from lfield.errors import ProgramError, ReportableFinding
from lfield.mission import bundle
from lfield.mission.access.access_file import read_access
from lfield.mission.access.access_rules import (
    NO_RULES,
    Access,
    CallerRule,
    PersonRule,
    PortalRule,
    decode_access,
    encode_access,
)
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission

PROGRAM = """
resource Arm {
    init(string[] arg) { }
    portal home() { } portal grab(real width) { } portal grab() { } portal where() emit real { return 1.0; }
}
resource Winch {
    init(string[] arg) { }
    portal up(real height) emit real { return height; } portal down(real height) emit real { return height; }
    portal stow() { }
}
coordinator Boss { init(string[] arg) { } }
coordinator Relay { init(string[] arg) { } }
"""
DEPLOYMENT = """\
//Arm:arm1@alpha
//Arm:arm2@bravo
//Winch:winch@bravo
//Boss:boss@alpha
//Relay:one@alpha
//Relay:two@bravo
"""
CAPABILITIES = """
registry: 1
providers:
  Winch: {serves: {Lift: {portals: {lift: up, lower: down}}}}
"""
PAGE = """\
people:                            # less than their certificates say, never more
  anna: [observe, stop, operate]
  others: []
coordinators:
  boss:
    Arm: [home, grab]
    arm2: all
    Lift: [lift]
    others: []
  Relay: {Lift: all}
  others: all
"""


def deployed(folder: Path, text: str) -> Path:
    for ending, content in (
        (".L", PROGRAM),
        (".dL", DEPLOYMENT),
        (".capabilities.yaml", CAPABILITIES),
        (".access.yaml", text),
    ):
        (folder / f"mission{ending}").write_text(content)
    return folder / "mission.dL"


def loaded(folder: Path, text: str) -> Mission:
    return load_mission(deployed(folder, text))


@dataclass(frozen=True)
class Site:
    """The mission, compiled once, with any access file."""

    folder: Path
    mission: Mission

    @cached_property
    def registry(self) -> Registry:
        return read_registry(mission=self.folder / "mission.capabilities.yaml")

    def read(self, text: str) -> Access:
        path = self.folder / "mission.access.yaml"
        path.write_text(text, encoding="utf-8", newline="")
        return read_access(path, self.mission.team.members, self.mission.program, lambda: self.registry)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    folder = tmp_path_factory.mktemp("site")
    return Site(folder, loaded(folder, PAGE))


def test_rules_are_read_with_their_line_numbers(tmp_path: Path) -> None:
    assert loaded(tmp_path, PAGE).access == Access(
        "mission.access.yaml",
        (
            PersonRule("anna", (Right.OBSERVE, Right.STOP, Right.OPERATE), 2),
            PersonRule("others", (), 3),
        ),
        (
            CallerRule(
                "agent",
                "boss",
                5,
                (
                    PortalRule("type", "Arm", 6, ("home", "grab")),
                    PortalRule("agent", "arm2", 7),
                    # The calls of the winch that lift.
                    PortalRule("capability", "Lift", 8, (), {"Winch": ("up",)}),
                    PortalRule("others", "others", 9, ()),
                ),
            ),
            CallerRule(
                "type", "Relay", 10, (PortalRule("capability", "Lift", 10, (), {"Winch": ("up", "down")}),)
            ),
            CallerRule("others", "others", 11),
        ),
    )


CALLS = """\
calls:
  anna: {Arm: [home], arm2: all, Lift: [lift]}
  bob: all
  others: {}
assistants: [anna]
"""


def test_calls_of_persons_are_read_like_those_of_coordinators(tmp_path: Path) -> None:
    assert loaded(tmp_path, CALLS).access == Access(
        "mission.access.yaml",
        calls=(
            CallerRule(
                "person",
                "anna",
                2,
                (
                    PortalRule("type", "Arm", 2, ("home",)),
                    PortalRule("agent", "arm2", 2),
                    PortalRule("capability", "Lift", 2, (), {"Winch": ("up",)}),
                ),
            ),
            CallerRule("person", "bob", 3),
            CallerRule("others", "others", 4, ()),
        ),
        assistants=("anna",),
    )


def test_without_a_file_or_with_an_empty_one_there_are_no_rules(tmp_path: Path) -> None:
    empty = loaded(tmp_path, "# nothing yet\n")
    assert (empty.access, empty.calls) == (Access("mission.access.yaml"), None)
    (tmp_path / "mission.access.yaml").unlink()
    without = load_mission(tmp_path / "mission.dL")
    assert (without.access, without.calls) == (NO_RULES, None)


def test_the_registry_is_read_only_for_names_of_capabilities(tmp_path: Path) -> None:
    """The shipped registry takes time to read, and a mission that names no capability does not need it."""
    deploy = deployed(tmp_path, "coordinators: {boss: {Arm: all, winch: [stow], others: [where]}}\n")
    (tmp_path / "mission.capabilities.yaml").unlink()
    assert load_mission(deploy).registry is None


@pytest.mark.parametrize(
    ("text", "drawn", "said", "hint"),
    [
        ("people: {anna: [operat]}", "operat", "unknown right 'operat'", "did you mean 'operate'?"),
        ("people: {anna: [fly]}", "fly", "unknown right 'fly'", "rights here: observe, stop and operate"),
        (
            "people: {anna: [command]}",
            "command",
            "a mission cannot grant the right to sign it",
            "rights here",
        ),
        ("people: {anna: [3]}", "3", "a right is a name, not the number 3", "rights here"),
        ("people: {anna: stop}", "stop", "'anna' must be all or a list of rights", "write [stop]"),
        (
            "people: {anna: }",
            "",
            "'anna' must be all or a list of rights, not nothing",
            "[] means none of them",
        ),
        ('people: {"*": all}', '"*"', "'*' is not a name", "write others"),
        (
            'people: {"": all}',
            '""',
            "a person's name has 1 to 128 printable characters",
            "",
        ),
        ('people: {"an\\tna": all}', '"an\\tna"', "a person's name has 1 to 128", ""),
        ("people: [anna]", "[anna]", "'people' must be a mapping, not a list", ""),
        ("peple: {}", "peple", "an access file has no key 'peple'", "did you mean 'people'?"),
        ("coordinators: {bos: all}", "bos", "no coordinator 'bos'", "did you mean 'boss'?"),
        ("coordinators: {xyz: all}", "xyz", "no coordinator 'xyz'", "its coordinators: boss, one and two"),
        ("coordinators: {Arm: all}", "Arm", "no coordinator 'Arm', and none of such a type", ""),
        ('coordinators: {"*": all}', '"*"', "'*' is not a name", "write others"),
        ("coordinators: {boss: some}", "some", "'boss' must be all, or resources", "{Arm: [home]}"),
        ("coordinators: {boss: [home]}", "[home]", "with their portals, not a list", "{Arm: [home]}"),
        ("coordinators: {boss: {arm3: all}}", "arm3", "no resource 'arm3'", "did you mean 'Arm'?"),
        ("coordinators: {boss: {Lft: all}}", "Lft", "such type or capability", "did you mean 'Lift'?"),
        ("coordinators: {boss: {boss: all}}", "boss", "no resource 'boss'", ""),
        ('coordinators: {boss: {"*": all}}', '"*"', "'*' is not a name", "write others"),
        (
            "coordinators: {boss: {Grip: all}}",
            "Grip",
            "no resource of the deployment serves Grip",
            "substitutes it",
        ),
        ("coordinators: {boss: {Arm: [hom]}}", "hom", "Arm has no portal 'hom'", "did you mean 'home'?"),
        ("coordinators: {boss: {arm1: [up]}}", "up", "arm1 has no portal 'up'", "grab, home and where"),
        (
            "coordinators: {boss: {Lift: [up]}}",
            "up",
            "Lift has no portal 'up'",
            "its portals: lift and lower",
        ),
        ("coordinators: {boss: {others: [fly]}}", "fly", "no resource of the deployment has a portal", ""),
        (
            "coordinators: {boss: {Arm: home}}",
            "home",
            "'Arm' must be all or a list of portals",
            "write [home]",
        ),
        ("coordinators: {boss: {Arm: [[]]}}", "[]", "a portal is a name, not a list", ""),
        ("coordinators: {boss: {Arm: [], Arm: []}}", "Arm", "the key 'Arm' occurs twice", ""),
        ("calls: {anna: {Arm: [hom]}}", "hom", "Arm has no portal 'hom'", "did you mean 'home'?"),
        ("calls: {anna: [home]}", "[home]", "with their portals, not a list", "{Arm: [home]}"),
        ('calls: {"*": all}', '"*"', "'*' is not a name", "write others"),
        ("calls: [anna]", "[anna]", "'calls' must be a mapping, not a list", ""),
        ("assistants: anna", "anna", "'assistants' must be", ""),
        ("coordinators: {boss: &a {}}", "&a", "anchors and aliases are not allowed", ""),
    ],
)
def test_an_entry_that_fits_nothing_is_reported_at_its_place(
    site: Site, text: str, drawn: str, said: str, hint: str
) -> None:
    with pytest.raises(ProgramError) as error:
        site.read(f"# first line\n{text}\n")
    (finding,) = error.value.diagnostics
    lines = finding.render().splitlines()
    column = text.rindex(drawn) + 1 if drawn else text.index(": }") + 3
    assert lines[0].startswith(f"{site.folder}/mission.access.yaml:2:{column}: error[Y1")
    assert said in lines[0]
    assert lines[2].index("^") == 4 + column - 1
    assert hint in lines[-1]


def test_all_mistakes_are_reported_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = "people: {a: [b, c]}\ncoordinators:\n  x: {}\n  boss: {Arm: [no, home, nor], y: all}\n"
    assert main(["check", str(deployed(tmp_path, text))]) == 65
    output = capsys.readouterr().err
    assert output.count("error[Y113]") == 6
    assert "6 errors" in output
    assert main(["build", str(tmp_path / "mission.dL")]) == 65
    assert capsys.readouterr().err.count("error[Y113]") == 6


def test_an_unreadable_file_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    deploy = deployed(tmp_path, "")
    (tmp_path / "mission.access.yaml").unlink()
    (tmp_path / "mission.access.yaml").mkdir()
    assert main(["check", str(deploy)]) == 66
    assert "mission.access.yaml" in capsys.readouterr().err


def test_a_misnamed_file_or_a_dangling_link_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    deploy, rules = deployed(tmp_path, ""), tmp_path / "mission.access.yaml"
    nearly = rules.rename(rules.with_suffix(".yml"))
    assert main(["check", str(deploy)]) == 66
    assert "it is not read under this name; rename it to mission.access.yaml" in capsys.readouterr().err
    nearly.unlink()
    rules.symlink_to(tmp_path / "nowhere")
    assert main(["check", str(deploy)]) == 66
    assert "mission.access.yaml" in capsys.readouterr().err


WORDS = (
    "all",
    "others",
    "[]",
    "{}",
    "*",
    "boss",
    "Arm",
    "Lift",
    "home",
    ":",
    ",",
    "\n  ",
    "[[",
    "&a",
    "\0",
    "\u2028",
)


@given(st.data())
def test_any_text_is_rules_or_findings_with_places(site: Site, draw: st.DataObject) -> None:
    start, end = sorted((draw.draw(st.integers(0, len(PAGE))), draw.draw(st.integers(0, len(PAGE)))))
    new = draw.draw(st.sampled_from(WORDS) | st.text(max_size=8))
    findings: Sequence[ReportableFinding] = ()
    access = NO_RULES
    try:
        access = site.read(PAGE[:start] + new + PAGE[min(end, start + 9) :])
    except ProgramError as error:
        findings = error.diagnostics
    assert all(finding.render().count("\n") >= 2 for finding in findings)
    assert decode_access(encode_access(access)) == access
    for coordinator in site.mission.team.coordinators:
        for resource in site.mission.team.members:
            assert access.refusal(coordinator, resource, "home").count("\n") == 0


def test_rules_are_in_the_bundle_and_in_its_digest(tmp_path: Path) -> None:
    mission = loaded(tmp_path, PAGE)
    data = bundle.encode(mission)
    assert bundle.decode(data).access == mission.access
    assert bundle.decode(data).access.digest == mission.access.digest != b""
    other = bundle.encode(loaded(tmp_path, PAGE.replace("[lift]", "[lower]")))
    tables = zip(bundle.contents(data).table, bundle.contents(other).table, strict=True)
    assert [a.name for a, b in tables if a.digest != b.digest] == ["access"]
    assert bundle.decode(other).access.digest != mission.access.digest


def test_another_devices_file_removes_no_rule(tmp_path: Path) -> None:
    path = tmp_path / "mission.lfm"
    path.write_bytes(bundle.encode(loaded(tmp_path, PAGE)))
    (tmp_path / "field.yaml").write_text("agents: {}\n")
    assert main(["build", str(path), "--devices", str(tmp_path / "field.yaml"), "-o", str(path)]) == 0
    assert bundle.read(path).access.callers
