"""The field is weeded once despite failures; guarantees of the tuple space to any client."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import carried
import pytest

HERE = Path(__file__).parent
WEEDS = 11
ROBOTS = ("sky", "north", "south", "east")

#: Test clients: coordinators that use the space directly. Each waits, then performs one operation.
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
    """A team of clients, one per line of a deployment, around a space on the host `shed`."""

    def made(*lines: str, program: str = CLIENTS):
        (tmp_path / "mission.L").write_text(f'include "{HERE / "space.L"}";\n{program}')
        (tmp_path / "mission.dL").write_text("\n".join(["//TupleServer:space@shed", *lines]))
        return lfield_mission(tmp_path / "mission.dL")

    return made


def deeds(team, verb: str) -> list[tuple[str, str]]:
    """The agent and tuple of each operation of a kind, in order."""
    found = (re.match(rf"(\S+) {verb} (\(.*)", line.text) for line in team.log)
    return [(match[1], match[2]) for match in found if match]


def assert_weeded(team) -> None:
    """Every weed that was found is pulled once, and every row was inspected once."""
    written = [tuple_ for _, tuple_ in deeds(team, "writes")]
    pulled = Counter(re.findall(r'\("pulled", (\d+, [\d.]+), ', "\n".join(written)))
    counted = Counter(re.findall(r'\("weed", ([1-9]\d*, [\d.]+), ', "\n".join(written)))
    assert pulled == counted
    assert len(pulled) == WEEDS
    assert set(pulled.values()) == {1}
    assert team.said(f"farmer: {WEEDS} weeds are pulled", "farm") == 1
    assert set(team.ended.values()) == {"done"}


# --- the field ----------------------------------------------------------------------------------------


def test_every_weed_is_pulled_once_and_all_agents_return(field):
    field.run(until_done=True)
    assert_weeded(field)
    assert len(field.ended) == 5
    pulled = {who for who, tuple_ in deeds(field, "writes") if tuple_.startswith('("pulled"')}
    assert pulled == {"hoe1", "hoe2", "fork"}
    forked = [tuple_ for who, tuple_ in deeds(field, "takes") if who == "fork"]
    assert forked
    assert all('"dock"' in tuple_ for tuple_ in forked)
    assert sorted(who for who, _ in deeds(field, "reads")) == ["fork", "hoe1", "hoe2"]


def test_page_states_the_hops_and_the_messages_of_a_broadcast(field):
    field.run(until_done=True)
    hosts = len(field.mission.team.hosts)
    writes, removals = len(deeds(field, "writes")), len(deeds(field, "takes"))
    rows = (
        f"| hops | {len(field.hops)} |",
        f"| agreements: tuples written {writes}, taken {removals} | {writes + removals} |",
        f"| messages of a broadcast, N(N - 1) = {hosts * (hosts - 1)} for each agreement "
        f"| {(writes + removals) * hosts * (hosts - 1)} |",
    )
    page = (HERE / "README.md").read_text()
    assert [line for line in rows if line not in page] == []


def test_waiting_needs_no_messages(clients):
    team = clients("//Taker:a@north?0", "//Taker:b@south?0", "//Writer:w@shed?60&1&2")
    team.run(5.0)
    assert len(team.hops) == 2
    team.run(50.0)
    assert len(team.hops) == 2
    team.run(until_done=True)
    assert sorted(deeds(team, "takes")) == [("a", '("part", 1)'), ("b", '("part", 2)')]


# --- failures -----------------------------------------------------------------------------------------


@pytest.mark.few(2)
@pytest.mark.parametrize("back", [1.0, 8.0, None], ids=["soon", "late", "never"])
@pytest.mark.parametrize(("client", "host"), [("hoe1", "north"), ("fork", "east")])
def test_tuple_taken_by_a_failed_host_is_processed_once(field, client, host, back):
    field.run(until=f'{client} takes ("weed"')
    field.run(0.7)
    field.crash(host)
    if back is not None:
        field.at(field.now + back, lambda: field.boot(host))
    field.run(until_done=True)
    assert_weeded(field)
    ((_, given_back),) = [deed for deed in deeds(field, "gives back") if deed[0] == client]
    assert Counter(tuple_ for _, tuple_ in deeds(field, "takes"))[given_back] == 2


@pytest.mark.few(1)
@pytest.mark.parametrize("moment", [1.0, 2.6, 3.65, 5.0])
def test_scout_failure_neither_loses_nor_repeats_a_row(field, moment):
    field.at(moment, lambda: field.crash("sky"))
    field.at(moment + 2.0, lambda: field.boot("sky"))
    field.run(until_done=True)
    assert_weeded(field)


def test_disconnected_robot_cannot_report_a_returned_tuple(field):
    """It pulls a weed while disconnected, which others pull again; its own report comes too late."""
    field.run(until='hoe1 takes ("weed"')
    field.run(0.5)
    away = [host for host in field.mission.team.hosts if host != "north"]
    for host in away:
        field.cut("north", host)
    field.run(4.0)
    for host in away:
        field.heal("north", host)
    field.run(until_done=True)
    assert_weeded(field)
    assert field.said("hoe1-carrier recovered on this host", "farm") == 1
    assert field.ended["hoe1-carrier"] == "done"
    assert field.said("once more: ", "north") <= 5, "a refused agent retries at intervals"


def test_interrupted_wait_is_resumed(field):
    """Without a majority no operation is possible, so waiting clients get an error; their call in the space
    remains.
    """
    field.run(until='scout takes ("row", 1)')
    field.run(0.1)
    for host in ROBOTS:
        field.cut("farm", host)
    field.run(4.0)
    for host in ROBOTS:
        field.heal("farm", host)
    field.run(until_done=True)
    assert field.said("once more: ", "farm") >= 3
    assert_weeded(field)


def test_restarted_space_is_empty_and_informs_all_agents(field):
    field.at(4.0, lambda: field.crash("farm"))
    field.at(5.0, lambda: field.boot("farm"))
    field.run(until_done=True)
    assert set(field.ended.values()) == {"died"}
    assert field.said("the space was started again, and is empty") == 5


# --- the space ----------------------------------------------------------------------------------------


def test_one_of_two_simultaneous_takers_gets_the_tuple(clients):
    team = clients("//Taker:a@north?1", "//Taker:b@south?1", "//Writer:w@shed?0&1", "//Writer:v@shed?9&2")
    team.run(until=" has ")
    team.run(5.0)
    assert team.said(" has ") == 1
    team.run(until_done=True)
    assert sorted(tuple_ for _, tuple_ in deeds(team, "takes")) == ['("part", 1)', '("part", 2)']
    assert {who for who, _ in deeds(team, "takes")} == {"a", "b"}


def test_longest_waiting_taker_and_oldest_tuple_come_first(clients):
    team = clients(
        "//Taker:c@north?0.2", "//Taker:a@south?0.4", "//Taker:b@east?0.6", "//Writer:w@shed?3&7&8&9",
        "//Taker:late@shed?5", "//Writer:v@shed?4&10&11",
    )  # fmt: skip
    team.run(until_done=True)
    parts = ["c 7", "a 8", "b 9", "late 10"]
    assert [f"{who} {tuple_[9:-1]}" for who, tuple_ in deeds(team, "takes")] == parts


def test_taker_of_another_tuple_does_not_block(clients):
    team = clients("//Taker:first@north?0&5", "//Taker:second@south?1", "//Writer:w@shed?3&4&5")
    team.run(until_done=True)
    assert deeds(team, "takes") == [("second", '("part", 4)'), ("first", '("part", 5)')]


def test_readers_wake_and_leave_the_tuple(clients):
    team = clients("//Reader:a@north?0", "//Taker:b@south?1", "//Reader:c@east?2", "//Writer:w@shed?3&1&2")
    team.run(until_done=True)
    assert deeds(team, "reads") == [("a", '("part", 1)'), ("c", '("part", 2)')]
    assert deeds(team, "takes") == [("b", '("part", 1)')]


def test_repeated_request_gets_the_same_answer_and_takes_nothing_more(clients):
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
    assert [tuple_[9:-1] for _, tuple_ in deeds(team, "writes")] == ["1", "2", "3"]
    assert [tuple_[9:-1] for _, tuple_ in deeds(team, "takes")] == ["1", "2", "3"]
    assert deeds(team, "reads") == [("b", '("part", 1)')]
    assert deeds(team, "gives back") == [("a", '("part", 1)')], "a read tuple stays in the space"


# --- forms --------------------------------------------------------------------------------------------

#: A template, a tuple, and whether they match.
FORMS = [
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
    asked = "".join(f"print(new Tuple(){like}.matches(new Tuple(){that}));\n" for like, that, _ in FORMS)
    team = clients("//Asker:asker@shed", program=f"coordinator Asker {{ init(string[] arg) {{ {asked} }} }}")
    team.run(until_done=True)
    said = [line.text for line in team.log if line.text in ("asker: true", "asker: false")]
    wrong = [
        form for form, answer in zip(FORMS, said, strict=True) if answer != f"asker: {str(form[2]).lower()}"
    ]
    assert wrong == []


@pytest.mark.parametrize(
    ("statement", "problem"),
    [
        ('space.out(new Tuple("part").any("int"));', '("part", ?int) is a template; only tuples are written'),
        ('new Tuple("part").with(1).text(1);', 'field 1 of ("part", 1) is no string'),
        ('new Tuple("part").any("int").integer(1);', 'field 1 of ("part", ?int) is no int'),
        ('new Tuple("part").number(1);', "IndexException"),
        ("string none; new Tuple().with(none);", "NullException"),
    ],
)
def test_invalid_use_of_a_space_is_reported(clients, statement, problem):
    declaration = 'Space space = new Space(findTupleServer("space"), "bad");'
    program = f"coordinator Bad {{ init(string[] arg) {{ {declaration} {statement} }} }}"
    team = clients("//Bad:bad@shed", program=program)
    team.run(until_done=True)
    assert team.ended == {"bad": "died"}
    assert team.said(problem) == 1


# --- the picture --------------------------------------------------------------------------------------


def test_picture_shows_the_run_of_the_page(field):
    drawn = carried.draw(carried.shown(field))
    assert_weeded(field)
    assert deeds(field, "gives back")
    assert drawn.count("<rect") - 1 == 5 + WEEDS + 1, "the returned weed is worked on twice"

    def shows(svg: str) -> list[str]:
        return sorted(re.findall(r"<text[^>]*>([^<]*)<", svg))

    assert shows(drawn) == shows((HERE / "tracks.svg").read_text()), "run carried.py"
