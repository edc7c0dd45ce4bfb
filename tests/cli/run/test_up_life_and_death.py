"""Stopped, killed or orphaned processes: the reactions of the other processes, and the exit statuses."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.process

EXAMPLES = Path(__file__).parents[3] / "examples"

POSTS = """
resource Post {
    string id;
    init(string[] arg) { id = arg[0]; }
    portal stay(real seconds) {
        write(id + " receives\\n");
        sleep(seconds);
        write(id + " lets go\\n");
    }
}
"""
TRAVELLER = (
    POSTS
    + """
coordinator Traveller {
    init(string[] arg) {
        findPost(arg[1]).stay(0.01);
        findPost(arg[2]).stay(s2f(arg[3]));
        findPost(arg[1]).stay(0.01);
    }
}
"""
)
TWO_HOSTS = "//Post:near@alpha\n//Post:far@bravo\n//Traveller:tom@alpha?near&far&{stay}\n"


@pytest.mark.few(0)
@pytest.mark.parametrize("order", [["alpha", "bravo"], ["bravo", "alpha"]])
def test_hosts_are_started_by_hand_in_any_order(lfield, order):
    deployment = lfield.mission(TRAVELLER, TWO_HOSTS.format(stay="0.01"))
    maps = lfield.maps(["alpha", "bravo"])
    arguments = ("up", "--deploy", deployment, *maps, "--until-done")
    first = lfield.start(*arguments, "--host", order[0])
    first.wait_for(f"{order[0]} listening on 127.0.0.1:")
    second = lfield.start(*arguments, "--host", order[1])
    assert (first.wait(), second.wait()) == (0, 0)
    by_name = dict(zip(order, (first, second), strict=True))
    assert by_name["alpha"].out == ["near receives", "near lets go"] * 2
    assert by_name["bravo"].out == ["far receives", "far lets go"]


#: tests/simulate/test_fleet_liveness.py tests the time-outs in virtual time.
@pytest.mark.few(0)
def test_a_coordinator_on_a_killed_host_has_an_unknown_outcome(lfield):
    deployment = lfield.mission(TRAVELLER, TWO_HOSTS.format(stay="1000"))
    hosts = lfield.hosts(deployment, ["alpha", "bravo"], "--until-done", "--lost-after", "1")
    hosts["bravo"].wait_for("far receives")
    hosts["bravo"].signal(signal.SIGKILL)
    assert hosts["alpha"].wait() == 4
    text = "\n".join(hosts["alpha"].err)
    assert "outcome unknown: it moved to bravo (transfer 1), and bravo has been unreachable for" in text
    assert "lost:" not in text


@pytest.mark.few(0)
def test_a_coordinator_is_lost_with_a_killed_child_of_all(lfield):
    deployment = lfield.mission(TRAVELLER, TWO_HOSTS.format(stay="1000"))
    team = lfield.start("up", "--deploy", deployment, "--all", "--until-done")
    team.wait_for(r"bravo \| far receives")
    os.kill(lfield.child("bravo"), signal.SIGKILL)
    assert team.wait() == 1
    assert "bravo | bravo killed (SIGKILL)" in team.err
    killed = "bravo killed (SIGKILL)"
    lost = "tom lost: its last host bravo has ended"
    assert f"alpha | {lost}" in team.err
    end = re.sub(r"after \d+ s", "after N s", team.err[-1])
    assert end == f"mission failed on bravo after N s, 1 hop; exit status 1: {killed}; alpha: {lost}"


PREPARED = (
    POSTS
    + """
coordinator Prepared {
    init(string[] arg) {
        Post near = findPost(arg[1]);
        near.stay(0.01);
        findPost(arg[2]).stay(0.01);
        near.stay(0.01);
        sleep(1.0);
        while (true) {
            try {
                findPost(arg[2]).stay(0.01);
                near.stay(0.01);
                sleep(0.1);
            } catch (UnreachableResourceException e) {
                print("without the other: " + e.message());
                return;
            }
        }
    }
}
"""
)


@pytest.mark.few(0)
def test_a_program_that_handles_a_dead_host_continues(lfield):
    deployment = lfield.mission(
        PREPARED, "//Post:near@alpha\n//Post:far@bravo\n//Prepared:tom@alpha?near&far\n"
    )
    hosts = lfield.hosts(
        deployment, ["alpha", "bravo"], "--until-done", "--lost-after", "5", "--unreachable-after", "1"
    )
    # The coordinator sleeps at alpha, so the kill removes only the other host's resource.
    hosts["bravo"].wait_for("far lets go")
    for _ in range(2):
        hosts["alpha"].wait_for("near lets go")
    while hosts["alpha"].out.count("near lets go") < 2:
        time.sleep(0.01)
    hosts["bravo"].signal(signal.SIGKILL)
    hosts["alpha"].wait_for("tom: without the other: bravo could not be reached: there has been no link for ")
    assert hosts["alpha"].wait() == 0, hosts["alpha"].said


@pytest.mark.few(0)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_ends_all_hosts_in_order(lfield, number):
    deployment = lfield.mission(TRAVELLER, TWO_HOSTS.format(stay="1000"))
    team = lfield.start("up", "--deploy", deployment, "--all", "--until-done")
    team.wait_for(r"bravo \| far receives")
    team.signal(number)
    assert team.wait() == 130
    assert "killed" not in team.said
    assert lfield.left() == []


@pytest.mark.few(0)
def test_ctrl_c_in_flight_lands_the_copters_before_the_hosts_end(lfield):
    deployment = EXAMPLES / "01-first-flight" / "mission.dL"
    team = lfield.start("up", "--deploy", deployment, "--all", "--sim", "--until-done")
    for copter in ("lead", "wing"):
        team.wait_for(f"{copter}: at ")
    team.signal(signal.SIGINT)
    assert team.wait() == 130
    for device in ("lead.fc", "wing.fc"):
        assert f"{device} in safe state 'land': the host is stopping" in team.said
        assert f"{device} at rest" in team.said
    assert "NOT SAFE" not in team.said
    assert lfield.left() == []


@pytest.mark.few(0)
def test_a_killed_child_with_an_unconfirmed_vehicle_sets_the_exit_status(lfield):
    deployment = EXAMPLES / "01-first-flight" / "mission.dL"
    team = lfield.start("up", "--deploy", deployment, "--all", "--sim", "--until-done")
    # In the air: a vehicle on the ground may be reported at rest before its fake has ended.
    team.wait_for("wing: at ")
    os.kill(lfield.child("bravo"), signal.SIGKILL)
    assert team.wait() == 3
    assert "bravo | bravo killed (SIGKILL)" in team.err
    # The fake may confirm the safe state before it ends.
    confirmed = "bravo | wing.fc in safe state 'land': the host is gone" in team.err
    unconfirmed = "bravo | wing.fc safe state not confirmed: host killed (SIGKILL)" in team.err
    assert confirmed != unconfirmed, team.said
    assert "NOT SAFE" not in team.said
    # The fake ends with the host. A real device would not, so the guard keeps trying.
    assert lfield.left() == lfield.guards() != []


@pytest.mark.few(0)
def test_guards_and_fakes_inherit_no_descriptors_of_their_host(lfield):
    """A connection to a killed host must be refused."""
    deployment = EXAMPLES / "01-first-flight" / "mission.dL"
    team = lfield.start("up", "--deploy", deployment, "--all", "--sim", "--until-done")
    port = int(team.wait_for(r"alpha listening on 127\.0\.0\.1:(\d+)")[1])
    team.wait_for("lead: at ")
    host = lfield.child("alpha")
    others = lfield.guards() + lfield.running("lfield.driver.sims")
    assert len(others) == 4
    for other in others:
        # Pipes are for communication with the host. The lock of the run is in its folder.
        shared = descriptors(host) & descriptors(other)
        assert [name for name in shared if not name.startswith(("pipe:", "anon_inode:", "/dev/"))] == []
    os.kill(host, signal.SIGKILL)
    while somebody_listens(port):
        time.sleep(0.02)
    assert team.wait() == 3


def somebody_listens(port):
    with socket.socket() as caller:
        return caller.connect_ex(("127.0.0.1", port)) == 0


def descriptors(pid):
    folder = Path(f"/proc/{pid}/fd")
    return {os.readlink(folder / name) for name in os.listdir(folder)}


@pytest.mark.few(0)
def test_ctrl_c_ends_one_host(lfield):
    deployment = lfield.mission(TRAVELLER, TWO_HOSTS.format(stay="1000"))
    hosts = lfield.hosts(deployment, ["alpha", "bravo"], "--until-done")
    hosts["bravo"].wait_for("far receives")
    hosts["alpha"].signal(signal.SIGINT)
    assert hosts["alpha"].wait() == 130


@pytest.mark.few(0)
def test_a_host_without_until_done_is_stopped_with_status_0(lfield):
    deployment = lfield.mission(POSTS, "//Post:near@alpha\n")
    (host,) = lfield.hosts(deployment, ["alpha"]).values()
    host.wait_for("alpha listening on")
    host.signal(signal.SIGTERM)
    assert host.wait() == 0


def test_hosts_end_with_a_killed_parent(lfield):
    deployment = lfield.mission(TRAVELLER, TWO_HOSTS.format(stay="1000"))
    team = lfield.start("up", "--deploy", deployment, "--all")
    team.wait_for(r"bravo \| far receives")
    assert len(lfield.left()) == 3
    team.signal(signal.SIGKILL)
    team.popen.wait()
    assert lfield.all_ended()


@pytest.mark.few(0)
def test_a_mission_that_dies_ends_with_1(lfield):
    program = "coordinator Careless { init(string[] arg) { print(i2s(1 / (arg.length() - 1))); } }\n"
    done = lfield(
        "up", "--deploy", lfield.mission(program, "//Careless:tom@alpha\n"), "--all", "--until-done", status=1
    )
    assert "alpha | tom died of an uncaught ArithmeticException: division by zero" in done.err
    assert "alpha |     at Careless.init (mission.L:1)" in done.err
    assert "alpha |     hosts visited: alpha" in done.err


def test_a_port_in_use_is_reported_and_no_journal_is_made(lfield, tmp_path):
    # The first run may still be active although its folder was moved: a new one must not replace it.
    deployment = lfield.mission(POSTS, "//Post:near@alpha\n")
    lfield.keys.give("alpha")
    state = ("--state", tmp_path / "state")
    with socket.create_server(("127.0.0.1", 0)) as occupied:
        address = f"127.0.0.1:{occupied.getsockname()[1]}"
        arguments = ("up", "--deploy", deployment, "--host", "alpha", "--map", f"alpha={address}")
        hosts = [lfield(*arguments, *more, status=69) for more in ((), state, (*state, "--fresh"))]
    remedy = "stop the program that has it, or choose another port"
    assert hosts[0].err == [f"lfield: cannot use {address}: the port is in use; {remedy}"]
    assert all("the port is in use" in host.said for host in hosts)
    assert not (tmp_path / "state").exists()


@pytest.mark.few(0)
def test_all_listens_at_the_map_and_else_on_free_ports(lfield):
    deployment = lfield.mission(TRAVELLER, TWO_HOSTS.format(stay="0.01"))
    (port,) = lfield.ports.take(1)
    arguments = ("up", "--deploy", deployment, "--all", "--until-done", "--map")
    done = lfield(*arguments, f"bravo=127.0.0.1:{port}", status=0)
    assert f"bravo | bravo listening on 127.0.0.1:{port}; state not saved" in done.err
    assert any(line.startswith("alpha | alpha listening on 127.0.0.1:") for line in done.err)


@pytest.mark.few(0)
def test_all_refuses_a_map_it_cannot_use(lfield):
    arguments = ("up", "--deploy", lfield.mission(POSTS, "//Post:near@alpha\n"), "--all", "--map")
    with socket.create_server(("127.0.0.1", 0)) as occupied:
        address = f"127.0.0.1:{occupied.getsockname()[1]}"
        used = lfield(*arguments, f"alpha={address}")
    remedy = "stop the program that has it, or choose another port"
    assert used.err == [f"lfield: cannot use {address}: the port is in use; {remedy}"]
    assert lfield.status(used) == 69
    abroad = lfield(*arguments, "alpha=192.0.2.1:8181")
    assert "the address is not one of this machine" in abroad.err[0]
    assert lfield.status(abroad) == 69
    unknown = lfield(*arguments, "alfa=127.0.0.1:8181")
    assert "the deployment has no host 'alfa'" in unknown.err[0]
    assert lfield.status(unknown) == 64


CROWD = """
resource Worker {
    init(string[] arg) { }
    portal work(int n) emit int { return n + 1; }
}
coordinator Steady {
    init(string[] arg) {
        Worker worker = findWorker(arg[1]);
        int n = 0;
        for (int i = 0; i < 50; i = i + 1) n = worker.work(n);
        print("worked " + i2s(n) + " times");
    }
}
coordinator Busy { init(string[] arg) { int i = 0; while (true) i = i + 1; } }
class Link {
    public Link next;
    public Link(Link rest) { next = rest; }
}
coordinator Greedy {
    init(string[] arg) {
        Link all = null;
        while (true) all = new Link(all);
    }
}
coordinator Deep {
    init(string[] arg) { print(i2s(down(1))); }
    private int down(int n) { return 1 + down(n + 1); }
}
"""


@pytest.mark.few(0)
def test_agents_that_loop_allocate_or_recurse_do_not_block_others(lfield):
    agents = ["Busy:busy", "Greedy:greedy", "Deep:deep", "Worker:worker"]
    deployment = "".join(f"//{agent}@alpha\n" for agent in agents) + "//Steady:steady@alpha?worker\n"
    deployment += "//Steady:visitor@bravo?worker\n"
    team = lfield.start("up", "--deploy", lfield.mission(CROWD, deployment), "--all")
    team.wait_for("steady: worked 50 times")
    team.wait_for("visitor: worked 50 times")
    team.wait_for("greedy died of an uncaught LimitException: the heap")
    team.wait_for("deep died of an uncaught LimitException: .*deep")
    team.signal(signal.SIGINT)
    assert team.wait() == 130


def test_program_output_to_a_full_disk_is_reported_once_and_the_mission_continues(lfield):
    deployment = lfield.mission(TRAVELLER, "//Post:near@alpha\n//Traveller:tom@alpha?near&near&0.01\n")
    with open("/dev/full", "wb") as full:
        (host,) = lfield.hosts(deployment, ["alpha"], "--until-done", stdout=full).values()
        assert host.wait() == 0
    lines = [line for line in host.err if "program output discarded" in line]
    assert lines == ["program output discarded from here on: No space left on device"]


@pytest.mark.few(0)
def test_all_continues_with_output_to_a_full_disk(lfield):
    deployment = lfield.mission(TRAVELLER, "//Post:near@alpha\n//Traveller:tom@alpha?near&near&0.01\n")
    with open("/dev/full", "wb") as full:
        done = lfield("up", "--deploy", deployment, "--all", "--until-done", stdout=full)
    assert lfield.status(done) == 0
    lines = [line for line in done.err if "output discarded" in line]
    assert lines == ["lfield: program output discarded from here on: No space left on device"]


@pytest.mark.few(0)
def test_the_log_of_all_hosts_is_json(lfield):
    deployment = lfield.mission(TRAVELLER, TWO_HOSTS.format(stay="0.01"))
    done = lfield("up", "--deploy", deployment, "--all", "--until-done", "--json")
    assert (lfield.status(done), done.err) == (0, [])
    lines = [json.loads(line) for line in done.out]
    assert all(line.keys() == {"time", "host", "code", "level", "text", "fields"} for line in lines)
    output = [(line["host"], line["fields"]["text"]) for line in lines if line["code"] == "program-output"]
    assert sorted(output) == sorted(
        [
            *[("alpha", "near receives"), ("alpha", "near lets go")] * 2,
            ("bravo", "far receives"),
            ("bravo", "far lets go"),
        ]
    )
    assert lines[-1]["code"] == "mission-completed"
    assert (lines[-1]["fields"]["hops"], lines[-1]["fields"]["status"]) == (2, 0)


@pytest.mark.few(0)
def test_a_host_that_cannot_start_is_in_the_json_log(lfield):
    program = (
        "resource Arm { Mavlink fc; init(string[] arg) { } }\ncoordinator Boss { init(string[] arg) { } }"
    )
    deployment = lfield.mission(program, "//Arm:arm@alpha\n//Boss:boss@alpha\n")
    (lfield.folder / "mission.devices.yaml").write_text(
        'agents: {arm: {devices: {fc: {driver: mavlink, endpoint: "serial:/dev/none:57600", '
        "system: 1, kind: copter, safe_state: land, limits: {speed: 5.0}, waivers: [device_watchdog]}}}}"
    )
    done = lfield("up", "--deploy", deployment, "--all", "--until-done", "--volatile", "--json", status=69)
    refused, last = [json.loads(line) for line in done.out]
    assert (refused["host"], refused["code"], refused["exit_status"]) == ("alpha", "devices-unavailable", 69)
    assert (last["code"], last["fields"]["where"]) == ("mission-failed", "alpha")
    assert "/dev/none" in last["fields"]["reason"]


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("program", "status", "code"),
    [("", 66, "file-not-readable"), ("resource Arm {", 65, "program-errors")],
    ids=["no file", "an error"],
)
def test_a_mission_that_cannot_be_built_is_in_the_json_log(lfield, program, status, code):
    deployment = lfield.mission(program, "//Arm:arm@alpha\n")
    if not program:
        (lfield.folder / deployment).unlink()
    done = lfield("up", "--deploy", deployment, "--all", "--json", status=status)
    (refused,) = [json.loads(line) for line in done.out]
    assert (refused["code"], refused["exit_status"]) == (code, status)
