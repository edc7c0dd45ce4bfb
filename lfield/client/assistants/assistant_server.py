"""Serves the tools for AI assistants on stdin and stdout, by the package `mcp` (Model Context Protocol).

Each call connects to the team anew: the mission may have started, ended or moved since the last one. Its
errors are results, which the assistant reads; none ends the server.
"""

from __future__ import annotations

import asyncio
import json
import signal
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import anyio
from mcp.server.context import CallNext, HandlerResult
from mcp.server.lowlevel.server import Server
from mcp.server.stdio import stdio_server
from mcp.shared.message import SessionMessage
from mcp_types import (
    CallToolRequestParams,
    CallToolResult,
    ListToolsResult,
    TextContent,
    Tool,
    ToolAnnotations,
)

from lfield import __version__
from lfield.client.assistants.assistant_tools import TOOLS, as_json, find_tool
from lfield.client.team import CLOSE_TIMEOUT, connect
from lfield.client.team_selection import TeamSelection
from lfield.errors import LfieldError, OutputFileError, ProgramError
from lfield.event_loop import spawn
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.wire.fields import MAX_LABEL, truncate

#: A message, or why a line is not one.
Received = SessionMessage | Exception

INSTRUCTIONS = (
    "A team of robots that runs a mission in the language L. Hosts refuse 'start' and 'call' unless the "
    "access file of the mission permits assistants. No tool stops the team: a person does."
)


class AssistantServer:
    """The tools of one team for the assistant of `person`; `log` writes a line."""

    def __init__(self, selection: TeamSelection, person: str, log: Callable[[LogLine], None]) -> None:
        self._selection, self._person, self._log = selection, person, log
        self._server = Server[dict[str, Any]](
            "lfield",
            version=__version__,
            instructions=INSTRUCTIONS,
            on_list_tools=self._list_tools,
            on_call_tool=self._call_tool,
        )
        # Only answers leave this process.
        self._server.middleware[:] = [self._log_refusals]
        self._calls: set[asyncio.Task[CallToolResult]] = set()

    async def serve(self) -> None:
        """Serve until stdin ends, or a signal ends the process; portals that still run are cancelled."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, lambda at: spawn(self._end_by(at)), number)
        async with stdio_server() as (source, sink):
            await self.serve_streams(source, sink)

    async def serve_streams(self, source: Any, sink: Any) -> None:
        """Serve until the source ends; it yields an exception for a line that is not a message."""
        forward, messages = anyio.create_memory_object_stream[Received]()
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._forward(source, forward))
            await self._server.run(messages, sink, self._server.create_initialization_options())
        await self._cancel_calls()

    async def _forward(self, source: Any, sink: Any) -> None:
        async with source, sink:
            async for item in source:
                if isinstance(item, Exception):
                    self._note(
                        log_messages.ASSISTANT_LINE_SKIPPED.line(reason=truncate(str(item), MAX_LABEL))
                    )
                else:
                    await sink.send(item)

    async def _log_refusals(self, ctx: Any, call_next: CallNext) -> HandlerResult:
        try:
            return await call_next(ctx)
        except Exception as error:
            method, reason = truncate(ctx.method, MAX_LABEL), truncate(str(error), MAX_LABEL)
            caller = self._caller(ctx)
            self._note(log_messages.ASSISTANT_REFUSED.line(method=method, caller=caller, reason=reason))
            raise

    async def _end_by(self, number: int) -> None:
        await self._cancel_calls()
        # A thread waits for stdin: only the signal itself ends the process.
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)

    async def _cancel_calls(self) -> None:
        for call in self._calls:
            # A second cancellation would end the first one, which is on its way to the host.
            if not call.cancelling():
                call.cancel()
        if self._calls:
            await asyncio.wait(self._calls, timeout=CLOSE_TIMEOUT)

    async def _list_tools(self, *_: object) -> ListToolsResult:
        return ListToolsResult(
            tools=[
                Tool(
                    name=name,
                    description=tool.description,
                    input_schema=tool.schema,
                    annotations=ToolAnnotations(
                        read_only_hint=not tool.may_move, destructive_hint=tool.may_move
                    ),
                )
                for name, tool in TOOLS.items()
            ]
        )

    async def _call_tool(self, context: Any, params: CallToolRequestParams) -> CallToolResult:
        call = asyncio.create_task(self._logged_result(self._caller(context), params))
        self._calls.add(call)
        call.add_done_callback(self._calls.discard)
        try:
            # The package cancels this task again and again; a portal call needs time to be cancelled.
            await asyncio.wait([call])
        except asyncio.CancelledError:
            call.cancel()
            raise
        return call.result()

    def _note(self, line: LogLine) -> None:
        with suppress(OutputFileError):
            self._log(line)

    def _caller(self, context: Any) -> str:
        client = context.session.client_params
        program = f" ({client.client_info.name})" if client is not None else ""
        return truncate(f"assistant of {self._person}{program}", MAX_LABEL)

    async def _logged_result(self, caller: str, params: CallToolRequestParams) -> CallToolResult:
        arguments = params.arguments or {}
        arguments_text = truncate(json.dumps(arguments, separators=(",", ":")), MAX_LABEL)
        name = truncate(params.name, MAX_LABEL)
        outcome, is_error = "cancelled", True
        try:
            # A call that cannot be logged is not executed.
            self._log(log_messages.ASSISTANT_CALLED.line(tool=name, caller=caller, arguments=arguments_text))
            text = as_json(await self._result(params.name, arguments))
            outcome, is_error = "answered", False
        except Exception as error:
            data = _error_data(error)
            text = as_json(data)
            outcome = truncate(f"{data['code']}: {data['error']}", MAX_LABEL)
        finally:
            self._note(log_messages.ASSISTANT_ANSWERED.line(tool=name, caller=caller, outcome=outcome))
        return CallToolResult(content=[TextContent(text=text)], is_error=is_error)

    async def _result(self, name: str, arguments: Mapping[str, Any]) -> object:
        tool = find_tool(name)
        call_arguments = tool.parse(arguments)
        where = self._selection
        async with connect(
            where.mission,
            run=where.run,
            maps=where.maps,
            inventory=where.inventory,
            keys=where.keys,
            is_assistant=True,
        ) as team:
            return await tool.run(team, call_arguments)


def _error_data(error: Exception) -> Mapping[str, object]:
    if not isinstance(error, LfieldError):
        error = LfieldError(f"bug in lfield: {type(error).__name__}: {error}")
    found = error.as_data()
    if isinstance(error, ProgramError):
        found["error"] = "\n".join(each.render() for each in error.diagnostics)
    return found


def serve_assistant(selection: TeamSelection, person: str, log: Callable[[LogLine], None]) -> None:
    """Serve until stdin ends."""
    asyncio.run(AssistantServer(selection, person, log).serve())
