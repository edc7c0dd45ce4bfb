"""The Debug Adapter Protocol of an editor over a socket pair."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Iterator

import pytest
from debugger_recordings import EXAMPLES

from lfield.cli.debugging.dap.dap_session import DapSession, OpenedDebugger
from lfield.cli.debugging.dap.dap_values import DapValues
from lfield.cli.debugging.dap.dap_wire import DapStream, RequestQueue
from lfield.errors import UsageError
from lfield.replay.debugger import host_timeline
from lfield.replay.debugger.debugger import Debugger
from lfield.replay.debugger.statement_table import SourceLine

FOLDER = EXAMPLES / "01-first-flight"
FILE = str(FOLDER / "mission.L")
LEG = 87


class Editor:
    """A client: sends requests, and reads responses and events."""

    def __init__(self, end: socket.socket) -> None:
        self._end, self._source = end, end.makefile("rb")
        self._number = 0
        self.events: list[dict] = []

    def close(self) -> None:
        self._source.close()

    def send(self, command: str, **arguments: object) -> int:
        self._number += 1
        data = json.dumps(
            {"seq": self._number, "type": "request", "command": command, "arguments": arguments}
        ).encode()
        self._end.sendall(b"Content-Length: %d\r\n\r\n" % len(data) + data)
        return self._number

    def read(self) -> dict:
        header = self._source.readline()
        assert header.startswith(b"Content-Length: ")
        assert self._source.readline() == b"\r\n"
        return json.loads(self._source.read(int(header.split()[1])))

    def request(self, command: str, **arguments: object) -> dict:
        number = self.send(command, **arguments)
        while (message := self.read())["type"] == "event":
            self.events.append(message)
        assert (message["request_seq"], message["command"]) == (number, command)
        return message

    def body(self, command: str, **arguments: object) -> dict:
        answer = self.request(command, **arguments)
        assert answer["success"], answer
        return answer["body"]

    def event(self, name: str) -> dict:
        while not self.events or self.events.pop(0)["event"] != name:
            self.events.append(self.read())
            if self.events[-1]["event"] == name:
                return self.events.pop()["body"]
        raise AssertionError(name)

    def move(self, command: str, **arguments: object) -> dict:
        self.events.clear()
        self.body(command, **arguments)
        return self.event("stopped")

    def top(self) -> dict:
        thread = next(each for each in self.body("threads")["threads"] if "pilot" in each["name"])
        return self.body("stackTrace", threadId=thread["id"])["stackFrames"][0]

    def variables(self) -> dict[str, dict]:
        scopes = self.body("scopes", frameId=self.top()["id"])["scopes"]
        rows = self.body("variables", variablesReference=scopes[0]["variablesReference"])["variables"]
        return {row["name"]: row for row in rows}


@pytest.fixture
def editor(first_flight) -> Iterator[Editor]:
    near, far = socket.socketpair()
    near.settimeout(60.0)
    with near, far, far.makefile("rb") as source, far.makefile("wb") as sink:
        session = DapSession(
            DapStream(source, sink), lambda given: OpenedDebugger(Debugger(first_flight), FOLDER)
        )
        thread = threading.Thread(target=session.serve)
        thread.start()
        client = Editor(near)
        yield client
        client.request("disconnect")
        thread.join()
        client.close()


def _started(editor: Editor, lines: list[dict], **options: object) -> list[dict]:
    assert editor.body("initialize", adapterID="lfield")["supportsStepBack"] is True
    editor.body("launch", paths=["x"], **options)
    editor.event("initialized")
    found = editor.body("setBreakpoints", source={"path": FILE}, breakpoints=lines)["breakpoints"]
    editor.body("configurationDone")
    return found


def test_breakpoints_variables_and_steps_work_in_both_directions(editor):
    rows = _started(editor, [{"line": LEG}, {"line": LEG - 2}], stopOnEntry=False)
    assert [row["verified"] for row in rows] == [True, True]
    assert editor.event("stopped")["reason"] == "breakpoint"
    while editor.top()["line"] != LEG:
        editor.move("continue", threadId=1)
    top = editor.top()
    assert top["source"]["path"] == FILE
    known = editor.variables()
    assert (known["leg"]["type"], known["leg"]["value"]) == ("int", "0")
    parts = editor.body("variables", variablesReference=known["first"]["variablesReference"])["variables"]
    assert [row["name"] for row in parts] == ["who", "north", "east", "height", "battery"]
    assert editor.move("next")["reason"] == "step"
    assert editor.top()["line"] == LEG + 1
    editor.move("stepBack")
    assert editor.top()["line"] == LEG
    editor.move("continue")
    assert editor.variables()["leg"]["value"] == "1"
    editor.move("reverseContinue")
    assert editor.variables()["leg"]["value"] == "0"


def test_a_conditional_breakpoint_stops_and_an_expression_is_evaluated(editor):
    rows = _started(
        editor,
        [{"line": LEG, "condition": "leg == 2"}, {"line": LEG, "condition": "leg =="}, {"line": 10_000}],
        stopOnEntry=False,
    )
    assert [row["verified"] for row in rows] == [True, False, False]
    editor.event("stopped")
    frame = editor.top()["id"]
    assert editor.body("evaluate", expression="leg * 2", frameId=frame)["result"] == "4"
    assert editor.body("evaluate", expression="first", frameId=frame)["variablesReference"] > 0
    assert not editor.request("evaluate", expression="nothing", frameId=frame)["success"]
    assert editor.move("continue")["reason"] == "pause"


@pytest.mark.parametrize("command", ["pause", "cancel"])
def test_a_search_is_cancelled(editor, monkeypatch, command):
    _started(editor, [])
    editor.event("stopped")
    place = editor.move("gotoTime", seconds=3.0)["description"]
    has_waiting = RequestQueue.has_waiting

    def wait_for_request(queue, commands):
        while not has_waiting(queue, commands):
            time.sleep(0.001)
        return True

    monkeypatch.setattr(host_timeline, "REPORT_EVERY", 0.0)
    monkeypatch.setattr(RequestQueue, "has_waiting", wait_for_request)
    editor.events.clear()
    editor.body("search", kind="condition", text="1 == 2")
    editor.send(command)
    stopped = editor.event("stopped")
    assert (stopped["reason"], stopped["description"]) == ("pause", place)
    assert editor.read()["success"]
    if command == "pause":
        editor.event("stopped")
    monkeypatch.undo()
    assert editor.move("search", kind="portal")["reason"] == "goto"


def test_times_and_searches_are_reached(editor):
    _started(editor, [])
    assert editor.event("stopped")["reason"] == "entry"
    assert editor.move("gotoTime", seconds=12.5)["description"].startswith("12.5")
    editor.move("evaluate", expression=":time 3.0")
    assert editor.move("search", kind="portal")["reason"] == "goto"
    assert "text" not in editor.move("search", kind="hop", text="pilot")
    assert "text" in editor.move("search", kind="condition", text="leg > 100")
    assert not editor.request("search", kind="joke")["success"]
    editor.body("setExceptionBreakpoints", filters=["hop"])
    assert editor.move("continue")["reason"] == "breakpoint"
    assert editor.body("source", sourceReference=1)["content"].startswith("// Two copters")


@pytest.mark.parametrize("seconds", ["x", None, True, [1], float("nan")])
def test_an_invalid_time_has_one_error_response_and_moves_nothing(editor, seconds):
    _started(editor, [])
    editor.event("stopped")
    place = editor.move("gotoTime", seconds=3.0)["description"]
    assert not editor.request("gotoTime", seconds=seconds)["success"]
    assert not editor.request("gotoTime")["success"]
    assert editor.move("pause")["description"] == place


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        ("stackTrace", {"threadId": "x"}),
        ("setExceptionBreakpoints", {"filters": 5}),
        ("setBreakpoints", {"source": 5}),
        ("setBreakpoints", {"source": {"path": FILE}, "breakpoints": [5]}),
    ],
)
def test_arguments_of_another_type_are_refused_without_text_of_python(editor, command, arguments):
    _started(editor, [])
    answer = editor.request(command, **arguments)
    assert not answer["success"]
    assert command in answer["message"]


def test_one_wrong_breakpoint_does_not_refuse_the_others(editor):
    lines = [{"line": LEG}, {"line": "x"}, {}, {"line": LEG, "condition": "nosuch == 1"}]
    rows = _started(editor, lines, stopOnEntry=False)
    assert [row["verified"] for row in rows] == [True, False, False, False]
    assert editor.event("stopped")["reason"] == "breakpoint"


def test_requests_in_the_wrong_order_and_unknown_requests_are_refused(editor):
    for command in ("threads", "next", "evaluate", "stackTrace", "scopes", "dance"):
        assert not editor.request(command)["success"]


@pytest.mark.parametrize(
    "data", [b"GET / HTTP/1.1\r\n\r\n", b"Content-Length: 99999999\r\n\r\n", b"Content-Length: 2\r\n\r\n[]"]
)
def test_another_protocol_is_refused(data):
    near, far = socket.socketpair()
    with near, far, far.makefile("rb") as source, far.makefile("wb") as sink:
        near.sendall(data)
        with pytest.raises(UsageError):
            DapStream(source, sink).read()


def test_the_end_of_the_stream_within_a_message_ends_the_session():
    near, far = socket.socketpair()
    with far, far.makefile("rb") as source, far.makefile("wb") as sink:
        near.sendall(b'Content-Length: 50\r\n\r\n{"a"')
        near.close()
        assert DapStream(source, sink).read() is None


def test_a_source_changed_after_the_recording_is_shown_as_recorded(first_flight, tmp_path):
    at = SourceLine("mission.L", LEG)
    text = (FOLDER / "mission.L").read_bytes()
    values = DapValues(Debugger(first_flight), tmp_path)
    for data, is_file in ((text, True), (b"// new\n" + text, False)):
        (tmp_path / "mission.L").write_bytes(data)
        row = values.source_row(at)
        assert ("sourceReference" not in row) == is_file
    assert values.source_text(row["sourceReference"]) == text.decode()
