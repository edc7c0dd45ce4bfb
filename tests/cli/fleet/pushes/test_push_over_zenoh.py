"""Services, their missions and the desk in a Zenoh fabric, whose router fails."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from fabric import running_router
from loop_bench import TIMEOUT
from robots import told

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")
pytestmark = pytest.mark.process
router = pytest.fixture(running_router)


def command_lines() -> Iterator[bytes]:
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            yield path.read_bytes()


@pytest.mark.few(0)
def test_a_bundle_is_pushed_and_started_over_a_restarted_router(lfield, robots, router):
    team = robots("alpha", "bravo", router=router.endpoint)
    team.up()
    team.mission(pause=3.0)
    pushed = told(lfield("push", "mission.dL", "--json"))
    assert (pushed["outcome"], pushed["votes"]) == ("activated", {"alpha": "yes", "bravo": "yes"})
    router.kill()
    router.start()
    end = time.monotonic() + TIMEOUT
    hosts: set[bytes] = set()
    started = lfield.start("start", "--json")
    # The hosts may have ended before the command has.
    while not hosts or started.popen.poll() != 0:
        hosts |= {each for each in command_lines() if b"lfield\0up\0" in each}
        assert time.monotonic() < end, started.said
        if started.popen.poll():
            # The services reconnect to the router automatically.
            started = lfield.start("start", "--json")
        time.sleep(0.05)
    team.services["bravo"].wait_for("^visit 1$")
    # Other users read command lines, and the section may have a password.
    assert not any(router.endpoint.encode() in each for each in hosts)
    team.services["alpha"].wait_for("status 0")

    team.mission(text="call")
    push = lfield.start("push", "mission.dL", "--json")
    router.kill()
    router.start()
    push.wait()
    states = told(lfield("status", "--json"))
    assert len({each["bundle"] for each in states.values()}) == 1
    if lfield.status(push):
        push = lfield("push", "mission.dL", "--json")
    assert told(push)["outcome"] == "activated"
