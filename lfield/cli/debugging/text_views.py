"""Views of a debugger for the terminal: position, source, stack, variables, threads. Plain lines."""

from __future__ import annotations

import json

from lfield.host.recording.effect_summary import decode_effects, encode_effects
from lfield.replay.debugger.debugger import Debugger
from lfield.replay.debugger.frames import StackFrame
from lfield.replay.debugger.moment import Phase
from lfield.replay.debugger.statement_table import SourceLine
from lfield.replay.debugger.value_tree import Variable
from lfield.text.terminal_escape import escape_line, truncate
from lfield.wire.subscription_messages import as_fields

#: Lines of source before and after the position.
CONTEXT = 4
#: Characters of an effect or event that are shown.
MAX_LINE = 160
#: Events that are listed.
LAST_EVENTS = 10
_PHASES = {
    Phase.REST: "at rest",
    Phase.INPUT: "input received",
    Phase.STATEMENT: "before a statement",
    Phase.END: "end of the turn",
}


def position_line(debugger: Debugger) -> str:
    """Time, host, turn, thread and line of the position."""
    place, moment = debugger.place, debugger.moment
    parts = [f"{debugger.seconds:.6f} s", debugger.host, f"turn {place.turn}.{place.step}"]
    if debugger.focus is not None:
        parts.append(debugger.focus.logical)
    frames = debugger.stack()
    if frames and frames[0].line is not None:
        parts.append(f"{frames[0].method} at {frames[0].line}")
    if moment.phase is not Phase.STATEMENT:
        parts.append(_PHASES[moment.phase])
    return "  ".join(parts)


def source_lines(debugger: Debugger, at: SourceLine | None, before: int, after: int) -> list[str]:
    """The source around a line, which is marked; breakpoints have a star."""
    text = None if at is None else debugger.team.table.source(at.file)
    if at is None or text is None:
        return ["(no source here)"]
    lines = text.splitlines()
    stars = {each.line for each in debugger.breakpoints if at.file.endswith(each.file)}
    found = []
    for number in range(max(1, at.line - before), min(len(lines), at.line + after) + 1):
        mark = ">" if number == at.line else " "
        star = "*" if number in stars else " "
        found.append(f"{mark}{star}{number:>5}  {escape_line(lines[number - 1].replace(chr(9), '    '))}")
    return found


def stack_lines(frames: list[StackFrame], chosen: int = 0) -> list[str]:
    """A line for each frame."""
    if not frames:
        return ["(not on any host at this time)"]
    return [
        f"{'>' if number == chosen else ' '}{number:>2}  {frame.method} "
        f"{frame.line if frame.line is not None else '?'}  {frame.key.agent} on {frame.host}"
        for number, frame in enumerate(frames)
    ]


def variable_line(variable: Variable, indent: int = 0) -> str:
    """A variable with its type."""
    return f"{'  ' * indent}{variable.type} {variable.name} = {variable.value}"


def variable_lines(debugger: Debugger, frame: StackFrame) -> list[str]:
    """The variables of a frame."""
    return [variable_line(each) for each in debugger.variables(frame)]


def reading_lines(debugger: Debugger) -> list[str]:
    """The readings of the devices."""
    return [f"{each.name} = {escape_line(json.dumps(each.value))}" for each in debugger.readings()]


def thread_lines(debugger: Debugger) -> list[str]:
    """The threads of the team."""
    found = []
    for each in debugger.threads():
        frames = debugger.stack(each.key)
        where = f"{frames[0].method} {frames[0].line}" if frames else ""
        mark = ">" if each.key == debugger.focus else " "
        found.append(f"{mark} {each.name}  {each.host}  {each.state}  {where}".rstrip())
    return found


def effect_lines(debugger: Debugger) -> list[str]:
    """The effects of the present turn until now."""
    plain = decode_effects(encode_effects(list(debugger.moment.effects)))
    return [truncate(escape_line(json.dumps(each, default=repr)), MAX_LINE) for each in plain]


def event_lines(debugger: Debugger) -> list[str]:
    """The last events of the host of the position, with the seconds since its start."""
    lines = []
    for event in debugger.events(LAST_EVENTS):
        fields = {k: v for k, v in as_fields(event).items() if k not in ("at", "up", "cause", "number")}
        kind = fields.pop("kind")
        values_text = " ".join(f"{name}={value}" for name, value in fields.items())
        lines.append(truncate(escape_line(f"{event.up:.3f} s  {kind}  {values_text}"), MAX_LINE))
    return lines


def timeline_line(debugger: Debugger, width: int) -> str:
    """The time of the recordings as a bar with the hops (^) and the position (#)."""
    duration, cells = max(debugger.team.duration, 1e-9), max(10, width - 24)
    bar = ["-"] * cells

    def mark(seconds: float, sign: str) -> None:
        bar[min(cells - 1, max(0, int(seconds / duration * cells)))] = sign

    for recording, turn in debugger.team.arrivals:
        mark(debugger.team.times[recording][turn], "^")
    mark(debugger.seconds, "#")
    return f"{debugger.seconds:>10.3f} |{''.join(bar)}| {duration:.1f} s"
