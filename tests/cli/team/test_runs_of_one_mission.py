"""Whoever runs here is found: two teams of one mission, one host alone, what was killed, what others ask."""

from __future__ import annotations

import json
import os
import re
import signal
import time

import pytest

pytestmark = pytest.mark.process

PROGRAM = """
resource Post { init(string[] arg) { write("posted\\n"); while (true) yield(); } }
coordinator Guest { init(string[] arg) { sleep(1000.0); } }
"""
DEPLOYMENT = "//Post:near@alpha\n//Guest:tom@alpha\n//Post:far@bravo\n"


@pytest.fixture
def own(tmp_path_factory, alone):
    """The environment of commands that find no run but those of one test, not even a service's."""
    nowhere = tmp_path_factory.mktemp("nowhere")
    return {**alone, "TMPDIR": str(nowhere), "RUNTIME_DIRECTORY": f"{nowhere}/lfield"}


@pytest.fixture
def mission(lfield):
    return lfield.mission(PROGRAM, DEPLOYMENT)


def up(lfield, own, mission, *words):
    """A run whose agents have started."""
    run = lfield.start("up", "--deploy", mission, *words, env=own)
    for _ in ("alpha", "bravo") if "--all" in words else words[:1]:
        run.wait_for("posted")
    return run


def test_a_team_is_still_found_when_another_of_its_mission_has_ended(lfield, own, mission):
    first = up(lfield, own, mission, "--all", "--sim")
    second = up(lfield, own, mission, "--all", "--sim")
    for run, other in ((second, first), (first, None)):
        run.signal(signal.SIGTERM)
        run.wait()
        if other:
            shown = lfield("ps", "--deploy", mission, env=own)
            assert lfield.status(shown) == 0, shown.said
            stopped = lfield("estop", "--deploy", mission, env=own)
            assert lfield.status(stopped) == 0, stopped.said
            assert sorted(stopped.out) == ["alpha: has no devices", "bravo: has no devices"]
            other.wait_for(r"alpha +\| .*EMERGENCY STOP")
            other.wait_for(r"bravo +\| .*EMERGENCY STOP")
        assert all("No such file" not in line for line in run.err)


def test_one_host_by_itself_is_found(lfield, own, mission):
    maps = lfield.maps(["alpha", "bravo"])
    up(lfield, own, mission, "--host", "alpha", *maps)
    shown = lfield("ps", "--deploy", mission, env=own)
    assert lfield.status(shown) == 69
    assert any(re.match("alpha +near +Post", line) for line in shown.out), shown.said
