"""Hosts with IPv6 addresses, in the deployment and by `--map`: they link, and commands reach them."""

from __future__ import annotations

import socket

import pytest

pytestmark = pytest.mark.process

PROGRAM = """
resource Post { init(string[] arg) { } portal greet() { write("greeted\\n"); } }
coordinator Guest { init(string[] arg) { findPost("here").greet(); sleep(1000.0); } }
"""


def has_ipv6() -> bool:
    try:
        with socket.create_server(("::1", 0), family=socket.AF_INET6):
            return True
    except OSError:
        return False


@pytest.mark.few(0)
@pytest.mark.skipif(not has_ipv6(), reason="this computer has no IPv6")
def test_hosts_at_ipv6_addresses_link_and_are_queried_and_stopped(lfield, alone):
    one, two = lfield.ports.take(2)
    hosts = ["[::1]", "bravo"]
    lfield.keys.give(*hosts)
    deployment = lfield.mission(PROGRAM, f"//Post:here@[::1]:{one}\n//Guest:tom@bravo\n")
    team = ("--deploy", deployment, "--map", f"bravo=[::1]:{two}")
    up = ("up", *team, "--first-start", "--host")
    here = lfield.start(*up, "[::1]", env=alone)
    here.wait_for(rf"listening on \[::1\]:{one}")
    lfield.start(*up, "bravo", env=alone)
    here.wait_for("greeted")
    # Connect over the network, not over the sockets of the runs.
    maps = ("--map", f"[::1]=[::1]:{one}")
    lfield("ps", *team, *maps, env=alone, status=0)
    pressed = lfield("estop", *team, *maps, "--no-wait", env=alone, status=0)
    assert len(pressed.out) == 2, pressed.said
