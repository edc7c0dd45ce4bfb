"""The commands of the debugger in a terminal: a line of text in, lines of text out."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping

from lfield.cli.debugging import text_views
from lfield.errors import UsageError
from lfield.replay.debugger.debugger import Breakpoint, Debugger
from lfield.replay.debugger.expressions import ValueUnknown, value_text
from lfield.replay.debugger.frames import StackFrame
from lfield.replay.debugger.moment import Target
from lfield.replay.debugger.value_tree import Variable
from lfield.text.suggestions import choice

#: The output of `help`: for each command its arguments and purpose.
HELP = """\
step, next, out      one statement of the thread; over calls to another line; out of the method or portal
line                 to another line, into calls
continue             to the next breakpoint
portal, device       to the next portal call, to the next call of a device
hop [COORDINATOR]    to the next arrival of a coordinator on a host
event [KIND ...]     to the next event, see events.md
until CONDITION      until a condition becomes true: until battery < 0.3
change EXPRESSION    until a value changes
  With 'back' before or after it, each of them goes backward: 'back step', 'rs' for short.
time SECONDS, start, end    to a time since the start of the recordings; to their start or end
break FILE:LINE [if CONDITION], delete NUMBER, breakpoints
threads, thread NAME        list the threads, follow another one
stack, frame NUMBER, vars   the frames of the thread; another frame; its variables
print EXPRESSION     a value, and the parts of an object
readings             what the hosts know of their devices
where, list [LINES]  the position, and the source around it
effects, events      the effects of this turn; the last events of this host
quit
"""
#: Short forms; those with an r go backward.
SHORT: Mapping[str, str] = {
    **{"s": "step", "n": "next", "o": "out", "l": "line", "c": "continue", "b": "break", "p": "print"},
    **{"rs": "back step", "rn": "back next", "ro": "back out", "rl": "back line", "rc": "back continue"},
    **{"bt": "stack", "f": "frame", "v": "vars", "q": "quit", "h": "help", "?": "help", "t": "time"},
}
_BREAK = re.compile(r"(?:(?P<file>.+):)?(?P<line>\d+)(?:\s+if\s+(?P<condition>.+))?")
#: Levels of objects that `print` shows.
PRINT_DEPTH = 2
_END = "nothing of that kind until the end of the recording"
_START = "nothing of that kind back to the start of the recording"


class DebuggerCommands:
    """Executes commands on a debugger."""

    def __init__(self, debugger: Debugger) -> None:
        self.debugger = debugger
        self.is_done = False
        self._frame = 0
        self._moves: Mapping[str, Callable[[str, bool], bool]] = {
            "step": lambda text, back: debugger.step(backward=back),
            "next": lambda text, back: debugger.step_over(backward=back),
            "out": lambda text, back: debugger.step_out(backward=back),
            "line": lambda text, back: debugger.step_line(backward=back),
            "continue": lambda text, back: debugger.resume(backward=back),
            "portal": lambda text, back: self._search(debugger.portal_target(), back),
            "device": lambda text, back: self._search(debugger.device_target(), back),
            "hop": lambda text, back: self._search(debugger.hop_target(text), back),
            "event": lambda text, back: self._search(debugger.event_target(text.split()), back),
            "until": lambda text, back: self._search(debugger.condition_target(_required(text)), back),
            "change": lambda text, back: self._search(debugger.change_target(_required(text)), back),
        }
        self._views: Mapping[str, Callable[[str], list[str]]] = {
            "time": self._go_to_time,
            "start": lambda text: self._go_to(0.0),
            "end": lambda text: self._go_to(None),
            "break": self._add_breakpoint,
            "delete": self._delete_breakpoint,
            "breakpoints": lambda text: self._breakpoint_lines(),
            "threads": lambda text: text_views.thread_lines(debugger),
            "thread": self._choose_thread,
            "stack": lambda text: text_views.stack_lines(debugger.stack(), self._frame),
            "frame": self._choose_frame,
            "vars": lambda text: self._variable_lines(),
            "print": self._print,
            "readings": lambda text: text_views.reading_lines(debugger),
            "where": lambda text: [text_views.position_line(debugger)],
            "list": self._list,
            "effects": lambda text: text_views.effect_lines(debugger),
            "events": lambda text: text_views.event_lines(debugger),
            "help": lambda text: HELP.splitlines(),
            "quit": self._quit,
        }

    # --- state ----------------------------------------------------------------------------------------

    @property
    def frame(self) -> StackFrame | None:
        """The chosen frame of the followed thread."""
        frames = self.debugger.stack()
        return frames[min(self._frame, len(frames) - 1)] if frames else None

    @property
    def frame_number(self) -> int:
        """The number of the chosen frame, 0 for the innermost one."""
        return self._frame

    def execute(self, text: str) -> list[str]:
        """Execute a command; returns what it prints. Raises UsageError."""
        name, argument, is_back = _parsed(text)
        if not name:
            return []
        if name in self._moves:
            self._frame = 0
            if not self._moves[name](argument, is_back):
                return [_START if is_back else _END]
            return self._position()
        if name in self._views and not is_back:
            return self._views[name](argument)
        if name in self._views:
            raise UsageError(f"'{name}' does not go backward; these do: {', '.join(self._moves)}")
        known = [*self._moves, *self._views]
        raise UsageError(f"'{name}' is not a command here; {choice(name, known, 'commands:')}")

    def _position(self) -> list[str]:
        frame = self.frame
        lines = [text_views.position_line(self.debugger)]
        if (turn := self.debugger.first_difference) is not None:
            lines.append(f"the replay differs from the recording from turn {turn} on: see 'lfield replay'")
        if frame is not None and frame.line is not None:
            lines += text_views.source_lines(self.debugger, frame.line, 0, 0)
        return lines

    # --- moves ----------------------------------------------------------------------------------------

    def _search(self, target: Target, back: bool) -> bool:
        return self.debugger.search(target, backward=back)

    def _go_to_time(self, text: str) -> list[str]:
        try:
            seconds = float(text)
        except ValueError:
            seconds = math.nan
        if math.isnan(seconds):
            raise UsageError(f"'{text}' is not a time in seconds")
        return self._go_to(seconds)

    def _go_to(self, seconds: float | None) -> list[str]:
        self._frame = 0
        if seconds is None:
            self.debugger.go_to(self.debugger.team.end)
        else:
            self.debugger.go_to_time(seconds)
        return self._position()

    # --- breakpoints ----------------------------------------------------------------------------------

    def _add_breakpoint(self, text: str) -> list[str]:
        matched = _BREAK.fullmatch(text.strip())
        if matched is None:
            raise UsageError("a breakpoint is FILE:LINE or LINE, then 'if' and a condition")
        file = matched["file"] or (self.frame.line.file if self.frame and self.frame.line else "")
        table = self.debugger.team.table
        if not file or table.source(file) is None:
            raise UsageError(f"'{file}' is not a source of this mission")
        line = table.next_line(file, int(matched["line"]))
        if line is None:
            raise UsageError(f"{file} has no statement from line {matched['line']} on")
        condition = self.debugger.condition(matched["condition"]) if matched["condition"] else None
        self.debugger.add_breakpoint(Breakpoint(file, line, condition))
        return self._breakpoint_lines()[-1:]

    def _delete_breakpoint(self, text: str) -> list[str]:
        number = _index(text, len(self.debugger.breakpoints), "breakpoint", 1)
        self.debugger.remove_breakpoint(self.debugger.breakpoints[number - 1])
        return self._breakpoint_lines()

    def _breakpoint_lines(self) -> list[str]:
        return [
            f"{number}  {each.file}:{each.line}" + (f" if {each.condition.text}" if each.condition else "")
            for number, each in enumerate(self.debugger.breakpoints, 1)
        ]

    # --- inspection -----------------------------------------------------------------------------------

    def _choose_thread(self, text: str) -> list[str]:
        found = self.debugger.find_thread(text)
        if found is None:
            names = [each.name for each in self.debugger.threads()]
            raise UsageError(f"there is no thread '{text}' at this time; {choice(text, names, 'threads:')}")
        self._frame = 0
        self.debugger.choose(found.key)
        return self._position()

    def _choose_frame(self, text: str) -> list[str]:
        self._frame = _index(text, len(self.debugger.stack()) - 1, "frame", 0)
        return text_views.stack_lines(self.debugger.stack(), self._frame)

    def _variable_lines(self) -> list[str]:
        return [] if self.frame is None else text_views.variable_lines(self.debugger, self.frame)

    def _print(self, text: str) -> list[str]:
        try:
            value, variable = self.debugger.evaluate(_required(text), self.frame)
        except ValueUnknown as error:
            return [f"no value: {error}"]
        if variable is None or self.frame is None:
            return [f"{text} = {value_text(value)}"]
        return self._tree(variable, 0)

    def _tree(self, variable: Variable, depth: int) -> list[str]:
        lines = [text_views.variable_line(variable, depth)]
        if depth < PRINT_DEPTH and self.frame is not None:
            for part in self.debugger.parts(self.frame, variable):
                lines += self._tree(part, depth + 1)
        return lines

    def _list(self, text: str) -> list[str]:
        count = int(text) if text.isdigit() else text_views.CONTEXT
        line = self.frame.line if self.frame is not None else None
        return text_views.source_lines(self.debugger, line, count, count)

    def _quit(self, text: str) -> list[str]:
        self.is_done = True
        return []


def _parsed(text: str) -> tuple[str, str, bool]:
    """The command, its argument, and whether it goes backward."""
    name, _, arguments = text.strip().partition(" ")
    parts = f"{SHORT.get(name, name)} {arguments}".split()
    is_back = bool(parts) and parts[0] == "back"
    if is_back:
        parts = parts[1:]
        if parts:
            parts = [*SHORT.get(parts[0], parts[0]).split(), *parts[1:]]
    elif len(parts) > 1 and parts[-1] == "back":
        is_back, parts = True, parts[:-1]
    return (parts[0], " ".join(parts[1:]), is_back) if parts else ("", "", False)


def _required(text: str) -> str:
    if not text:
        raise UsageError("an expression is missing")
    return text


def _index(text: str, largest: int, kind: str, smallest: int) -> int:
    if not text.isdigit() or not smallest <= int(text) <= largest:
        raise UsageError(f"there is no {kind} '{text}'")
    return int(text)
