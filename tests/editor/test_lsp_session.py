"""A session of an editor with `lfield lsp`: 40 requests to a server process, and the answers."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from lsp_session import LspSession
from sample_mission import DEPLOYMENT, DEVICES, FILES, PROGRAM, SHARED, place

pytest.importorskip("pygls", reason="the extra lsp is not installed")

pytestmark = pytest.mark.process


@pytest.fixture
def session(tmp_path: Path) -> Iterator[LspSession]:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    with LspSession(tmp_path) as made:
        yield made


def targets(locations: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """The file name and the text of each location."""
    found = []
    for one in locations:
        name = one["uri"].rpartition("/")[2]
        start, end = one["range"]["start"], one["range"]["end"]
        line = FILES[name].split("\n")[start["line"]] if name in FILES else ""
        found.append((name, line[start["character"] : end["character"]]))
    return found


def test_session_answers_40_requests(session: LspSession) -> None:
    assert session.capabilities["positionEncoding"] == "utf-16"  # 1: initialize
    session.open("mission.L")
    session.open("mission.dL")

    def hover(marked: str, name: str = "mission.L") -> str:
        answer = session.at("textDocument/hover", name, *place(FILES[name], marked))
        return "" if answer is None else answer["contents"]["value"]

    def definition(marked: str, name: str = "mission.L") -> list[tuple[str, str]]:
        return targets(session.at("textDocument/definition", name, *place(FILES[name], marked)))

    def completion(name: str, line: int, column: int) -> set[str]:
        return {one["label"] for one in session.at("textDocument/completion", name, line, column)["items"]}

    # 2 to 13: hover.
    for marked, part in (
        ("Wat|cher first", "Watches a field."),
        ("first.ri|se(2.0)", "portal Watcher.rise(real height) emit real"),
        ("fc.take|off", "`height` (m)"),
        ("fc.posi|tion", "returns m"),
        ("Mav|link fc", "driver `mavlink`"),
        ("note.te|xt()", "string Note.text()"),
        ("new No|te", "An observation."),
        ("f2|s(height", "string f2s(real, int)"),
        ("find|Lift", "Lift[] findLift"),
        ("lifts[0].li|ft", "Lift.lift(real height)"),
    ):
        assert part in hover(marked)
    assert hover("with|in (5)") == ""
    assert "Watcher on host `sky`" in hover("e|ye@sky", "mission.dL")

    # 14 to 21: definitions, across files.
    assert definition("first.ri|se(3)") == [("mission.L", "rise")]
    assert definition("new No|te") == [("shared.L", "Note")]
    assert definition("resource Wat|cher") == [("mission.dL", "Watcher")]
    assert definition("Mavlink f|c") == [("mission.devices.yaml", "fc")]
    assert definition('findWatcher("e|ye")') == [("mission.dL", "eye")]
    assert definition("include <mav|link") == [("copter.L", "")]
    assert definition("Wat|cher:eye", "mission.dL") == [("mission.L", "Watcher")]
    assert definition("e|ye@sky", "mission.dL") == [("mission.devices.yaml", "eye")]

    # 22 to 25: diagnostics and completion during edits.
    line, column = place(PROGRAM, "|within (5)")
    session.change("mission.L", line, column, 0, "first.")
    assert {"rise", "agent"} <= completion("mission.L", line, column + 6)
    found = session.await_diagnostics("mission.L")
    assert {one["range"]["start"]["line"] for one in found} == {line}
    session.change("mission.L", line, column, 6, "")
    assert "findWatcher" in completion("mission.L", line, column)
    assert session.await_diagnostics("mission.L") == []
    assert "Watcher" in completion("mission.dL", 0, 2)
    assert "sky" in completion("mission.dL", 0, len("//Watcher:eye@"))

    # 26 to 29: symbols and references.
    def outline(name: str) -> list[str]:
        symbols = session.request("textDocument/documentSymbol", {"textDocument": session.document(name)})
        return [one["name"] for one in symbols]

    assert outline("mission.L") == ["Watcher", "Boss"]
    assert outline("mission.dL") == ["eye", "boss", "desk"]
    at = place(PROGRAM, "resource Wat|cher")
    context = {"includeDeclaration": True}
    used = targets(session.at("textDocument/references", "mission.L", *at, context=context))
    assert [name for name, _ in used] == ["mission.L"] * 4 + ["mission.dL"]
    at = place(PROGRAM, "note.va|lue")
    used = targets(session.at("textDocument/references", "mission.L", *at, context=context))
    assert [name for name, _ in used] == ["mission.L", "shared.L", "shared.L"]

    # 30 to 34: renaming.
    def rename(marked: str, new: str) -> Any:
        return session.at("textDocument/rename", "mission.L", *place(PROGRAM, marked), newName=new)

    changes = rename("resource Wat|cher", "Guard")["changes"]
    assert {uri.rpartition("/")[2]: len(edits) for uri, edits in changes.items()} == {
        "mission.L": 4,
        "mission.dL": 1,
    }
    assert len(rename("Watcher fi|rst", "one")["changes"]) == 1
    assert "in use" in rename("Watcher fi|rst", "note")["message"]
    assert "may name 'fc' too" in rename("Mavlink f|c", "pilot")["message"]
    assert "not declared" in rename("fc.take|off", "up")["message"]

    # 35 to 38: formatting.
    def formatted(name: str) -> list[dict[str, Any]]:
        options = {"tabSize": 4, "insertSpaces": True}
        return session.request(
            "textDocument/formatting", {"textDocument": session.document(name), "options": options}
        )

    assert formatted("mission.L") == []
    session.change("mission.L", line, column, 0, "   ")
    (edit,) = formatted("mission.L")
    assert edit["newText"] == PROGRAM
    session.change("mission.L", line, column, 0, "}")
    assert formatted("mission.L") == []  # The text has a syntax error.
    session.change("mission.dL", 0, 0, 0, "\n\n ")
    (edit,) = formatted("mission.dL")
    assert edit["newText"] == DEPLOYMENT

    # 39, and 40: shutdown.
    session.open("shared.L", SHARED.replace("real value", "reel value"))
    found = session.await_diagnostics("shared.L")
    assert [(one["code"], one["severity"], one["source"]) for one in found] == [("L302", 1, "lfield")]
    assert outline("shared.L") == ["Note"]
    assert session.end() == 0
    assert session.requests == 40
    assert DEVICES.startswith("agents:")


@pytest.mark.few(0)
def test_positions_are_in_the_encoding_of_the_editor(tmp_path: Path) -> None:
    text = 'class A {\n    public string f(int n) { return "\U0001f916" + i2s(n); }\n}\n'
    for encoding, shift in (("utf-32", 0), ("utf-16", 1)):
        with LspSession(tmp_path, (encoding,)) as session:
            assert session.capabilities["positionEncoding"] == encoding
            session.open("a.L", text)
            line, column = place(text, "i2s(|n)")
            (found,) = session.at("textDocument/definition", "a.L", line, column + shift)
            assert found["range"]["start"] == {"line": 1, "character": text.split("\n")[1].index("n)")}


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("method", "params", "code"),
    [
        ("textDocument/hover", {}, -32602),
        ("textDocument/hover", None, -32602),
        (
            "textDocument/hover",
            {"textDocument": {"uri": "a"}, "position": {"line": -1, "character": 0}},
            -32602,
        ),
        ("textDocument/formatting", {"textDocument": {"uri": "file:///a.L"}}, -32602),
        ("initialize", 3, -32602),
        ("textDocument/absent", {}, -32601),
    ],
)
def test_a_malformed_request_is_answered(session: LspSession, method: str, params: object, code: int) -> None:
    assert session.request(method, params)["code"] == code
    start = {"line": 0, "character": 0}
    root = {"textDocument": {"uri": "file:///"}, "position": start}
    assert session.request("textDocument/definition", root) == []
    assert session.end() == 0


@pytest.mark.few(0)
def test_text_without_a_file_has_findings(session: LspSession) -> None:
    document = {"uri": "untitled:Untitled-1", "languageId": "l", "version": 1, "text": "class A { int n; }"}
    session.notify("textDocument/didOpen", {"textDocument": document})
    assert [one["code"] for one in session.await_diagnostics(document["uri"], version=1)] == ["L215"]


@pytest.mark.few(0)
def test_error_without_pygls_has_the_command_that_installs_it(tmp_path: Path) -> None:
    without = (
        "import sys; sys.modules['pygls'] = None\nfrom lfield.cli.main import main\nsys.exit(main(['lsp']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", without],
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 69
    assert done.stderr == "lfield: 'lfield lsp' needs pygls: pip install 'lfield[desk]'\n"


@pytest.mark.few(0)
def test_server_ends_when_the_editor_closes_its_input(session: LspSession) -> None:
    session.open("mission.L")
    session.close_input()
    assert session.wait() == 0
