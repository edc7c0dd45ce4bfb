"""Clients without keys that connect at the highest rate and send nothing: guards keep their periods, a stop
arrives.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest
from test_flooding_member import DEPLOYMENT, PROGRAM

pytestmark = pytest.mark.process

FLOODERS = 2


@pytest.mark.few(0)
@pytest.mark.parametrize("keep", [0, 200])
def test_idle_connections_do_not_block_members_or_a_stop(lfield, alone, keep):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    maps = lfield.maps(["alpha", "bravo", "charlie"])
    team = ("--deploy", deployment, *maps)
    up = ("up", *team, "--sim", "--first-start", "--host")
    alpha = lfield.start(*up, "alpha", env=alone)
    alpha.wait_for("alpha listening")
    arguments = [
        sys.executable,
        str(Path(__file__).with_name("connecting.py")),
        maps[1].rpartition(":")[2],
        str(keep),
    ]
    with ExitStack() as stack:
        flooders = [
            stack.enter_context(
                subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True, env=lfield.environment)
            )
            for _ in range(FLOODERS)
        ]
        for flooder in flooders:
            stack.callback(flooder.kill)
            assert flooder.stdout is not None
        counts = [int(flooder.stdout.readline()) for flooder in flooders]
        started = time.monotonic()
        lfield.start(*up, "charlie", env=alone)
        alpha.wait_for("greeted")
        linked = time.monotonic() - started
        alpha.wait_for("flies")
        started = time.monotonic()
        pressed = lfield("estop", *team, "--no-wait", env=alone)
        elapsed = time.monotonic() - started
        assert "alpha: lead.fc: safe" in pressed.out, pressed.said
        status = json.loads("\n".join(lfield("ps", *team, "--json", env=alone).out))
    print(
        f"{sum(counts)} connections in the first second, {keep} kept: beats were late by "
        f"{status['alpha']['late']} s at most, a link took {linked:.2f} s, a stop {elapsed:.2f} s"
    )
    assert "the host was silent" not in alpha.said
