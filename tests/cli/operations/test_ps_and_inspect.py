"""Views of a running mission, and of a failed agent."""

from __future__ import annotations

import json
import re
import time

import pytest
from msgspec.structs import replace
from scripted_snapshots import states_of

from lfield.cli.views import team_status_view
from lfield.client.status_json import status_data
from lfield.errors import AddressError
from lfield.wire.coordinator_messages import CoordinatorState
from lfield.wire.observer_messages import (
    AgentStatus,
    AttributeReading,
    BundleStatus,
    DeviceStatus,
    DirectoryEntry,
    LinkStatus,
    PendingCallStatus,
    ReservedStatus,
    Status,
)

pytestmark = pytest.mark.process

PROGRAM = """
resource Post {
    init(string[] arg) { while (true) yield(); }
    portal stay(real seconds) { write("stays\\n"); sleep(seconds); }
}
coordinator Guest {
    init(string[] arg) { findPost(arg[1]).stay(0.01); findPost(arg[2]).stay(1000.0); }
}
"""
DEPLOYMENT = "//Post:near@alpha\n//Guest:tom@alpha?near&far\n//Post:far@bravo\n"


@pytest.fixture(scope="module")
def mission(shared_lfield):
    """A mission in which a coordinator stays at the other host."""
    deployment = shared_lfield.mission(PROGRAM, DEPLOYMENT)
    team = shared_lfield.start("up", "--deploy", deployment, "--all")
    team.wait_for(r"bravo \| stays")
    team.deployment = deployment
    return team


def test_the_table_shows_agents_and_their_hosts(mission, here):
    output = here("ps", "--deploy", mission.deployment, status=0)
    assert output.out[0].split()[:6] == ["HOST", "AGENT", "TYPE", "STATE", "HOPS", "SERVED"]
    rows = {line.split()[1]: line for line in output.out[1 : output.out.index("")]}
    assert re.match(r"alpha +near +Post +parked +1 +[\d.]+ (Ki)?B", rows["near"])
    assert re.match(r"bravo +far +Post +sleeping +0 +[\d.]+ (Ki)?B", rows["far"])
    assert re.match(r"bravo +tom +Guest +in a portal +1 +[\d.]+ (Ki)?B", rows["tom"])


def told_as_json(mission, here):
    output = here("ps", "--deploy", mission.deployment, "--json", status=0)
    return json.loads("\n".join(output.out))


def test_the_team_is_shown_as_json(mission, here):
    # The coordinator prints its arrival before its previous host receives the confirmation.
    end, hosts = time.monotonic() + 60.0, told_as_json(mission, here)
    while hosts["alpha"]["coordinators"][0]["state"] != "MOVED" and time.monotonic() < end:
        hosts = told_as_json(mission, here)
    assert list(hosts) == ["alpha", "bravo"]
    assert hosts["alpha"]["linked"] == ["bravo"]
    agents = {agent["id"]: (host, agent) for host in hosts for agent in hosts[host]["agents"]}
    assert {name: host for name, (host, _) in agents.items()} == {
        "near": "alpha",
        "far": "bravo",
        "tom": "bravo",
    }
    assert agents["tom"][1]["hops"] == 1
    assert agents["near"][1]["served"] == 1
    (moved,) = hosts["alpha"]["coordinators"]
    assert (moved["state"], moved["where"]) == ("MOVED", "bravo")


def test_all_fields_of_a_host_are_in_json_and_in_the_table(capsys):
    known = CoordinatorState("tom", 7, 1, 1, "EXITED", "alpha", "died", "Exception: no")
    status = Status(
        "alpha",
        "127.0.0.1:1",
        2.5,
        b"p" * 32,
        b"d" * 32,
        [AgentStatus("near", "Post", "resource", "parked", 0, 1, 512, 1024, 2)],
        [known],
        [
            DeviceStatus("near.fc", {"at": [0.5, 1], "on": True}, 0.25, ""),
            DeviceStatus("near.arm", {}, None, "lost", "4 m up"),
            DeviceStatus("near.eye", {"mode": "hold"}, 4.0, "lost"),
        ],
        [LinkStatus("bravo", None, 0.2143, 0.048, 12_345, 999), LinkStatus("carol", 3.5)],
        [
            DirectoryEntry(
                "near", "", {"battery": AttributeReading(0.75, 1.5)}, {"mode": "fc has not reported mode"}
            )
        ],
        bundle=BundleStatus(bytes(range(32)), "anna\x1b", 1_795_464_000.0),
    )
    answers = {"alpha": status, "bravo": AddressError("127.0.0.1:2", "no program listens there")}
    assert json.loads(json.dumps(status_data(states_of(answers)))) == {
        "alpha": {
            "host": "alpha",
            "address": "127.0.0.1:1",
            "up": 2.5,
            "program": "70" * 8,
            "deployment": "64" * 8,
            "bundle": {"digest": "0001020304050607", "signed_by": "anna\x1b", "signed": 1_795_464_000.0},
            "agents": [
                {
                    "id": "near",
                    "type": "Post",
                    "kind": "resource",
                    "state": "parked",
                    "hops": 0,
                    "served": 1,
                    "heap": 512,
                    "limit": 1024,
                    "threads": 2,
                }
            ],
            "coordinators": [
                {
                    "id": "tom",
                    "generation": 7,
                    "sequence": 1,
                    "hops": 1,
                    "state": "EXITED",
                    "where": "alpha",
                    "outcome": "died",
                    "detail": "Exception: no",
                    "receiver_memory": 0,
                    "unreadable": False,
                }
            ],
            "linked": ["bravo"],
            "away": {"carol": 3.5},
            "links": {
                "bravo": {
                    "round_trip": 0.2143,
                    "loss": 0.048,
                    "sent": 12345,
                    "received": 999,
                    "kinds": {},
                    "path": "",
                    "standby": "",
                }
            },
            "observers": {},
            "devices": {
                "near.fc": {"at": [0.5, 1], "on": True},
                "near.arm": {},
                "near.eye": {"mode": "hold"},
            },
            "silences": {"near.fc": 0.25, "near.eye": 4.0},
            "latched": {"near.arm": "lost", "near.eye": "lost"},
            "late": None,
            "silence": None,
            "lease": None,
            "paused": False,
            "held": False,
            "stopped": "",
            "unkept": "",
            "refused": [],
            "start": None,
            "journal": None,
            "begun": [],
            "startable": [],
            "reads": [],
            "reserved": [],
            "moving": {"near.arm": "4 m up"},
            "directory": {
                "near": {
                    "refusal": "",
                    "facts": {"battery": [0.75, 1.5]},
                    "unknown": {"mode": "fc has not reported mode"},
                }
            },
        },
        "bravo": {"error": "cannot use 127.0.0.1:2: no program listens there", "code": "address"},
    }
    team_status_view.show(states_of(answers))
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert rows[1:4] == [
        ["alpha", "near", "Post", "parked", "1", "512", "B"],
        ["alpha", "tom", "died:", "Exception:", "no", "1"],
        ["bravo", "-", "no", "answer"],
    ]
    assert rows[6:9] == [
        ["alpha", "near.fc", "in", "use", "at", "(0.50", "1),", "on", "yes"],
        ["alpha", "near.arm", "safe:", "4", "m", "up"],
        ["alpha", "near.eye", "silent", "4", "s", "mode", "hold"],
    ]
    signed = "bundle 0001020304050607, signed by anna\\u{1b} 2026-11-23 20:00 UTC: alpha"
    assert rows[-1] == signed.split()


def test_delays_and_the_silence_limit_are_shown(capsys):
    idle = Status("carol", "127.0.0.1:3", 2.5, b"p" * 32, b"d" * 32, [], [], [], [], [])
    flying = replace(
        idle,
        host="alpha",
        devices=[DeviceStatus("near.fc", {}, 0.25, "")],
        late=0.0312,
        silence=0.2,
        lease=1.46,
    )
    answers = {
        "alpha": flying,
        "bravo": AddressError("127.0.0.1:2", "no program listens there"),
        "carol": idle,
    }
    data = json.loads(json.dumps(status_data(states_of(answers))))
    assert (data["alpha"]["late"], data["alpha"]["silence"]) == (0.0312, 0.2)
    assert (data["carol"]["late"], data["carol"]["silence"]) == (None, None)
    team_status_view.show(states_of(answers))
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert rows[-3:] == [
        ["HOST", "HEARTBEAT", "DELAY", "GUARD", "TIMEOUT", "LEASE", "JOURNAL"],
        ["alpha", "0.031", "s", "0.2", "s", "1.5", "s", "not", "saved"],
        ["carol", "not", "saved"],
    ]


def test_round_trip_loss_and_bytes_of_each_link_are_shown(capsys):
    kinds, watched = {"control": 300, "hop": 11_000}, {"telemetry": 2_500}
    links = [LinkStatus("bravo", None, 0.2143, 0.048, 12_345, 999, kinds), LinkStatus("carol", 3.5)]
    links.append(LinkStatus("delta", None))
    links += [
        LinkStatus("echo", None, path="10.0.0.5", standby="zenoh"),
        LinkStatus("golf", None, path="10.0.0.7"),
    ]
    status = Status(
        "alpha", "127.0.0.1:1", 2.5, b"p" * 32, b"d" * 32, [], [], [], links, [], observers=watched
    )
    data = json.loads(json.dumps(status_data(states_of({"alpha": status}))))["alpha"]
    assert (data["linked"], data["away"]) == (["bravo", "delta", "echo", "golf"], {"carol": 3.5})
    figures = {"round_trip": 0.2143, "loss": 0.048, "sent": 12_345, "received": 999, "kinds": kinds}
    unknown = {**dict.fromkeys(("round_trip", "loss", "sent", "received")), "kinds": {}}
    assert data["links"] == {
        "bravo": {**figures, "path": "", "standby": ""},
        "delta": {**unknown, "path": "", "standby": ""},
        "echo": {**unknown, "path": "10.0.0.5", "standby": "zenoh"},
        "golf": {**unknown, "path": "10.0.0.7", "standby": ""},
    }
    assert data["observers"] == watched
    team_status_view.show(states_of({"alpha": status}))
    rows = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert rows[-7:] == [
        "HOST LINK WITH ROUND TRIP LOSS SENT RECEIVED BY KIND",
        "alpha bravo 214 ms 4.8 % 12.3 kB 999 B control 300 B, hop 11.0 kB",
        "alpha delta",
        "alpha echo over 10.0.0.5, standby zenoh",
        "alpha golf over 10.0.0.7, standby none",
        "alpha carol none for 4 s",
        "alpha observers telemetry 2.5 kB",
    ]


def test_of_a_hundred_hosts_the_worst_links_are_listed_and_json_has_all(capsys):
    names = [f"h{n}" for n in range(100)]
    answers = {}
    for number, name in enumerate(names):
        others = [names[(number + step) % 100] for step in range(1, 9)]
        links = [LinkStatus(other, None, 0.001 * (number + 1), 0.0, 10, 10) for other in others]
        if name == "h7":
            links[2:4] = [LinkStatus(others[2], None, 0.001, 0.25, 10, 10), LinkStatus(others[3], 40.0)]
        answers[name] = Status(name, f"{name}:1", 2.5, b"p" * 32, b"d" * 32, [], [], [], links, [])
    states = states_of(answers)
    data = json.loads(json.dumps(status_data(states)))
    assert sum(len(host["links"]) + len(host["away"]) for host in data.values()) == 800
    team_status_view.show(states)
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    listed = rows[next(n for n, row in enumerate(rows) if row[1:3] == ["LINK", "WITH"]) + 1 :]
    assert [row[:2] for row in listed[:3]] == [["h7", "h11"], ["h7", "h10"], ["h99", "h0"]]
    assert len(listed) == team_status_view.WORST_LINKS + 1
    assert listed[-1][:1] == ["799"]


def test_reservations_are_shown_with_their_remaining_time(capsys):
    reserved = [ReservedStatus("near", "tom", 2, 12.25, 4.5)]
    status = Status("alpha", "127.0.0.1:1", 2.5, b"p" * 32, b"d" * 32, [], [], [], [], [], reserved=reserved)
    data = json.loads(json.dumps(status_data(states_of({"alpha": status}))))
    assert data["alpha"]["reserved"] == [
        {"resource": "near", "agent": "tom", "generation": 2, "held": 12.25, "left": 4.5}
    ]
    team_status_view.show(states_of({"alpha": status}))
    rows = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert rows[1] == "alpha tom near reserved for 12 s, 4 s left"


def test_pending_calls_are_shown(capsys):
    pending = [PendingCallStatus("tom", 1, "near", "lift", state) for state in ("running", "done", "lost")]
    status = Status(
        "alpha", "127.0.0.1:1", 2.5, b"p" * 32, b"d" * 32, [], [], [], [], [], pending_calls=pending
    )
    data = json.loads(json.dumps(status_data(states_of({"alpha": status}))))
    assert data["alpha"]["begun"][0] == {
        "agent": "tom",
        "generation": 1,
        "resource": "near",
        "portal": "lift",
        "state": "running",
    }
    team_status_view.show(states_of({"alpha": status}))
    rows = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert rows[1:4] == [
        "alpha tom near.lift running",
        "alpha tom near.lift completed, result not delivered yet",
        "alpha tom near.lift was lost in a restart",
    ]


def test_a_mission_that_does_not_run_has_a_status(lfield, here):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT.replace("tom", "tim"))
    maps = lfield.maps(["alpha", "bravo"])
    output = here("ps", "--deploy", deployment, *maps, status=69)
    assert (output.out, output.err[1:]) == ([], []), output.err
    (line,) = output.err
    assert line.startswith(f"lfield: {deployment} is not running: ")
    result = here("ps", "--deploy", deployment, "--json", *maps, status=69)
    data = json.loads("\n".join(result.out))
    assert (data["code"], data["exit_status"]) == ("no-mission-running", 69)


FAULTY = """
class Pair {
    public int left;
    public string right;
    public Pair(int l, string r) { left = l; right = r; }
}
resource Post {
    init(string[] arg) { }
    portal count() emit int { return 3; }
}
coordinator Careless {
    Pair kept;
    init(string[] arg) {
        Post post = findPost(arg[1]);
        kept = new Pair(7, "seven");
        int counted = post.count();
        spend(counted, new int[5]);
    }
    private void spend(int n, int[] purse) {
        string why = "too far";
        purse[n + 4] = 1;
    }
}
"""


@pytest.fixture(scope="module")
def died(shared_lfield):
    """A mission that ended with a failure of its coordinator; `dump` is the coordinator's dump."""
    hosts = "//Careless:tom@alpha?post\n//Post:post@bravo\n"
    deployment = shared_lfield.mission(FAULTY, hosts, name="faulty")
    team = shared_lfield("up", "--deploy", deployment, "--all", "--until-done", "--dump", "dumps")
    team.dump = shared_lfield.folder / "dumps" / "tom.block"
    return team


def test_a_dead_agent_is_dumped_and_explained(lfield, died, here):
    assert lfield.status(died) == 1
    assert "bravo | tom dumped: read it with 'lfield inspect dumps/tom.block'" in died.err
    output = here("inspect", died.dump, status=0)
    text = "\n".join(output.out)
    assert "agent     tom (coordinator Careless)" in text
    assert "on        bravo, after 1 hop(s): alpha → bravo" in text
    assert "why       IndexException" in text
    stack = [line.split(")")[0] for line in output.out if line.startswith("  at ")]
    assert stack == ["  at Careless.spend (faulty.L:21", "  at Careless.init (faulty.L:17"]
    assert "purse[n + 4] = 1;" in text
    assert "spend(counted, new int[5]);" in text
    assert re.search(r"^ +n = 3$", text, re.M)
    assert re.search(r'^ +why = "too far"$', text, re.M)
    assert re.search(r"^ +counted = 3$", text, re.M)
    assert re.search(r"^ +kept = .*Pair", text, re.M)
    assert re.search(r"^heap: \d+ of 1048576 bytes$", text, re.M)
    assert re.search(r"^ +\d+ bytes +1 × Pair$", text, re.M)


@pytest.mark.few(0)
@pytest.mark.parametrize("damage", [b"", b"\xff"])
def test_a_damaged_dump_is_refused(lfield, here, died, damage):
    data = died.dump.read_bytes()
    path = lfield.write("tom.block", data[: len(data) // 2] + damage * (len(data) // 2))
    output = here("inspect", path, status=65)
    assert (output.out, output.err[1:]) == ([], []), output.err
    assert "tom.block" in output.err[0]


@pytest.mark.few(0)
def test_a_dump_that_cannot_be_written_is_reported(lfield):
    (lfield.folder / "dumps").mkdir(mode=0o700)
    (lfield.folder / "dumps" / "tom.block").mkdir()  # blocks the path
    deployment = lfield.mission(FAULTY, "//Careless:tom@alpha?post\n//Post:post@alpha\n")
    done = lfield("up", "--deploy", deployment, "--all", "--until-done", "--dump", "dumps", status=1)
    assert any("alpha | tom not dumped to dumps/tom.block: " in line for line in done.err), done.said
