"""Python programs, AI assistants, robots with services: start, portal calls and stop with personal keys."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from pathlib import Path

import pytest
from client_pages import assistant_command, program_of_page

from lfield.authority.identity import Right
from lfield.client import connect
from lfield.errors import PortalCallRefused

pytestmark = pytest.mark.process

PROGRAM = """
resource Post {
    int count;
    init(string[] arg) { }
    portal count(int n) emit int { count = count + n; return count; }
    portal visit() { }
    portal hold(real seconds) { sleep(seconds); }
}
coordinator Walker { init(string[] arg) { findPost("post").visit(); sleep(600.0); } }
"""
TEAM = "//Walker:tom@alpha\n//Post:post@bravo\n"


@pytest.fixture
def active(here, robots, lfield):
    """Robots on which a signed bundle is active, with `post.count` open to persons."""
    team = robots("alpha", "bravo")
    team.up()
    lfield.write("mission.access.yaml", "calls:\n  others: {Post: [count]}\n")
    lfield.mission(PROGRAM, TEAM)
    here("push", "mission.dL", status=0)
    return team


@pytest.mark.few(0)
def test_the_program_of_the_page_starts_calls_and_stops(active, lfield, alone) -> None:
    file = lfield.write("visit.py", program_of_page("visit.py"))
    ended = subprocess.run(
        [sys.executable, file],
        cwd=lfield.folder,
        env={**lfield.environment, **alone},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines() == ["2", "alpha stopped", "bravo stopped"]


@pytest.mark.few(0)
def test_a_client_without_rights_is_refused_and_the_mission_continues(active, lfield, here) -> None:
    here("start", status=0)
    keys = lfield.keys.folder / "eve"
    lfield.keys.put("eve", lfield.keys.issue("person", "eve", Right.OBSERVE))

    async def eve() -> tuple[str, str, dict[str, object], dict[str, object]]:
        async with connect(keys=keys) as team:
            with pytest.raises(PortalCallRefused) as refused:
                await team.call("post", "count", 1)
            started = await team.start()
            stopped = await team.stop()
            orders = await team.pause()
            return refused.value.kind, str(started["text"]), stopped, orders

    async def operator() -> object:
        async with connect() as team:
            return await team.call("post", "count", 1)

    kind, text, stopped, orders = asyncio.run(eve())
    assert kind == "not-permitted"
    assert text
    assert {host: answer["code"] for host, answer in stopped.items()} == dict.fromkeys(
        active.hosts, "handshake"
    )
    assert {answer["code"] for answer in orders.values()} == {"handshake"}
    assert asyncio.run(operator()) == 1


@pytest.fixture
def assistant(lfield, alone):
    """`assistant(*words)(*calls)`: the results of tools of `lfield mcp`, called with the client package.

    With `last` the session ends after that call, while a portal runs.
    """
    from mcp.client.session import ClientSession
    from mcp.client.stdio import StdioServerParameters, stdio_client

    command, arguments = assistant_command()
    environment = {**lfield.environment, **alone}
    environment["PATH"] = f"{Path(sys.executable).parent}:{environment['PATH']}"

    def serve(*command_line):
        server = StdioServerParameters(
            command=command, args=[*arguments, *map(str, command_line)], env=environment, cwd=lfield.folder
        )

        async def results(calls, last):
            async with stdio_client(server) as (source, sink), ClientSession(source, sink) as session:
                await session.initialize()
                tools = (await session.list_tools()).tools
                assert {tool.name: tool.annotations.read_only_hint for tool in tools} == READ_ONLY
                answers = [await session.call_tool(name, given) for name, given in calls]
                if last is not None:
                    left = asyncio.create_task(session.call_tool(*HOLD))
                    await asyncio.to_thread(last)
            if last is not None:
                left.cancel()
            return [(answer.is_error, json.loads(answer.content[0].text)) for answer in answers]

        return lambda *calls, last=None: asyncio.run(results(calls, last))

    return serve


READ_ONLY = {"status": True, "query": True, "explain": True, "events": True, "start": False, "call": False}
COUNT = ("call", {"agent": "post", "portal": "count", "arguments": [2]})
HOLD = ("call", {"agent": "post", "portal": "hold", "arguments": [600.0], "timeout": 600.0})


@pytest.mark.few(0)
def test_rights_and_the_access_file_limit_an_assistant(active, assistant, lfield, here):
    lfield.keys.put("eve", lfield.keys.issue("person", "eve", Right.OBSERVE))
    (_, status), (_, started), *wrong = assistant("--keys", lfield.keys.folder / "eve")(
        ("status", {}), ("start", {}), ("start", {"with": []}), ("query", {"query": 5}), ("fly", {}), COUNT
    )
    # No host runs.
    assert {host["code"] for host in status.values()} == {"no-listener"}
    assert started["started"] is False
    assert {error["code"] for error in started["errors"].values()} == {"handshake"}
    codes = [(is_error, data["code"]) for is_error, data in wrong]
    assert codes == [(True, "usage"), (True, "usage"), (True, "usage"), (True, "no-listener")]
    logged = (lfield.folder / "assistant.log").read_text()
    assert "tool start called by assistant of eve (mcp): {}\n" in logged
    assert "tool fly called by assistant of eve (mcp) ended: usage: " in logged

    async def start() -> dict[str, object]:
        async with connect(is_assistant=True) as team:
            return await team.start()

    waits = asyncio.run(start())["waits"]
    assert all("'assistants'" in waits[host] for host in active.hosts)
    active.services["alpha"].wait_for("start of assistant of operator refused")
    lfield.write("mission.access.yaml", "calls:\n  others: {Post: all}\nassistants: [operator]\n")
    here("push", "mission.dL", status=0)
    log = active.services["bravo"]
    (_, started), counted, (_, stored) = assistant()(
        ("start", {}),
        COUNT,
        ("events", {"kinds": ["logged"]}),
        last=lambda: log.wait_for(r"post.hold\(\) called by assistant of person operator$"),
    )
    # The end of the session cancels the running portal call.
    log.wait_for(r"post.hold\(\) called by assistant of person operator ended: CancelledException")
    assert started["started"] is True
    assert counted == (False, {"value": 2})
    called = {event["text"] for event in stored["events"] if event["code"] == "portal-called"}
    assert called == {"post.count() called by assistant of person operator"}


def test_mcp_without_its_package_names_the_extra(here, monkeypatch):
    monkeypatch.setitem(sys.modules, "lfield.client.assistants.assistant_server", None)
    refused = here("mcp")
    assert (refused.status, "lfield[mcp]" in refused.err[0]) == (69, True)
