"""Commands find hosts with the inventory: one address, several, wrong ones, and none."""

from __future__ import annotations

import os
import signal

import pytest
from robots import told

pytestmark = pytest.mark.process

PROGRAM = """
resource Post { init(string[] arg) { } portal visit() { write("visit\\n"); } }
coordinator Walker {
    init(string[] arg) { findPost("post").visit(); while (true) { sleep(0.2); } }
}
"""
DEPLOYMENT = "//Walker:tom@alpha\n//Post:post@bravo\n"


class Team:
    """Two hosts of a mission at addresses of an inventory, each with a separate environment."""

    def __init__(self, lfield, here, runtime: str) -> None:
        self.lfield, self.here, self.runtime = lfield, here, runtime
        self.ports = dict(zip(("alpha", "bravo"), lfield.ports.take(2), strict=True))
        lfield.keys.give("alpha", "bravo")
        self.deployment = lfield.mission(PROGRAM, DEPLOYMENT)

    def inventory(self, **addresses: str) -> None:
        """Write the inventory; `{alpha}` and `{bravo}` are the ports of the hosts."""
        rows = "".join(
            f"  {host}: {{addresses: [{text.format(**self.ports)}], service_port: {number}}}\n"
            for number, (host, text) in enumerate(addresses.items(), 1)
        )
        self.lfield.write("config/lfield/inventory.yaml", f"hosts:\n{rows}")

    def up(self, *hosts: str):
        started = []
        for host in hosts:
            folder = f"{self.runtime}/{host}"
            os.makedirs(folder, mode=0o700)
            arguments = ("up", self.deployment, "--host", host, "--first-start", "--volatile")
            started.append(self.lfield.start(*arguments, env={"XDG_RUNTIME_DIR": folder}))
        return started


@pytest.fixture
def team(lfield, here, alone, monkeypatch):
    monkeypatch.delenv("LFIELD_INVENTORY")
    monkeypatch.setenv("XDG_RUNTIME_DIR", alone["XDG_RUNTIME_DIR"])
    yield Team(lfield, here, alone["XDG_RUNTIME_DIR"])
    lfield.end()


@pytest.mark.few(0)
def test_hosts_and_commands_use_the_inventory(team) -> None:
    team.inventory(alpha="'127.0.0.2:{alpha}'", bravo="'127.0.0.4:{bravo}', '[::1]:{bravo}'")
    (bravo,) = team.up("bravo")
    bravo.wait_for("listening on")
    # One address of bravo has no listener.
    team.inventory(
        alpha="'127.0.0.2:{alpha}', '127.0.0.3:{alpha}'", bravo="'127.0.0.9:{bravo}', '[::1]:{bravo}'"
    )
    (alpha,) = team.up("alpha")
    bravo.wait_for("^visit$")
    port = team.ports["alpha"]
    alpha.wait_for(f"alpha listening on 127.0.0.2:{port},127.0.0.3:{port}")
    # For the desk, one address of bravo is that of alpha.
    team.inventory(alpha="'127.0.0.3:{alpha}'", bravo="'127.0.0.2:{alpha}', '[::1]:{bravo}'")
    # Without and with a mission.
    for words in ((), ("mission.dL",)):
        output = team.here("ps", "--json", *words)
        assert output.status == 0, output
        assert set(told(output)) >= {"alpha", "bravo"} or set(told(output).get("hosts", ())) >= {
            "alpha",
            "bravo",
        }
    assert team.here("ps").status == 0
    logs = team.here("logs")
    assert logs.status == 0
    assert any("visit" in line for line in logs.out)
    assert team.here("events", "--no-follow").status == 0
    assert team.here("pause").status == 0
    assert team.here("resume").status == 0
    stopped = team.here("estop")
    assert stopped.status == 0
    assert team.here("estop", "--lift").status == 0
    assert team.here("forget", "tom").status == 69
    # These commands need the file of the mission.
    for command in (("query", "Lift"), ("watch",)):
        refused = team.here(*command)
        assert refused.status == 69
        assert "name the file of the mission" in " ".join(refused.err)
    # A command-line option takes precedence.
    assert team.here("ps", "mission.dL", "--map", "alpha=127.0.0.8:1").status == 69


@pytest.mark.few(0)
def test_an_emergency_stop_reaches_answering_hosts_and_names_the_others(team) -> None:
    team.inventory(alpha="'127.0.0.2:{alpha}'", bravo="'127.0.0.3:{bravo}', '127.0.0.4:{bravo}'")
    assert team.here("estop").status == 69
    (alpha,) = team.up("alpha")
    alpha.wait_for("listening on")
    stopped = team.here("estop")
    assert stopped.status == 3
    assert [line.partition(":")[0] for line in stopped.err] == ["bravo"]
    assert any("alpha" in line for line in stopped.out)
    alpha.signal(signal.SIGTERM)
    alpha.wait()


def test_without_inventory_and_run_there_is_no_mission(team) -> None:
    for command in ("ps", "estop", "pause", "resume", "logs", "events", "start", "watch"):
        assert team.here(command).status == 69, command


def test_events_of_the_inventory_follow_until_ctrl_c(team) -> None:
    team.inventory(alpha="'127.0.0.2:{alpha}'")
    following = team.lfield.start("events")
    following.wait_for("^lfield: following the hosts of the inventory; Ctrl-C ends this$")
    following.signal(signal.SIGINT)
    assert following.wait() == 130
    stored = team.here("events", "--no-follow")
    assert not any("Ctrl-C" in line for line in stored.err)


def test_a_damaged_inventory_is_reported_with_its_position(team) -> None:
    team.lfield.write("config/lfield/inventory.yaml", "hosts:\n  alpha: {addresses: ['1.2.3']}\n")
    refused = team.here("estop")
    assert refused.status == 65
    assert any("inventory.yaml:2:23" in line for line in refused.err)


@pytest.mark.few(0)
def test_all_hosts_on_this_computer_ignore_the_inventory(team) -> None:
    team.inventory(alpha="'198.51.100.1'", bravo="'198.51.100.2'")
    everything = team.lfield.start("up", team.deployment, "--all")
    everything.wait_for("visit")
    everything.signal(signal.SIGINT)
    everything.wait()


@pytest.mark.few(0)
def test_the_own_host_is_found_by_its_address(team) -> None:
    team.inventory(alpha="'198.51.100.1:{alpha}', '127.0.0.2:{alpha}'")
    team.lfield.mission("coordinator Walker { init(string[] arg) { } }", "//Walker:tom@alpha\n")
    alpha = team.lfield.start("up", team.deployment, "--first-start", "--volatile")
    alpha.wait_for(f"alpha listening on 127.0.0.2:{team.ports['alpha']}")
