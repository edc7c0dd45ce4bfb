"""One session of the Debug Adapter Protocol: requests of an editor in, responses and events out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from lfield.cli.debugging.command_line import DebuggerCommands
from lfield.cli.debugging.dap.dap_values import DapValues, Row
from lfield.cli.debugging.dap.dap_wire import DapStream, Message, RequestQueue
from lfield.errors import LfieldError, UsageError
from lfield.replay.debugger.debugger import Breakpoint, Debugger
from lfield.replay.debugger.expressions import ValueUnknown, value_text
from lfield.replay.debugger.host_timeline import SearchCancelled
from lfield.replay.debugger.moment import Target
from lfield.replay.debugger.targets import AnyTarget, StatementTarget

CAPABILITIES = {
    "supportsConfigurationDoneRequest": True,
    "supportsConditionalBreakpoints": True,
    "supportsStepBack": True,
    "supportsEvaluateForHovers": True,
    "supportsTerminateRequest": True,
    "supportsCancelRequest": True,
    "exceptionBreakpointFilters": [
        {"filter": "portal", "label": "Portal calls"},
        {"filter": "hop", "label": "Hops"},
        {"filter": "device", "label": "Calls of devices"},
        {"filter": "event", "label": "Events"},
    ],
}
#: The prefix of a command of the terminal in an expression to evaluate: `:time 12.5`.
COMMAND = ":"
#: Requests that end a search.
ENDING = frozenset({"cancel", "pause", "disconnect", "terminate"})


class OpenedDebugger(NamedTuple):
    """A debugger, and the folder of the source files, None where they are unknown."""

    debugger: Debugger
    folder: Path | None


#: Opens the recordings or mission in the arguments of a request `launch` or `attach`.
OpenDebugger = Callable[[Mapping[str, Any]], OpenedDebugger]


class DapSession:
    """Serves one client. `open_debugger` is called once, with the arguments of `launch` or `attach`."""

    def __init__(self, stream: DapStream, open_debugger: OpenDebugger) -> None:
        self._stream, self._open = stream, open_debugger
        self._requests = RequestQueue(stream)
        self._debugger: Debugger | None = None
        self._values: DapValues | None = None
        self._commands: DebuggerCommands | None = None
        self._stops_at_entry = True
        self._is_done = self._is_moving = False
        self._breakpoints: dict[str, list[Breakpoint]] = {}
        self._filters: list[str] = []
        self._handlers: Mapping[str, Callable[[Row], Row | None]] = {
            "initialize": lambda arguments: CAPABILITIES,
            "launch": self._launch,
            "attach": self._launch,
            "setBreakpoints": self._set_breakpoints,
            "setExceptionBreakpoints": self._set_filters,
            "configurationDone": lambda arguments: None,
            "threads": lambda arguments: self._threads(),
            "stackTrace": self._stack_trace,
            "scopes": self._scopes,
            "variables": lambda arguments: {
                "variables": self._known.rows(arguments.get("variablesReference"))
            },
            "evaluate": self._evaluate,
            "source": self._source,
            "pause": lambda arguments: None,
            "cancel": lambda arguments: None,
            "search": self._check_search,
            "gotoTime": self._check_time,
            "disconnect": self._end,
            "terminate": self._end,
        }
        #: Requests that move: they are answered first, and an event has the position after that.
        self._moves: Mapping[str, Callable[[Debugger], bool]] = {
            "next": lambda debugger: debugger.step_over(),
            "stepIn": lambda debugger: debugger.step_line(),
            "stepOut": lambda debugger: debugger.step_out(),
            "stepBack": lambda debugger: debugger.step_over(backward=True),
        }

    def serve(self) -> None:
        """Handle requests until the client disconnects."""
        while not self._is_done and (message := self._requests.next()) is not None:
            if message.get("type") == "request":
                self._handle(message)

    def _handle(self, request: Message) -> None:
        command, arguments = str(request.get("command")), request.get("arguments")
        arguments = arguments if isinstance(arguments, dict) else {}
        try:
            if command in self._moves or command in ("continue", "reverseContinue"):
                self._ready.choose(self._chosen(arguments))
                self._respond(request, {"allThreadsContinued": True})
            elif command in self._handlers:
                self._respond(request, self._handlers[command](arguments))
            else:
                raise UsageError(f"the request {command} is not supported")
            self._after(command, arguments)
        except SearchCancelled:
            self._stopped("pause", "the search was cancelled")
        except (LfieldError, ValueUnknown) as error:
            self._refuse(request, str(error))
        except (ValueError, TypeError, AttributeError):
            self._refuse(request, f"the arguments of {command} are not those of the protocol")

    def _respond(self, request: Message, body: Row | None) -> None:
        self._stream.write({**_reply(request), "success": True, "body": body or {}})

    def _refuse(self, request: Message, reason: str) -> None:
        self._stream.write({**_reply(request), "success": False, "message": reason})

    def _event(self, name: str, body: Row | None = None) -> None:
        self._stream.write({"type": "event", "event": name, "body": body or {}})

    # --- moves ----------------------------------------------------------------------------------------

    def _after(self, command: str, arguments: Row) -> None:
        """Handle the events and moves that follow a response. Raises SearchCancelled."""
        self._is_moving = True
        try:
            self._follow(command, arguments)
        finally:
            self._is_moving = False

    def _follow(self, command: str, arguments: Row) -> None:
        if command in self._moves:
            is_found = self._moves[command](self._ready)
            self._stopped("step", "" if is_found else "there is no further statement")
        elif command in ("launch", "attach"):
            # Not earlier: breakpoints, which the editor sends next, need the program.
            self._event("initialized")
        elif command in ("continue", "reverseContinue"):
            self._resume(backward=command == "reverseContinue")
        elif command == "configurationDone":
            self._enter()
        elif command == "gotoTime":
            self._ready.go_to_time(_seconds(arguments))
            self._stopped("goto")
        elif command == "search":
            is_found = self._ready.search(self._searched(arguments), backward=bool(arguments.get("backward")))
            self._stopped("goto", "" if is_found else "nothing was found")
        elif command == "pause":
            self._stopped("pause")
        elif command == "evaluate" and str(arguments.get("expression", "")).startswith(COMMAND):
            self._stopped("goto")
        elif command in ("disconnect", "terminate"):
            self._event("terminated")

    def _enter(self) -> None:
        self._ready.enter()
        if self._stops_at_entry:
            self._stopped("entry")
        else:
            self._resume(backward=False)

    def _resume(self, *, backward: bool) -> None:
        debugger = self._ready
        target = AnyTarget([*(debugger.target_of(each) for each in debugger.breakpoints), *self._filtered()])
        if debugger.search(target, backward=backward):
            self._stopped("breakpoint")
            return
        debugger.go_to(debugger.team.start if backward else debugger.team.end)
        self._stopped("pause", f"the {'start' if backward else 'end'} of the recording")

    def _filtered(self) -> list[Target]:
        debugger = self._ready
        makers: Mapping[str, Callable[[], Target]] = {
            "portal": debugger.portal_target,
            "hop": debugger.hop_target,
            "device": debugger.device_target,
            "event": debugger.event_target,
        }
        return [makers[name]() for name in self._filters if name in makers]

    def _check_search(self, arguments: Row) -> None:
        self._searched(arguments)

    def _check_time(self, arguments: Row) -> None:
        _seconds(arguments)

    def _searched(self, arguments: Row) -> Target:
        """The target of the custom request `search`: `kind`, and `text` where it needs one."""
        debugger, text = self._ready, str(arguments.get("text", ""))
        match arguments.get("kind"):
            case "portal":
                return debugger.portal_target()
            case "device":
                return debugger.device_target()
            case "hop":
                return debugger.hop_target(text)
            case "event":
                return debugger.event_target(text.split())
            case "condition":
                return debugger.condition_target(text)
            case "change":
                return debugger.change_target(text)
            case "statement":
                return StatementTarget(text)
        raise UsageError("'kind' is portal, device, hop, event, condition, change or statement")

    def _stopped(self, reason: str, text: str = "") -> None:
        debugger, values = self._ready, self._known
        values.forget()
        place = f"{debugger.seconds:.6f} s on {debugger.host}"
        body: Row = {"reason": reason, "description": place, "allThreadsStopped": True}
        if debugger.focus is not None:
            body["threadId"] = values.thread_number(debugger.focus)
        if text:
            body["text"] = text
        self._event("stopped", body)

    # --- requests -------------------------------------------------------------------------------------

    @property
    def _ready(self) -> Debugger:
        if self._debugger is None:
            raise UsageError("nothing is being debugged: send 'launch' or 'attach' first")
        return self._debugger

    @property
    def _known(self) -> DapValues:
        if self._values is None:
            raise UsageError("nothing is being debugged: send 'launch' or 'attach' first")
        return self._values

    def _launch(self, arguments: Row) -> None:
        debugger, folder = self._open(arguments)
        self._debugger, self._values = debugger, DapValues(debugger, folder)
        self._commands = DebuggerCommands(debugger)
        debugger.team.watch_progress(lambda seconds: self._check_cancelled())
        self._stops_at_entry = arguments.get("stopOnEntry") is not False

    def _check_cancelled(self) -> None:
        if self._is_moving and self._requests.has_waiting(ENDING):
            raise SearchCancelled

    def _set_breakpoints(self, arguments: Row) -> Row:
        path = str(arguments.get("source", {}).get("path") or arguments.get("source", {}).get("name", ""))
        found: list[Breakpoint] = []
        rows = [self._breakpoint(path, each, found) for each in arguments.get("breakpoints", [])]
        self._breakpoints[path] = found
        self._ready.replace_breakpoints([each for group in self._breakpoints.values() for each in group])
        return {"breakpoints": rows}

    def _breakpoint(self, path: str, arguments: Row, found: list[Breakpoint]) -> Row:
        number, text = arguments.get("line"), arguments.get("condition")
        line = self._ready.team.table.next_line(path, number) if isinstance(number, int) else None
        if line is None:
            return {"verified": False, "message": "no statement from this line on"}
        try:
            condition = self._ready.condition(str(text)) if text else None
        except UsageError as error:
            return {"verified": False, "line": number, "message": str(error)}
        found.append(Breakpoint(path, line, condition))
        return {"verified": True, "line": line}

    def _set_filters(self, arguments: Row) -> None:
        self._filters = [str(each) for each in arguments.get("filters", [])]

    def _threads(self) -> Row:
        number = self._known.thread_number
        rows = [
            {"id": number(each.key), "name": f"{each.name} on {each.host}: {each.state}"}
            for each in self._ready.threads()
        ]
        return {"threads": rows or [{"id": 1, "name": "no thread runs"}]}

    def _chosen(self, arguments: Row) -> Any:
        """The thread that a request names, or the one that is followed."""
        return self._known.key_of(int(arguments.get("threadId", 0))) or self._ready.focus

    def _stack_trace(self, arguments: Row) -> Row:
        frames = self._ready.stack(self._chosen(arguments))
        first, levels = (
            int(arguments.get("startFrame") or 0),
            int(arguments.get("levels") or 0) or len(frames),
        )
        rows = [self._known.frame_row(each) for each in frames[first : first + levels]]
        return {"stackFrames": rows, "totalFrames": len(frames)}

    def _scopes(self, arguments: Row) -> Row:
        frame = self._known.frame(arguments.get("frameId"))
        return {"scopes": [] if frame is None else self._known.scope_rows(frame)}

    def _evaluate(self, arguments: Row) -> Row:
        text, frame = str(arguments.get("expression", "")), self._known.frame(arguments.get("frameId"))
        if text.startswith(COMMAND) and self._commands is not None:
            lines = self._commands.execute(text[len(COMMAND) :])
            return {"result": "\n".join(lines), "variablesReference": 0}
        value, variable = self._ready.evaluate(text, frame)
        if variable is None:
            return {"result": value_text(value), "variablesReference": 0}
        frames = [frame] if frame is not None else self._ready.stack()
        row = self._known.variable_row(frames[0], variable)
        return {"result": row["value"], "type": row["type"], "variablesReference": row["variablesReference"]}

    def _source(self, arguments: Row) -> Row:
        reference = arguments.get("sourceReference") or arguments.get("source", {}).get("sourceReference")
        text = self._known.source_text(reference)
        if text is None:
            raise UsageError("this source is not in the bundle")
        return {"content": text}

    def _end(self, arguments: Row) -> None:
        self._is_done = True


def _seconds(arguments: Row) -> float:
    """The time of `gotoTime`. Raises UsageError."""
    found = arguments.get("seconds")
    if isinstance(found, bool) or not isinstance(found, int | float) or math.isnan(found):
        raise UsageError("'seconds' must be a number")
    return float(found)


def _reply(request: Message) -> Message:
    return {"type": "response", "request_seq": request.get("seq", 0), "command": request.get("command", "")}
