"""`lfield up` and other commands in a Zenoh fabric of the inventory, with an unchanged program."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from fabric import Router, free_endpoint

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")
pytestmark = pytest.mark.process

EXAMPLE = Path(__file__).parents[3] / "examples" / "01-first-flight"
INVENTORY = """\
zenoh: {{connect: [{near}]}}
hosts:
  alpha: {{addresses: ["zenoh:alpha"]}}
  bravo: {{addresses: ["zenoh:bravo:8191"], zenoh: {{connect: [{far}]}}}}
"""
PROGRAM = """
resource Echo {
    init(string[] arg) { while (true) yield(); }
    portal say(string text) { write(text + "\\n"); }
}
coordinator Caller {
    init(string[] arg) { findEcho(arg[1]).say("here"); }
}
"""
DEPLOYMENT = "//Caller:tom@alpha?echo\n//Echo:echo@bravo\n"


@pytest.fixture
def routers():
    """Two linked routers, one for each site."""
    near = Router()
    far = Router(near.endpoint)
    yield near, far
    far.kill()
    near.kill()


def started(lfield, deployment: Path, inventory: Path, *options: object):
    """Both hosts, with keys."""
    lfield.keys.give("alpha", "bravo")
    arguments = (
        "up",
        "--deploy",
        deployment,
        "--inventory",
        inventory,
        "--until-done",
        "--first-start",
        *options,
    )
    return [lfield.start(*arguments, "--host", name) for name in ("alpha", "bravo")]


@pytest.mark.few(0)
def test_two_sites_fly_example_01(lfield, routers) -> None:
    shutil.copytree(EXAMPLE, lfield.folder / "01")
    near, far = (each.endpoint for each in routers)
    inventory = lfield.write("inventory.yaml", INVENTORY.format(near=near, far=far))
    hosts = started(lfield, lfield.folder / "01" / "mission.dL", inventory, "--sim")
    assert [host.wait() for host in hosts] == [0, 0]
    assert not any("unreachable" in line for host in hosts for line in host.err)


@pytest.mark.few(0)
def test_hosts_wait_for_a_router_that_starts_later(lfield) -> None:
    endpoint = free_endpoint()
    inventory = lfield.write("inventory.yaml", INVENTORY.format(near=endpoint, far=endpoint))
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    alpha, bravo = started(lfield, deployment, inventory, "--lost-after", "60")
    for host in (alpha, bravo):
        host.wait_for("not listening on zenoh:")
    router = Router(endpoint=endpoint)
    assert [alpha.wait(), bravo.wait()] == [0, 0]
    assert bravo.out == ["here"]
    router.kill()


@pytest.mark.few(0)
@pytest.mark.parametrize("named", [False, True])
def test_commands_beside_a_host_reach_others_over_the_routers_of_its_run(lfield, routers, alone, named):
    """The run determines the address and the routers, with and without --inventory."""
    near, far = (each.endpoint for each in routers)
    inventory = lfield.write("inventory.yaml", INVENTORY.format(near=near, far=far))
    deployment = lfield.mission(
        "resource Post { init(string[] arg) { } }", "//Post:a@alpha\n//Post:b@bravo\n"
    )
    lfield.keys.give("alpha", "bravo")
    arguments = ("up", "--deploy", deployment, "--inventory", inventory, "--first-start", "--host")
    alpha = lfield.start(*arguments, "alpha")
    # Commands on alpha find no run of bravo.
    bravo = lfield.start(*arguments, "bravo", env=alone)
    alpha.wait_for("link to bravo established")
    options = ("--inventory", inventory) if named else ()
    there = {"LFIELD_RUNS": "here"}
    lfield("ps", *options, env=there, status=0)
    lfield("estop", "--no-wait", *options, env=there, status=0)
    bravo.wait_for("EMERGENCY STOP")


@pytest.mark.few(0)
def test_a_command_without_the_zenoh_package_names_it(lfield) -> None:
    """The Python cannot import the package: the error is one sentence with a code, without a traceback."""
    lfield.write("zenoh.py", "raise ImportError('hidden by the test')\n")
    inventory = lfield.write(
        "inventory.yaml", INVENTORY.format(near="tcp/127.0.0.1:1", far="tcp/127.0.0.1:1")
    )
    lfield.keys.give("alpha", "bravo")
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    arguments = ("up", "--deploy", deployment, "--inventory", inventory, "--host", "alpha")
    host = lfield(*arguments, env={"PYTHONPATH": str(lfield.folder)}, status=69)
    assert len([line for line in host.err if "lfield[zenoh]" in line]) == 1
