"""Loops of resources in editors: layout, outline, hover, completion, renaming."""

from __future__ import annotations

import pytest
from sample_mission import FOLDER, MemoryFiles

from lfield.editor.installed import InstalledEnvironment
from lfield.editor.layout.formatter import format_program
from lfield.editor.workspace import Workspace
from lfield.text.source_text import Source

MISSION = FOLDER / "mission.L"
PROGRAM = """resource Cart {
    boolean near;
    init(string[] arg) { }

    // Stops before people.
    loop stop at 20.0 priority 2 when (near) {
        int steps = stop.overruns();
        near = steps > 3;
    }
    loop patrol every 5.0 { if (!stop.running()) near = true; }
    portal state() emit boolean { return stop.running(); }
}
coordinator Boss { init(string[] arg) { } }
"""


@pytest.fixture
def workspace() -> Workspace:
    made = Workspace(MemoryFiles({"mission.L": PROGRAM}), InstalledEnvironment())
    made.put(MISSION, PROGRAM)
    return made


def test_loop_header_has_the_layout_of_other_headers() -> None:
    text = "resource R{\nloop  a at(3+n)*2 priority - 2 when( b&&c ){at=-1;priority=n - 1;}\n"
    text += "loop b every 0.1{\n}\nprivate int when (int at){return at;}\n}\n"
    formatted = format_program(Source("p.L", text))
    assert formatted == (
        "resource R {\n    loop a at (3 + n) * 2 priority -2 when (b && c) { at = -1; priority = n - 1; }\n"
        "    loop b every 0.1 {\n    }\n    private int when(int at) { return at; }\n}\n"
    )
    assert format_program(Source("p.L", formatted)) == formatted


def test_loops_are_in_the_outline(workspace: Workspace) -> None:
    cart, _ = workspace.outline(MISSION)
    assert ("stop", "loop") in [(one.name, one.kind) for one in cart.children]


@pytest.mark.parametrize("marked", ["loop st|op at", "!st|op.running", "return st|op"])
def test_hover_on_a_loop_name_shows_its_comment(marked: str, workspace: Workspace) -> None:
    at = PROGRAM.index(marked.replace("|", "")) + marked.index("|")
    hover = workspace.hover(MISSION, at)
    assert "loop Cart.stop" in hover
    assert "Stops before people." in hover


def test_completion_of_a_loop_has_two_methods_and_no_generated_fields(workspace: Workspace) -> None:
    text = PROGRAM.replace("near = true;", "near = stop.|;")
    workspace.put(MISSION, text.replace("|", ""))
    assert {one.text for one in workspace.complete(MISSION, text.index("|"))} == {"running", "overruns"}
    text = PROGRAM.replace("near = true;", "|;")
    workspace.put(MISSION, text.replace("|", ""))
    found = {one.text for one in workspace.complete(MISSION, text.index("|"))}
    assert {"stop", "patrol", "near"} <= found
    assert not {"stop_running", "stop_engaged", "stop_overruns"} & found


def test_all_references_of_a_loop_are_renamed(workspace: Workspace) -> None:
    edits = workspace.rename(MISSION, PROGRAM.index("stop at"), "halt")
    assert len(edits) == PROGRAM.count("stop")
