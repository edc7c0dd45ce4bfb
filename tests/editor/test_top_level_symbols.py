"""Constants, enums and functions in the editor: hover, completion, definition, outline, renaming."""

from __future__ import annotations

from pathlib import Path

import pytest
from sample_mission import FOLDER, MemoryFiles, findings_of, offset

from lfield.editor.installed import InstalledEnvironment
from lfield.editor.workspace import Workspace
from lfield.errors import UsageError

MISSION, SHARED_FILE = FOLDER / "mission.L", FOLDER / "shared.L"
PROGRAM = """include "shared.L";

// Metres per second.
const real CRUISE = SLOW * 2;

enum Phase { SEARCH, LIFT }

// The area of a square.
real square(real side) {
    real twice = side * CRUISE;
    return clipped(twice);
}

resource Arm {
    Phase phase = Phase.LIFT;
    init(string[] arg) { }
    portal go(Phase to) emit real {
        phase = to;
        return square(CRUISE) + clipped(1.0);
    }
    private string phaseName() { return phase.name(); }
}
"""
SHARED = """const real SLOW = 2.5;

real clipped(real x) { return min(x, SLOW); }
"""


@pytest.fixture(scope="module")
def environment() -> InstalledEnvironment:
    return InstalledEnvironment()


@pytest.fixture
def workspace(environment: InstalledEnvironment) -> Workspace:
    made = Workspace(MemoryFiles({"mission.L": PROGRAM, "shared.L": SHARED}), environment)
    made.put(MISSION, PROGRAM)
    return made


def test_program_with_top_level_symbols_has_no_findings(workspace: Workspace) -> None:
    assert findings_of(workspace, "mission.L") == []


def test_findings_are_updated_after_edits_of_declarations(workspace: Workspace) -> None:
    assert findings_of(workspace, "mission.L") == []
    workspace.put(MISSION, PROGRAM.replace("LIFT }", "RAISE }"))
    assert findings_of(workspace, "mission.L") == [(15, "L322")]
    workspace.put(MISSION, PROGRAM.replace("real square(real side)", "real square(string side)"))
    assert [code for _, code in findings_of(workspace, "mission.L")] == ["L406", "L415"]
    workspace.put(MISSION, PROGRAM.replace("return clipped(twice)", "return now()"))
    assert findings_of(workspace, "mission.L") == [(11, "L437")]
    workspace.put(MISSION, PROGRAM)
    assert findings_of(workspace, "mission.L") == []
    workspace.put(SHARED_FILE, SHARED.replace("SLOW", "SPEED"))
    assert findings_of(workspace, "mission.L") == [(4, "L301")]


@pytest.mark.parametrize(
    ("marked", "parts"),
    [
        ("square(CRU|ISE)", ["const real CRUISE = 5.0", "Metres per second."]),
        ("const real CRU|ISE", ["const real CRUISE = 5.0"]),
        ("Pha|se phase", ["enum Phase { SEARCH, LIFT }"]),
        ("Phase.LI|FT", ["Phase.LIFT", "1"]),
        ("SEA|RCH, LIFT", ["Phase.SEARCH"]),
        ("return squ|are(", ["real square(real side)", "The area of a square."]),
        ("clip|ped(twice)", ["real clipped(real x)"]),
        ("phase.na|me()", ["string name()", "the name of the member"]),
        ("clipped(twi|ce)", ["real twice"]),
        ("si|de * CRUISE", ["real side"]),
    ],
)
def test_hover_on_top_level_symbols(marked: str, parts: list[str], workspace: Workspace) -> None:
    text = workspace.hover(MISSION, offset(PROGRAM, marked))
    assert [part for part in parts if part not in text] == [], text


@pytest.mark.parametrize(
    ("marked", "path", "target"),
    [
        ("square(CRU|ISE)", MISSION, "CRUISE = "),
        ("SL|OW * 2", SHARED_FILE, "SLOW = "),
        ("Phase.LI|FT", MISSION, "LIFT }"),
        ("Pha|se to", MISSION, "Phase {"),
        ("return squ|are(", MISSION, "square(real"),
        ("clip|ped(1.0)", SHARED_FILE, "clipped("),
    ],
)
def test_definition_of_top_level_symbols(marked: str, path: Path, target: str, workspace: Workspace) -> None:
    (found,) = workspace.definitions(MISSION, offset(PROGRAM, marked))
    text = PROGRAM if path == MISSION else SHARED
    assert (found.path, found.start) == (path, text.index(target))


@pytest.mark.parametrize(
    ("line", "expected", "excluded"),
    [
        ("Phase.|", {"SEARCH", "LIFT", "values", "of"}, {"name"}),
        ("phase.|", {"name", "ordinal"}, {"SEARCH"}),
        ("real x = |", {"CRUISE", "SLOW", "Phase", "square", "clipped"}, {"const"}),
        ('Phase.of("LIFT").|', {"name"}, {"values"}),
    ],
)
def test_completion_of_top_level_symbols(
    line: str, expected: set[str], excluded: set[str], workspace: Workspace
) -> None:
    text = PROGRAM.replace("        phase = to;", f"        {line}\n        phase = to;")
    workspace.put(MISSION, text.replace("|", ""))
    found = {one.text for one in workspace.complete(MISSION, text.index("|"))}
    assert expected <= found
    assert not excluded & found


def test_completion_in_a_function_and_outside(workspace: Workspace) -> None:
    text = PROGRAM.replace("    return clipped(twice);", "    \n    return clipped(twice);")
    workspace.put(MISSION, text)
    found = {one.text for one in workspace.complete(MISSION, text.index("    \n    return") + 4)}
    assert {"side", "twice", "CRUISE", "sqrt", "clipped"} <= found
    assert not {"phase", "findArm", "write", "hops"} & found
    workspace.put(MISSION, "en" + PROGRAM)
    assert {"enum", "const"} <= {one.text for one in workspace.complete(MISSION, 2)}


def test_outline_of_top_level_symbols(workspace: Workspace) -> None:
    found = [
        (one.name, one.kind, [child.name for child in one.children]) for one in workspace.outline(MISSION)
    ]
    assert found == [
        ("CRUISE", "constant", []),
        ("Phase", "enum", ["SEARCH", "LIFT"]),
        ("square", "function", []),
        ("Arm", "resource", ["phase", "init", "go", "phaseName"]),
    ]


@pytest.mark.parametrize(
    ("marked", "name", "text"),
    [
        ("const real CRU|ISE", "SPEED", PROGRAM.replace("CRUISE", "SPEED")),
        ("Phase.LI|FT", "RAISE", PROGRAM.replace("LIFT", "RAISE")),
        ("enum Pha|se", "Step", PROGRAM.replace("Phase", "Step")),
        ("return squ|are(", "area", PROGRAM.replace("square(", "area(")),
        ("real si|de", "edge", PROGRAM.replace("real side", "real edge").replace("side *", "edge *")),
    ],
)
def test_renaming_of_top_level_symbols(marked: str, name: str, text: str, workspace: Workspace) -> None:
    after = PROGRAM
    edits = workspace.rename(MISSION, offset(PROGRAM, marked), name)
    for edit in sorted(edits, key=lambda one: -one.place.start):
        assert edit.place.path == MISSION
        after = after[: edit.place.start] + edit.text + after[edit.place.end :]
    assert after == text


def test_constant_of_another_file_is_renamed_in_both(workspace: Workspace) -> None:
    edits = workspace.rename(MISSION, offset(PROGRAM, "SL|OW * 2"), "CALM")
    assert sorted(edit.place.path.name for edit in edits) == ["mission.L", "shared.L", "shared.L"]


QUERY = """include <can/winch.L>;

const real LEAST = 2.0;
const string ABLE = "payload >= $far";

coordinator Boss {
    real far = 3.0;
    init(string[] arg) {
        string name = arg[0];
        findLift("payload >= $LEAST && agent != $name && agent != $arg[1]");
        print("$name");
        findLift(ABLE);
    }
}
"""


def test_variables_in_queries_are_found_and_renamed(workspace: Workspace) -> None:
    workspace.put(MISSION, QUERY)
    assert findings_of(workspace, "mission.L") == []
    for marked, hover in (
        ("$LE|AST", "const real LEAST = 2.0"),
        ("!= $na|me", "string name"),
        ("$ar|g[1]", "string[] arg"),
    ):
        assert hover in workspace.hover(MISSION, offset(QUERY, marked))
    (found,) = workspace.definitions(MISSION, offset(QUERY, "!= $na|me"))
    assert found.start == QUERY.index("name = arg")
    for marked, name in (("string na|me", "id"), ("$LE|AST", "LOWEST")):
        after = QUERY
        edits = workspace.rename(MISSION, offset(QUERY, marked), name)
        for edit in sorted(edits, key=lambda one: -one.place.start):
            after = after[: edit.place.start] + edit.text + after[edit.place.end :]
        old = QUERY[edits[0].place.start : edits[0].place.end]
        changed = QUERY.replace(f"{old} =", f"{name} =").replace(f"${old} ", f"${name} ")
        assert after == changed
    assert workspace.hover(MISSION, offset(QUERY, 'print("$na|me"')) == ""
    with pytest.raises(UsageError, match="ABLE has"):
        workspace.rename(MISSION, offset(QUERY, "real fa|r"), "near")


@pytest.mark.parametrize(
    ("marked", "name"),
    [
        ("const real CRU|ISE", "phase"),
        ("const real CRU|ISE", "Arm"),
        ("Phase.LI|FT", "SEARCH"),
        ("return squ|are(", "clipped"),
        ("enum Pha|se", "SLOW"),
    ],
)
def test_renaming_to_a_name_in_use_is_refused(marked: str, name: str, workspace: Workspace) -> None:
    with pytest.raises(UsageError, match="in use"):
        workspace.rename(MISSION, offset(PROGRAM, marked), name)
