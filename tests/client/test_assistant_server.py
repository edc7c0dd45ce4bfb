"""The server for AI assistants and a client of the package `mcp`, in one process and without hosts."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING

import anyio
import pytest

from lfield.client.team_selection import TeamSelection
from lfield.errors import NoMissionRunning, OutputFileError

if TYPE_CHECKING:
    from mcp.client.session import ClientSession

#: A tool and its arguments. No mission runs in these tests.
STATUS = ("status", {})


class RecordedLog:
    """A server for assistants whose connection to the team fails with `error`, and its log lines."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
        # The package takes half a second to import, in each worker.
        from lfield.client.assistants import assistant_server

        self.lines: list[tuple[str, str]] = []
        self.server = assistant_server.AssistantServer(TeamSelection(), "anna", self._add)

        def connect(*_: object, **__: object) -> None:
            raise error

        monkeypatch.setattr(assistant_server, "connect", connect)

    def _add(self, line) -> None:
        self.lines.append((line.code, str(line)))

    async def run(self, scenario: Callable[[ClientSession, object], Awaitable[None]]) -> None:
        """Run `scenario` with the session of a client, and the stream of lines that the client sends."""
        from mcp.client.session import ClientSession

        to_server, server_in = anyio.create_memory_object_stream(16)
        to_client, client_in = anyio.create_memory_object_stream(16)
        serving = asyncio.create_task(self.server.serve_streams(server_in, to_client))
        async with client_in, to_server, ClientSession(client_in, to_server) as session:
            await session.initialize()
            await scenario(session, to_server)
        await serving

    def of(self, code: str) -> list[str]:
        return [text for found, text in self.lines if found == code]


@pytest.mark.parametrize(
    ("error", "code"), [(NoMissionRunning("nothing runs"), "no-mission-running"), (KeyError("x"), "bug")]
)
def test_lfield_error_and_bug_are_returned_and_logged_with_their_codes(monkeypatch, error, code):
    log = RecordedLog(monkeypatch, error)

    async def scenario(session, _) -> None:
        found = await session.call_tool(*STATUS)
        assert found.is_error
        assert json.loads(found.content[0].text)["code"] == code

    asyncio.run(log.run(scenario))
    (ended,) = log.of("assistant-answered")
    assert f"ended: {code}: " in ended


def test_a_call_that_cannot_be_logged_is_not_executed(monkeypatch) -> None:
    from lfield.client.assistants.assistant_server import AssistantServer

    log = RecordedLog(monkeypatch, KeyError("executed"))

    def fail(line) -> None:
        raise OutputFileError("assistant.log", "No space left on device")

    log.server = AssistantServer(TeamSelection(), "anna", fail)

    async def scenario(session, _) -> None:
        found = await session.call_tool(*STATUS)
        assert json.loads(found.content[0].text)["code"] == OutputFileError.code

    asyncio.run(log.run(scenario))


def test_invalid_line_is_logged_and_the_next_request_is_answered(monkeypatch) -> None:
    log = RecordedLog(monkeypatch, NoMissionRunning("nothing runs"))

    async def scenario(session, lines) -> None:
        await lines.send(ValueError("Invalid JSON\nat column 1"))
        assert (await session.call_tool(*STATUS)).is_error

    asyncio.run(log.run(scenario))
    assert len(log.of("assistant-line-skipped")) == 1
    assert len(log.of("assistant-answered")) == 1


def test_a_request_that_the_protocol_refuses_is_logged_with_its_method(monkeypatch) -> None:
    from mcp.shared.exceptions import MCPError

    log = RecordedLog(monkeypatch, NoMissionRunning("nothing runs"))

    async def scenario(session, _) -> None:
        with pytest.raises(MCPError):
            await session.list_resources()

    asyncio.run(log.run(scenario))
    (refused,) = log.of("assistant-request-refused")
    assert "resources/list of assistant of anna (mcp)" in refused


@pytest.mark.parametrize("value", [2**70, -(2**70), float("nan"), [[[[]]]], "\u202e\x1b[2J", None])
def test_every_argument_is_logged_and_answered(monkeypatch, value) -> None:
    log = RecordedLog(monkeypatch, NoMissionRunning("nothing runs"))

    async def scenario(session, _) -> None:
        found = await session.call_tool("call", {"agent": "a", "portal": "p", "arguments": [value]})
        assert json.loads(found.content[0].text)["code"] == "no-mission-running"

    asyncio.run(log.run(scenario))
    assert len(log.of("assistant-called")) == len(log.of("assistant-answered")) == 1
