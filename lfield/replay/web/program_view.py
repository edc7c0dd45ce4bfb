"""Views of the programs for the page: stacks, variables, and the lines of L around each frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from lfield.replay.debugger.debugger import Debugger
from lfield.replay.debugger.frames import StackFrame
from lfield.replay.debugger.statement_table import SourceLine
from lfield.replay.debugger.value_tree import Variable

#: Lines that are shown before and after the current one.
CONTEXT_LINES = 4
#: The most frames of a stack, variables of a frame, parts of a value, and levels of parts.
MAX_FRAMES, MAX_VARIABLES, MAX_PARTS, MAX_LEVELS = 20, 60, 30, 2


def coordinators_of(debugger: Debugger) -> Iterator[dict[str, Any]]:
    """The coordinators at the position of a debugger: host, state, and stack, innermost frame first."""
    kinds = {member.id: member.kind for member in debugger.team.mission.team.members}
    for thread in debugger.threads():
        if kinds.get(thread.key.agent) == "coordinator":
            stack = debugger.stack(thread.key)
            yield {
                "agent": thread.key.agent,
                "host": thread.host,
                "state": thread.state,
                "frames": [_frame(debugger, frame) for frame in stack[:MAX_FRAMES]],
                "more": max(0, len(stack) - MAX_FRAMES),
            }


def _frame(debugger: Debugger, frame: StackFrame) -> dict[str, Any]:
    line = frame.line
    variables = debugger.variables(frame)[:MAX_VARIABLES]
    return {
        "agent": frame.key.agent,
        "method": frame.method,
        "file": "" if line is None else line.file,
        "line": 0 if line is None else line.line,
        "source": [] if line is None else _lines_around(debugger, line),
        "variables": [_variable(debugger, frame, each, MAX_LEVELS) for each in variables],
    }


def _lines_around(debugger: Debugger, line: SourceLine) -> list[tuple[int, str]]:
    """The lines with their numbers; [] without the source."""
    text = debugger.team.table.source(line.file)
    if text is None:
        return []
    first = max(1, line.line - CONTEXT_LINES)
    lines = text.splitlines()[first - 1 : line.line + CONTEXT_LINES]
    return list(enumerate(lines, first))


def _variable(debugger: Debugger, frame: StackFrame, variable: Variable, levels: int) -> dict[str, Any]:
    parts = debugger.parts(frame, variable) if variable.has_parts and levels else []
    return {
        "name": variable.name,
        "type": variable.type,
        "value": variable.value,
        "parts": [_variable(debugger, frame, each, levels - 1) for each in parts[:MAX_PARTS]],
    }
