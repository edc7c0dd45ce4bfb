"""Numbers of the Debug Adapter Protocol for frames and values, while the debugger is at a position."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lfield.replay.debugger.debugger import Debugger, ThreadInfo
from lfield.replay.debugger.frames import StackFrame
from lfield.replay.debugger.moment import ThreadKey
from lfield.replay.debugger.statement_table import SourceLine
from lfield.replay.debugger.value_tree import Variable
from lfield.text.input_files import MAX_TEXT, read_within

Row = dict[str, Any]


class DapValues:
    """Numbers of threads, which stay, and of frames, values and sources; `folder` has the source files."""

    def __init__(self, debugger: Debugger, folder: Path | None) -> None:
        self._debugger, self._folder = debugger, folder
        self._threads: dict[str, int] = {}
        self._keys: dict[int, ThreadKey] = {}
        self._frames: dict[int, StackFrame] = {}
        self._lists: dict[int, Callable[[], list[Row]]] = {}
        sources = debugger.team.program.debug.sources
        self._sources = {each.name: number for number, each in enumerate(sources, 1)}

    def forget(self) -> None:
        """Discard the numbers of frames and values after a move of the debugger."""
        self._frames.clear()
        self._lists.clear()

    # --- threads and frames ---------------------------------------------------------------------------

    def thread_number(self, key: ThreadKey) -> int:
        """The number of a thread."""
        info = ThreadInfo(key, "", 0, "")
        number = self._threads.setdefault(info.name, len(self._threads) + 1)
        self._keys[number] = key
        return number

    def key_of(self, number: int) -> ThreadKey | None:
        """The thread with a number."""
        return self._keys.get(number)

    def frame_row(self, frame: StackFrame) -> Row:
        """A frame for `stackTrace`."""
        number = len(self._frames) + 1
        self._frames[number] = frame
        name = f"{frame.method}  [{frame.key.agent} on {frame.host}]"
        row: Row = {"id": number, "name": name, "line": 0, "column": 0}
        if frame.line is not None:
            row |= {"line": frame.line.line, "column": 1, "source": self.source_row(frame.line)}
        return row

    def frame(self, number: object) -> StackFrame | None:
        """The frame with a number."""
        return self._frames.get(number) if isinstance(number, int) else None

    # --- sources --------------------------------------------------------------------------------------

    def source_row(self, at: SourceLine) -> Row:
        """A source: the file if its text is that of the recording, otherwise the text in the bundle by its
        number.
        """
        path = Path(at.file) if self._folder is None else self._folder / at.file
        if self._is_as_recorded(path, at.file):
            return {"name": path.name, "path": str(path.resolve())}
        return {"name": Path(at.file).name, "path": at.file, "sourceReference": self._sources[at.file]}

    def _is_as_recorded(self, path: Path, file: str) -> bool:
        """Whether a file has the text in the bundle: the file may have been changed since."""
        text = self._debugger.team.table.source(file)
        try:
            return path.is_file() and text is not None and read_within(path, MAX_TEXT) == text.encode()
        except (OSError, ValueError):
            return False

    def source_text(self, number: object) -> str | None:
        """The text of a source with a number."""
        sources = self._debugger.team.program.debug.sources
        return next((each.text for each in sources if self._sources[each.name] == number), None)

    # --- values ---------------------------------------------------------------------------------------

    def list_number(self, rows: Callable[[], list[Row]]) -> int:
        """The number of a list of variables."""
        self._lists[number := len(self._lists) + 1] = rows
        return number

    def rows(self, number: object) -> list[Row]:
        """The variables of a list."""
        rows = self._lists.get(number) if isinstance(number, int) else None
        return [] if rows is None else rows()

    def variable_row(self, frame: StackFrame, variable: Variable) -> Row:
        """A variable, whose parts are listed on request."""
        reference = 0
        if variable.has_parts:
            reference = self.list_number(
                lambda: [self.variable_row(frame, part) for part in self._debugger.parts(frame, variable)]
            )
        return {
            "name": variable.name,
            "value": variable.value,
            "type": variable.type,
            "variablesReference": reference,
            "evaluateName": variable.name,
        }

    def scope_rows(self, frame: StackFrame) -> list[Row]:
        """The scopes of a frame: its variables, and the readings of devices."""
        variables = self.list_number(
            lambda: [self.variable_row(frame, each) for each in self._debugger.variables(frame)]
        )
        readings = self.list_number(self._reading_rows)
        return [
            {
                "name": "Variables",
                "presentationHint": "locals",
                "variablesReference": variables,
                "expensive": False,
            },
            {"name": "Devices", "variablesReference": readings, "expensive": True},
        ]

    def _reading_rows(self) -> list[Row]:
        return [
            {"name": each.name, "value": json.dumps(each.value), "variablesReference": 0}
            for each in self._debugger.readings()
        ]
