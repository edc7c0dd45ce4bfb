"""Requests of an editor about a mission, without a server process."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from sample_mission import (
    DEPLOYMENT,
    DEVICES,
    FILES,
    FOLDER,
    PROGRAM,
    SHARED,
    MemoryFiles,
    findings_of,
    offset,
)

from lfield.editor.installed import DiskFiles, InstalledEnvironment
from lfield.editor.text_places import LineIndex
from lfield.editor.workspace import Workspace
from lfield.errors import ProgramError, UsageError
from lfield.lang import tree
from lfield.lang.frontend import check_text

MISSION, SHARED_FILE = FOLDER / "mission.L", FOLDER / "shared.L"
DEPLOYED, BOUND = FOLDER / "mission.dL", FOLDER / "mission.devices.yaml"


@pytest.fixture(scope="module")
def environment() -> InstalledEnvironment:
    return InstalledEnvironment()


@pytest.fixture
def workspace(environment: InstalledEnvironment) -> Workspace:
    made = Workspace(MemoryFiles(FILES), environment)
    made.put(MISSION, PROGRAM)
    return made


# --- findings -----------------------------------------------------------------------------------------------


def test_sample_mission_has_no_findings(workspace: Workspace) -> None:
    workspace.put(DEPLOYED, DEPLOYMENT)
    changed = [path for path, found in iter_steps(workspace) if found]
    assert changed == []


def iter_steps(workspace: Workspace):
    while (changed := workspace.step()) is not None:
        yield from changed.items()


def test_findings_are_updated_after_edits(workspace: Workspace) -> None:
    assert findings_of(workspace, "mission.L") == []
    workspace.put(MISSION, PROGRAM.replace("name = arg[0]", "nam = arg[0]"))
    assert findings_of(workspace, "mission.L") == [(9, "L301")]
    # New lines above a unit move its finding, and the findings of other units are not repeated.
    workspace.put(MISSION, "\n\n" + PROGRAM.replace("name = arg[0]", "nam = arg[0]"))
    assert findings_of(workspace, "mission.L") == [(11, "L301")]
    # A changed declaration changes findings of other units.
    workspace.put(MISSION, PROGRAM.replace("portal rise(int height)", "portal climb(int height)"))
    assert findings_of(workspace, "mission.L") == []
    workspace.put(MISSION, PROGRAM.replace("portal rise(real height)", "portal climb(real height)"))
    assert {code for _, code in findings_of(workspace, "mission.L")} == {"L415"}
    workspace.put(MISSION, PROGRAM)
    assert findings_of(workspace, "mission.L") == []


def test_edit_of_an_included_file_is_checked_in_the_program(workspace: Workspace) -> None:
    assert findings_of(workspace, "mission.L") == []
    workspace.put(SHARED_FILE, SHARED.replace("string text()", "string txt()"))
    found = findings_of(workspace, "mission.L")
    assert [code for _, code in found] == ["L305"]
    workspace.close(SHARED_FILE)


def test_included_file_is_checked_with_its_program(environment: InstalledEnvironment) -> None:
    files = {"mission.L": 'include "part.L";\nclass A { }\n', "part.L": "class B {\n    public A a;\n}\n"}
    workspace = Workspace(MemoryFiles(files), environment)
    workspace.put(FOLDER / "part.L", files["part.L"])
    assert findings_of(workspace, "part.L") == []


def test_missing_include_and_unknown_driver_are_reported(environment: InstalledEnvironment) -> None:
    workspace = Workspace(MemoryFiles({}), environment)
    workspace.put(MISSION, 'include "none.L";\ninclude <none/x.L>;\n')
    assert findings_of(workspace, "mission.L") == [(1, "L601"), (2, "L603")]


def test_an_include_that_cannot_be_read_is_not_missing(
    environment: InstalledEnvironment, tmp_path: Path
) -> None:
    (tmp_path / "latin.L").write_bytes(b"class A { }\n// caf\xe9\n")
    (tmp_path / "mark.L").write_bytes(b"\xef\xbb\xbfclass B { }\r\n")
    (tmp_path / "folder.L").mkdir()
    workspace = Workspace(DiskFiles(), environment)
    text = "".join(f'include "{name}.L";\n' for name in ("latin", "mark", "folder", "none"))
    workspace.put(tmp_path / "mission.L", text)
    found = dict(iter_steps(workspace))[tmp_path / "mission.L"]
    assert [(one.span.line, one.code) for one in found] == [(1, "L602"), (3, "L602"), (4, "L601")]
    assert "line 2 (byte 0xE9)" in found[0].message


def test_deployment_is_checked_with_its_program(workspace: Workspace) -> None:
    workspace.put(DEPLOYED, DEPLOYMENT.replace("Watcher", "Wacher"))
    assert findings_of(workspace, "mission.dL") == [(1, "L702")]
    workspace.put(DEPLOYED, DEPLOYMENT.replace("?eye", ""))
    assert findings_of(workspace, "mission.dL") == [(2, "L716")]


def test_closed_text_is_ignored(workspace: Workspace) -> None:
    workspace.put(SHARED_FILE, SHARED.replace("string text()", "string txt()"))
    assert [code for _, code in findings_of(workspace, "mission.L")] == ["L305"]
    assert workspace.close(SHARED_FILE) == {}
    assert dict(iter_steps(workspace))[MISSION] == []
    workspace.put(MISSION, PROGRAM + "}")
    assert dict(iter_steps(workspace))[MISSION] != []
    assert workspace.close(MISSION)[MISSION] == []
    assert list(iter_steps(workspace)) == []


def test_deleted_included_file_is_reported(environment: InstalledEnvironment) -> None:
    files = MemoryFiles(FILES)
    workspace = Workspace(files, environment)
    workspace.put(MISSION, PROGRAM)
    assert findings_of(workspace, "mission.L") == []
    del files.files[SHARED_FILE]
    workspace.reload([SHARED_FILE])
    assert findings_of(workspace, "mission.L") == [(2, "L601")]


def test_devices_file_is_not_checked_as_a_program(workspace: Workspace) -> None:
    assert findings_of(workspace, "mission.L") == []
    workspace.put(BOUND, DEVICES)
    assert [path for path, found in iter_steps(workspace) if found] == []
    assert workspace.complete(BOUND, 0) == []


@pytest.fixture
def units() -> Iterator[Callable[[], int]]:
    """A function that counts the units in memory. The garbage collector is off."""
    gc.disable()
    yield lambda: sum(type(one) is tree.Unit for one in gc.get_objects())
    gc.enable()


def test_edit_frees_the_previous_declarations(workspace: Workspace, units: Callable[[], int]) -> None:
    """The language server disables the garbage collector, so reference counts must free the declarations."""
    workspace.put(DEPLOYED, DEPLOYMENT)
    assert list(iter_steps(workspace))
    before = units()
    for edited in (PROGRAM.replace("real value", "int value"), SHARED, PROGRAM):
        workspace.put(MISSION, edited)
        workspace.complete(MISSION, offset(PROGRAM, "first.ri|se(3)"))
        assert list(iter_steps(workspace))
    assert units() == before


GOLDEN = sorted((Path(__file__).parents[1] / "lang/golden/errors").glob("*.L"))


@pytest.mark.few(60)
@pytest.mark.parametrize("path", GOLDEN, ids=lambda path: path.stem)
def test_findings_equal_those_of_the_compiler(path: Path, environment: InstalledEnvironment) -> None:
    text = path.read_bytes().decode("utf-8", "replace")
    if "include" in text:
        return
    found = check_text(
        text, devices=environment.devices, find_include=environment.find_include,
        capabilities=environment.capabilities(path),
    )  # fmt: skip
    workspace = Workspace(MemoryFiles({}), environment)
    workspace.put(MISSION, text)
    assert findings_of(workspace, "mission.L") == [(one.span.line, one.code) for one in found.diagnostics]


# --- hover --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("marked", "parts"),
    [
        ("Wat|cher first", ["resource Watcher", "Watches a field."]),
        ("find|Watcher(arg", ["Watcher findWatcher(string id)"]),
        (
            "first.ri|se(2.0)",
            ["portal Watcher.rise(real height) emit real", "Climbs, and returns the height."],
        ),
        ("first.ri|se(3)", ["portal Watcher.rise(int height) emit real"]),
        ("fc.take|off", ["void Mavlink.takeoff(real height)", "`height` (m)", "waits until it is done"]),
        ("fc.posi|tion", ["real[] Mavlink.position()", "returns m", "only reads"]),
        ("Mav|link fc", ["device Mavlink", "driver `mavlink`", "`takeoff`"]),
        ("f|c;", ["Mavlink fc", "its autopilot"]),
        ("note.te|xt()", ["public string Note.text()"]),
        ("new No|te", ["class Note", "An observation."]),
        ("note.va|lue", ["real value"]),
        ("f2|s(height", ["string f2s(real, int)", "real to the shortest text"]),
        ("no|te.text", ["Note note"]),
        ("find|Lift", ["Lift[] findLift(string constraint)"]),
        ("Li|ft[] lifts", ["class Lift", "raises, holds and lowers a load"]),
        ("lifts[0].li|ft", ["Lift.lift(real height)"]),
        ("lifts.len|gth", ["int length()"]),
    ],
)
def test_hover_shows_declaration_and_comment(
    marked: str, parts: list[str], environment: InstalledEnvironment
) -> None:
    workspace = Workspace(MemoryFiles(FILES), environment)
    workspace.put(MISSION, PROGRAM)
    text = workspace.hover(MISSION, offset(PROGRAM, marked))
    assert [part for part in parts if part not in text] == [], text


def test_keywords_numbers_and_comments_have_no_hover(workspace: Workspace) -> None:
    for marked in ("with|in (5)", "rise(2.|0)", "// Wa|tches"):
        assert workspace.hover(MISSION, offset(PROGRAM, marked)) == ""


def test_hover_in_a_deployment(workspace: Workspace) -> None:
    workspace.put(DEPLOYED, DEPLOYMENT)
    assert "resource Watcher" in workspace.hover(DEPLOYED, offset(DEPLOYMENT, "Wat|cher:eye"))
    assert "`eye`: Watcher on host `sky`" in workspace.hover(DEPLOYED, offset(DEPLOYMENT, "sky?e|ye"))
    assert "`boss` (Boss)" in workspace.hover(DEPLOYED, offset(DEPLOYMENT, "boss@s|ky"))
    assert "a witness" in workspace.hover(DEPLOYED, offset(DEPLOYMENT, "@de|sk"))


# --- definitions --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("marked", "path", "target"),
    [
        ("first.ri|se(2.0)", MISSION, "rise(real"),
        ("first.ri|se(3)", MISSION, "rise(int"),
        ("no|te.text", MISSION, "note = new"),
        ("note.te|xt", SHARED_FILE, "text() {"),
        ("new No|te", SHARED_FILE, "Note {"),
        ('"sha|red.L"', SHARED_FILE, "// An"),
        ("arg|[1]", MISSION, "arg) {\n        Watcher"),
        ("Watcher fi|rst", MISSION, "first = "),
        # From a declaration to the deployment and to the devices file.
        ("resource Wat|cher", DEPLOYED, "Watcher:eye"),
        ("Mavlink f|c", BOUND, "fc: {"),
        ('findWatcher("e|ye")', DEPLOYED, "eye@sky"),
    ],
)
def test_definition_in_the_mission_files(
    marked: str, path: Path, target: str, environment: InstalledEnvironment
) -> None:
    workspace = Workspace(MemoryFiles(FILES), environment)
    workspace.put(MISSION, PROGRAM)
    found = workspace.definitions(MISSION, offset(PROGRAM, marked))
    assert [(one.path, one.start) for one in found] == [(path, FILES[path.name].index(target))]


def test_definition_in_the_file_of_a_driver(workspace: Workspace) -> None:
    text = PROGRAM.replace("Watcher first", "Copter other = findCopter(arg[1]);\n        Watcher first")
    workspace.put(MISSION, text)
    (found,) = workspace.definitions(MISSION, offset(text, "Cop|ter other"))
    assert found.path.name == "copter.L"
    (found,) = workspace.definitions(MISSION, offset(text, "mavlink/co|pter"))
    assert (found.path.name, found.start) == ("copter.L", 0)


def test_definition_in_a_deployment(workspace: Workspace) -> None:
    workspace.put(DEPLOYED, DEPLOYMENT)
    for marked, path, target in (
        ("Wat|cher:eye", MISSION, "Watcher {"),
        ("e|ye@sky", BOUND, "eye:"),
        ("sky?e|ye", DEPLOYED, "eye@sky"),
    ):
        (found,) = workspace.definitions(DEPLOYED, offset(DEPLOYMENT, marked))
        assert (found.path, found.start) == (path, FILES[path.name].index(target))


# --- completion ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "expected", "excluded"),
    [
        ("first.|", {"rise", "agent", "host"}, {"name", "fc", "print"}),
        ("first.ri|", {"rise"}, {"print"}),
        ("note.|", {"subject", "value", "text"}, {"Note"}),
        ("new Note(|", {"height", "note", "print", "max"}, {"write"}),
        ("Note other = new |", {"Note", "Exception"}, {"Watcher", "Mavlink"}),
        ("fin|", {"findWatcher", "findLift", "finally"}, set()),
        ("if (note.value > 1) first.|", {"rise"}, set()),
        ('"text".|', {"length", "substring"}, set()),
        ("lifts.|", {"length", "append", "pop", "sort", "contains"}, {"score", "keys"}),
        ("map<string, int> m = null; m.|", {"contains", "remove", "keys"}, {"set", "move", "append"}),
        ("map<int, int> m = null; Note n = new |", {"Note"}, {"map<int, int>"}),
        ("map<string, Note> m = null; m[note.text].|", {"value"}, {"keys"}),
        ("future<real> f = null; f.|", {"await", "done", "cancel"}, {"failed", "message", "call"}),
        ("future<real>[] all = {}; all.|", {"race", "next", "append"}, {"await"}),
        ("future<real> f = async first.|", {"rise"}, {"print"}),
        ("as|", {"async"}, set()),
        ("// first.|", set(), {"rise"}),
        ("lifts[0].|", {"lift", "agent", "score"}, {"facts"}),
        ("map<string, Note> notes = new map<string, Note>(); notes.|", {"keys", "contains"}, {"subject"}),
        ("map<string, map<int, Note>> all = null; all[arg[0]][1].|", {"subject"}, {"keys"}),
        ("(new Note(first.agent(), 1.0)).|", {"value"}, set()),
    ],
)
def test_completion_by_context(
    line: str, expected: set[str], excluded: set[str], environment: InstalledEnvironment
) -> None:
    workspace = Workspace(MemoryFiles(FILES), environment)
    text = PROGRAM.replace("        within (5)", f"        {line}\n        within (5)")
    workspace.put(MISSION, text.replace("|", ""))
    found = {one.text for one in workspace.complete(MISSION, text.index("|"))}
    assert expected <= found
    assert not excluded & found


def test_completion_of_devices_includes_and_units(workspace: Workspace) -> None:
    text = PROGRAM.replace("fc.takeoff(height);", "fc.")
    workspace.put(MISSION, text)
    found = {one.text: one for one in workspace.complete(MISSION, offset(text, "fc.|\n"))}
    assert found["takeoff"].detail == "void Mavlink.takeoff(real height)"
    text = PROGRAM.replace("include <mavlink/copter.L>;", "include <mav")
    workspace.put(MISSION, text)
    assert "mavlink/copter.L" in {one.text for one in workspace.complete(MISSION, offset(text, "<mav|"))}
    workspace.put(MISSION, "res")
    assert "resource" in {one.text for one in workspace.complete(MISSION, 3)}


def test_completion_in_a_deployment(workspace: Workspace) -> None:
    text = DEPLOYMENT + "//\n//Watcher:x@\n//Boss:b@sky?\n"
    workspace.put(DEPLOYED, text)
    for marked, expected in (
        ("\n//|\n", {"Watcher", "Boss", "Copter"}),
        ("x@|", {"sky", "desk"}),
        ("b@sky?|", {"eye"}),
    ):
        assert expected <= {one.text for one in workspace.complete(DEPLOYED, offset(text, marked))}


# --- references and renaming --------------------------------------------------------------------------------


def renamed(workspace: Workspace, marked: str, name: str) -> dict[str, str]:
    """The files after a renaming."""
    texts = dict(FILES)
    for edit in sorted(
        workspace.rename(MISSION, offset(PROGRAM, marked), name), key=lambda one: -one.place.start
    ):
        file = edit.place.path.name
        texts[file] = texts[file][: edit.place.start] + edit.text + texts[file][edit.place.end :]
    return texts


def test_unit_is_renamed_in_program_queries_and_deployment(workspace: Workspace) -> None:
    after = renamed(workspace, "resource Wat|cher", "Guard")
    assert after["mission.L"] == PROGRAM.replace("Watcher", "Guard")
    assert after["mission.dL"] == DEPLOYMENT.replace("Watcher", "Guard")


def test_members_and_variables_are_renamed_by_meaning(workspace: Workspace) -> None:
    assert renamed(workspace, "first.ri|se(3)", "climb")["mission.L"] == PROGRAM.replace("rise", "climb")
    after = renamed(workspace, "real hei|ght =", "above")["mission.L"]
    assert after == PROGRAM.replace("real height = ", "real above = ").replace(
        '"up", height', '"up", above'
    ).replace("f2s(height", "f2s(above")
    after = renamed(workspace, "note.te|xt", "all")
    assert after["shared.L"] == SHARED.replace("text()", "all()")
    assert after["mission.L"] == PROGRAM.replace("note.text", "note.all")
    assert renamed(workspace, "new No|te", "Memo")["shared.L"] == SHARED.replace("Note", "Memo")


@pytest.mark.parametrize(
    ("marked", "name", "reason"),
    [
        ("Watcher fi|rst", "1st", "not a name"),
        ("Watcher fi|rst", "while", "not a name"),
        ("Watcher fi|rst", "note", "in use"),
        ("resource Wat|cher", "Boss", "in use"),
        ("resource Wat|cher", "Mavlink", "in use"),
        ("first.ri|se(3)", "name", "in use"),
        ("fc.take|off", "up", "not declared in this program"),
        ("Mavlink f|c", "pilot", "mission.devices.yaml may name 'fc' too"),
        ("with|in", "x", "no unit, member or variable"),
    ],
)
def test_renaming_that_could_change_the_program_is_refused(
    marked: str, name: str, reason: str, environment: InstalledEnvironment
) -> None:
    workspace = Workspace(MemoryFiles(FILES), environment)
    workspace.put(MISSION, PROGRAM)
    with pytest.raises(UsageError, match=reason):
        workspace.rename(MISSION, offset(PROGRAM, marked), name)


def test_renaming_in_a_file_of_two_programs_is_refused(environment: InstalledEnvironment) -> None:
    other = 'include "shared.L";\nclass Log { public Note last; }\n'
    workspace = Workspace(MemoryFiles({**FILES, "other.L": other}), environment)
    with pytest.raises(UsageError, match=r"other\.L may name 'Note' too"):
        workspace.rename(SHARED_FILE, offset(SHARED, "No|te {"), "Memo")
    assert workspace.rename(MISSION, offset(PROGRAM, "Wat|cher {"), "Guard")


def test_references_in_program_and_deployment(workspace: Workspace) -> None:
    found = workspace.references(MISSION, offset(PROGRAM, "resource Wat|cher"))
    assert [(one.path.name, FILES[one.path.name][one.start : one.end]) for one in found] == [
        *[("mission.L", "Watcher")] * 4,
        ("mission.dL", "Watcher"),
    ]


# --- outline and layout -------------------------------------------------------------------------------------


def test_outline_of_program_and_deployment(workspace: Workspace) -> None:
    watcher, boss = workspace.outline(MISSION)
    assert (watcher.name, [one.name for one in watcher.children]) == (
        "Watcher",
        ["fc", "name", "init", "rise", "rise"],
    )
    assert PROGRAM[boss.name_start : boss.name_end] == "Boss"
    assert watcher.end < boss.start
    workspace.put(DEPLOYED, DEPLOYMENT)
    outline = [(one.name, one.detail) for one in workspace.outline(DEPLOYED)]
    assert outline == [("eye", "Watcher on sky"), ("boss", "Boss on sky"), ("desk", "witness")]


def test_open_texts_are_formatted(workspace: Workspace) -> None:
    workspace.put(MISSION, PROGRAM.replace("    ", "\t").replace(" = ", "="))
    assert workspace.format(MISSION) == PROGRAM.replace("fc;     //", "fc;  //")
    workspace.put(MISSION, "class A {")
    with pytest.raises(ProgramError):
        workspace.format(MISSION)
    workspace.put(DEPLOYED, f"\n{DEPLOYMENT}\n\n")
    assert workspace.format(DEPLOYED) == DEPLOYMENT


def test_positions_are_counted_in_utf16_or_characters() -> None:
    text = "a\U0001f916b\n\n\U0001f916\U0001f916x"
    for is_utf16, columns in ((True, (3, 4)), (False, (2, 2))):
        index = LineIndex(text, is_utf16=is_utf16)
        assert index.position(text.index("b")) == (0, columns[0])
        assert index.position(text.index("x")) == (2, columns[1])
        for at in range(len(text) + 1):
            assert index.offset(*index.position(at)) == at
        assert index.offset(0, 99) == 3
        assert index.offset(99, 0) == len(text)
    assert DEVICES.isascii()
