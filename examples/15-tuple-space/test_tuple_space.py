"""Each weed is pulled once despite failures; the tuple space keeps its guarantees to any client."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import draw_turns
import pytest

HERE = Path(__file__).parent
WEEDS = 11
ROBOTS = ("sky", "north", "south", "east")

#: Coordinators that use the space directly. Each one waits, then performs one operation.
CLIENTS = """
coordinator Writer {
    init(string[] arg) {
        Space space = new Space(findTupleServer("space"), arg[0]);
        sleep(s2f(arg[1]));
        for (int i = 2; i < arg.length(); i += 1) space.out(new Tuple("part").with(s2i(arg[i])));
    }
}
coordinator Taker {
    init(string[] arg) {
        Space space = new Space(findTupleServer("space"), arg[0]);
        sleep(s2f(arg[1]));
        print(arg[0] + " has " + space.in(like(arg)).shown());
    }
    private Tuple like(string[] arg) {
        if (arg.length() > 2) return new Tuple("part").with(s2i(arg[2]));
        return new Tuple("part").any("int");
    }
}
coordinator Reader {
    init(string[] arg) {
        Space space = new Space(findTupleServer("space"), arg[0]);
        sleep(s2f(arg[1]));
        print(arg[0] + " has " + space.rd(new Tuple("part").any("int")).shown());
    }
}
"""


@pytest.fixture
def field(lfield_mission):
    return lfield_mission("mission.dL")


@pytest.fixture
def clients(tmp_path, lfield_mission):
    """Makes a team of a space on the host `shed` and of clients, one for each line of a deployment."""

    def make(*lines: str, program: str = CLIENTS):
        (tmp_path / "mission.L").write_text(f'include "{HERE / "space.L"}";\n{program}')
        (tmp_path / "mission.dL").write_text("\n".join(["//TupleServer:space@shed", *lines]))
        return lfield_mission(tmp_path / "mission.dL")

    return make


def operations(team, verb: str) -> list[tuple[str, str]]:
    """Client and tuple of each operation that the space has logged with this verb, in order."""
    matches = (re.match(rf"(\S+) {verb} (\(.*)", line.text) for line in team.log)
    return [(match[1], match[2]) for match in matches if match]


def assert_each_weed_pulled_once(team) -> None:
    written = [tuple_ for _, tuple_ in operations(team, "writes")]
    pulled = Counter(re.findall(r'\("pulled", (\d+, [\d.]+), ', "\n".join(written)))
    found = Counter(re.findall(r'\("weed", ([1-9]\d*, [\d.]+), ', "\n".join(written)))
    assert pulled == found
    assert len(pulled) == WEEDS
    assert set(pulled.values()) == {1}
    assert team.said(f"farmer: {WEEDS} weeds are pulled", "farm") == 1
    assert set(team.ended.values()) == {"done"}


# --- the field ----------------------------------------------------------------------------------------


def test_every_weed_is_pulled_once_and_all_agents_return(field):
    field.run(until_done=True)
    assert_each_weed_pulled_once(field)
    assert len(field.ended) == 5
    pulling = {client for client, tuple_ in operations(field, "writes") if tuple_.startswith('("pulled"')}
    assert pulling == {"hoe1", "hoe2", "fork"}
    by_fork = [tuple_ for client, tuple_ in operations(field, "takes") if client == "fork"]
    assert by_fork
    assert all('"dock"' in tuple_ for tuple_ in by_fork)
    assert sorted(client for client, _ in operations(field, "reads")) == ["fork", "hoe1", "hoe2"]


def test_readme_states_the_counted_hops_and_broadcast_messages(field):
    field.run(until_done=True)
    hosts = len(field.mission.team.hosts)
    writes, removals = len(operations(field, "writes")), len(operations(field, "takes"))
    rows = (
        f"| hops | {len(field.hops)} |",
        f"| agreements: tuples written {writes}, taken {removals} | {writes + removals} |",
        f"| messages of a broadcast, N(N - 1) = {hosts * (hosts - 1)} for each agreement "
        f"| {(writes + removals) * hosts * (hosts - 1)} |",
    )
    readme = (HERE / "README.md").read_text()
    assert [line for line in rows if line not in readme] == []


def test_waiting_clients_send_no_messages(clients):
    team = clients("//Taker:a@north?0", "//Taker:b@south?0", "//Writer:w@shed?60&1&2")
    team.run(5.0)
    assert len(team.hops) == 2
    team.run(50.0)
    assert len(team.hops) == 2
    team.run(until_done=True)
    assert sorted(operations(team, "takes")) == [("a", '("part", 1)'), ("b", '("part", 2)')]


# --- failures -----------------------------------------------------------------------------------------


@pytest.mark.few(1)
@pytest.mark.parametrize("downtime", [1.0, 8.0, None], ids=["short", "long", "permanent"])
@pytest.mark.parametrize(("client", "host"), [("hoe1", "north"), ("fork", "east")])
def test_tuple_of_a_failed_host_is_processed_once(field, client, host, downtime):
    field.run(until=f'{client} takes ("weed"')
    field.run(0.7)
    field.crash(host)
    if downtime is not None:
        field.at(field.now + downtime, lambda: field.boot(host))
    field.run(until_done=True)
    assert_each_weed_pulled_once(field)
    ((_, returned),) = [item for item in operations(field, "gives back") if item[0] == client]
    assert Counter(tuple_ for _, tuple_ in operations(field, "takes"))[returned] == 2


@pytest.mark.few(1)
@pytest.mark.parametrize("time", [1.0, 2.6, 3.65, 5.0])
def test_scout_failure_neither_loses_nor_repeats_a_row(field, time):
    field.at(time, lambda: field.crash("sky"))
    field.at(time + 2.0, lambda: field.boot("sky"))
    field.run(until_done=True)
    assert_each_weed_pulled_once(field)


@pytest.mark.few(0)
def test_disconnected_robot_cannot_report_a_returned_tuple(field):
    """A disconnected robot pulls a weed; another robot gets the tuple, and the late report is ignored."""
    field.run(until='hoe1 takes ("weed"')
    field.run(0.5)
    others = [host for host in field.mission.team.hosts if host != "north"]
    for host in others:
        field.cut("north", host)
    field.run(4.0)
    for host in others:
        field.heal("north", host)
    field.run(until_done=True)
    assert_each_weed_pulled_once(field)
    assert field.said("hoe1-carrier recovered on this host", "farm") == 1
    assert field.ended["hoe1-carrier"] == "done"
    assert field.said("retry: ", "north") <= 5, "retries must have intervals"


@pytest.mark.few(0)
def test_interrupted_wait_is_resumed(field):
    """Without a majority of hosts, waiting clients get an error; later they repeat the call."""
    field.run(until='scout takes ("row", 1)')
    field.run(0.1)
    for host in ROBOTS:
        field.cut("farm", host)
    field.run(4.0)
    for host in ROBOTS:
        field.heal("farm", host)
    field.run(until_done=True)
    assert field.said("retry: ", "farm") >= 3
    assert_each_weed_pulled_once(field)


def test_all_agents_get_an_error_from_a_restarted_space(field):
    field.at(4.0, lambda: field.crash("farm"))
    field.at(5.0, lambda: field.boot("farm"))
    field.run(until_done=True)
    assert set(field.ended.values()) == {"died"}
    assert field.said("the space was started again, and is empty") == 5


# --- the space ----------------------------------------------------------------------------------------


def test_only_one_of_two_takers_gets_the_tuple(clients):
    team = clients("//Taker:a@north?1", "//Taker:b@south?1", "//Writer:w@shed?0&1", "//Writer:v@shed?9&2")
    team.run(until=" has ")
    team.run(5.0)
    assert team.said(" has ") == 1
    team.run(until_done=True)
    assert sorted(tuple_ for _, tuple_ in operations(team, "takes")) == ['("part", 1)', '("part", 2)']
    assert {client for client, _ in operations(team, "takes")} == {"a", "b"}


def test_longest_waiting_client_gets_the_oldest_tuple(clients):
    team = clients(
        "//Taker:c@north?0.2", "//Taker:a@south?0.4", "//Taker:b@east?0.6", "//Writer:w@shed?3&7&8&9",
        "//Taker:late@shed?5", "//Writer:v@shed?4&10&11",
    )  # fmt: skip
    team.run(until_done=True)
    parts = ["c 7", "a 8", "b 9", "late 10"]
    assert [f"{client} {tuple_[9:-1]}" for client, tuple_ in operations(team, "takes")] == parts


def test_client_that_waits_for_another_tuple_does_not_block(clients):
    team = clients("//Taker:first@north?0&5", "//Taker:second@south?1", "//Writer:w@shed?3&4&5")
    team.run(until_done=True)
    assert operations(team, "takes") == [("second", '("part", 4)'), ("first", '("part", 5)')]


def test_all_waiting_readers_get_a_tuple_that_stays(clients):
    team = clients("//Reader:a@north?0", "//Taker:b@south?1", "//Reader:c@east?2", "//Writer:w@shed?3&1&2")
    team.run(until_done=True)
    assert operations(team, "reads") == [("a", '("part", 1)'), ("c", '("part", 2)')]
    assert operations(team, "takes") == [("b", '("part", 1)')]


def test_repeated_request_gets_the_same_tuple_without_further_effect(clients):
    """A client whose call may have been executed repeats it with the same number."""
    program = """
    coordinator Again {
        init(string[] arg) {
            TupleServer space = findTupleServer("space");
            Tuple[] parts = {new Tuple("part").with(1), new Tuple("part").with(2), new Tuple("part").with(3)};
            Request part = new Request(new Tuple("part").any("int"), true);
            for (int i = 0; i < 3; i += 1) print("has " + space.exchange("a", 1, parts, part).shown());
            print("then " + space.exchange("a", 2, null, part).shown());
            print("then " + space.exchange("a", 3, new Tuple[] {}, part).shown());
            space.exchange("b", 1, new Tuple[] {}, new Request(new Tuple("part").any("int"), false));
            space.exchange("b", 2, null, null);
        }
    }
    """
    team = clients("//Again:a@north", program=program)
    team.run(until_done=True)
    assert team.said('has ("part", 1)') == 3
    assert [tuple_[9:-1] for _, tuple_ in operations(team, "writes")] == ["1", "2", "3"]
    assert [tuple_[9:-1] for _, tuple_ in operations(team, "takes")] == ["1", "2", "3"]
    assert operations(team, "reads") == [("b", '("part", 1)')]
    assert operations(team, "gives back") == [("a", '("part", 1)')], (
        "a tuple that was only read is not given back"
    )


# --- templates --------------------------------------------------------------------------------------------

#: A template, a tuple, and whether they match.
MATCHES = [
    ("", "", True),
    ("", '.with("a")', False),
    (".with(1)", ".with(1)", True),
    (".with(1)", ".with(2)", False),
    (".with(1)", ".with(1.0)", False),
    ('.with("1")', ".with(1)", False),
    ('.with("true")', ".with(true)", False),
    (".with(true)", ".with(true)", True),
    (".with(true)", ".with(false)", False),
    ('.with("")', '.with("")', True),
    ('.with("?int")', ".with(3)", False),
    (".with(0.1 + 0.2)", ".with(0.3)", False),
    (".with(1000.0)", ".with(1e3)", True),
    (".with(0.0)", ".with(-0.0)", True),
    ('.any("int")', ".with(-7)", True),
    ('.any("int")', ".with(7.0)", False),
    ('.any("real")', ".with(7.5)", True),
    ('.any("string")', '.with("")', True),
    ('.any("boolean")', ".with(false)", True),
    ('.any("int")', "", False),
    ('.any("int")', ".with(1).with(2)", False),
    ('.with("a").any("real").with(true)', '.with("a").with(2.5).with(true)', True),
    ('.with("a").any("real").with(true)', '.with("a").with(2.5).with(false)', False),
    ('.any("string").any("int").any("real").any("boolean")', '.with("b").with(1).with(1.0).with(true)', True),
    (
        '.any("string").any("int").any("real").any("boolean")',
        '.with("b").with(1.0).with(1).with(true)',
        False,
    ),
]


def test_templates_match_by_number_types_and_values(clients):
    body = "".join(
        f"print(new Tuple(){template}.matches(new Tuple(){values}));\n" for template, values, _ in MATCHES
    )
    team = clients("//Asker:asker@shed", program=f"coordinator Asker {{ init(string[] arg) {{ {body} }} }}")
    team.run(until_done=True)
    results = [line.text for line in team.log if line.text in ("asker: true", "asker: false")]
    pairs = zip(MATCHES, results, strict=True)
    assert [case for case, result in pairs if result != f"asker: {str(case[2]).lower()}"] == []


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ('space.out(new Tuple("part").any("int"));', '("part", ?int) is a template; only tuples are written'),
        ('new Tuple("part").with(1).text(1);', 'field 1 of ("part", 1) is no string'),
        ('new Tuple("part").any("int").integer(1);', 'field 1 of ("part", ?int) is no int'),
        ('new Tuple("part").number(1);', "IndexException"),
        ("string none; new Tuple().with(none);", "NullException"),
    ],
)
def test_invalid_use_of_a_space_is_an_error(clients, statement, message):
    declaration = 'Space space = new Space(findTupleServer("space"), "bad");'
    program = f"coordinator Bad {{ init(string[] arg) {{ {declaration} {statement} }} }}"
    team = clients("//Bad:bad@shed", program=program)
    team.run(until_done=True)
    assert team.ended == {"bad": "died"}
    assert team.said(message) == 1


# --- the drawing --------------------------------------------------------------------------------------


def texts(svg: str) -> list[str]:
    return sorted(re.findall(r"<text[^>]*>([^<]*)<", svg))


def test_drawing_equals_that_of_the_readme(field):
    draw_turns.run_with_host_failure(field)
    assert_each_weed_pulled_once(field)
    assert operations(field, "gives back")
    drawing = draw_turns.draw(field)
    background, rows, returned = 1, 5, 1
    assert drawing.count("<rect") == background + rows + WEEDS + returned
    assert texts(drawing) == texts((HERE / "tracks.svg").read_text()), "run draw_turns.py"
