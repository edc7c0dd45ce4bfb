"""Programs in Python and robots with services: start, portal calls and stop with the keys of persons."""

from __future__ import annotations

import asyncio
import subprocess
import sys

import pytest
from client_pages import program_of_page

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
    pushed = here("push", "mission.dL")
    assert pushed.status == 0, pushed.err
    return team


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


def test_a_person_without_rights_is_refused_and_the_mission_continues(active, lfield, here) -> None:
    assert here("start").status == 0
    keys = lfield.keys.folder / "eve"
    lfield.keys.put("eve", lfield.keys.made("person", "eve", Right.OBSERVE))

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
