"""`lfield query` from the files alone, and from a running team."""

from __future__ import annotations

import json
import re

import pytest
from scripted_snapshots import batch_of

from lfield.cli.main import main
from lfield.errors import AddressError, HandshakeError, WireError
from lfield.wire.observer_messages import AttributeReading, DirectoryEntry, Status

CAPABILITIES = """\
registry: 1
providers:
  Hoist:
    attributes: {payload: 20.0, speed: 0.5, environment: [terrestrial]}
    live: {battery: motor.battery}
    serves: {Lift: {}}
  Hand: {attributes: {payload: 0.4, accuracy: 0.01}, serves: {Grip: {}}}
  Mast: {attributes: {payload: 3.0, speed: 0.2, accuracy: 0.02}, serves: {Climb: {}}}
agents:
  arm2: {payload: 1.2}
  mast: {tools: [sling]}
"""
DEPLOYMENT = """\
//Hoist:arm1@alpha
//Hoist:arm2@bravo
//Hand:hand@charlie
//Mast:mast@charlie
//Boss:boss@alpha
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A mission of three hosts, shown on a page of 120 columns."""
    (tmp_path / "mission.dL").write_text(DEPLOYMENT)
    (tmp_path / "mission.capabilities.yaml").write_text(CAPABILITIES)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    return tmp_path


@pytest.fixture
def ask(folder, capsys):
    """`ask(query, *options)`: the status, the output without scores, and the errors."""

    def asked(query: str, *options: str) -> tuple[int, list[str], list[str]]:
        status = main(["query", query, "--deploy", "mission.dL", "--files", *options])
        output = capsys.readouterr()
        assert "a bug in lfield" not in output.err
        lines = [re.sub(r"\b0\.\d{3}\b", "0.xxx", line).rstrip() for line in output.out.splitlines()]
        return status, lines, output.err.splitlines()

    return asked


@pytest.mark.parametrize("words", ["--files mission.dL", "mission.dL --files", "mission.lfm"])
def test_a_mission_without_a_query_is_not_used_as_the_query(words: str, folder, capsys) -> None:
    assert main(["query", *words.split()]) == 64
    assert "no capability is named before mission." in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        "--files Lift mission.dL",
        "Lift --files mission.dL",
        "Lift mission.dL --files",
        "Lift --team 2 mission.dL --files",
    ],
)
def test_the_mission_may_follow_an_option(arguments: str, folder, capsys) -> None:
    assert main(["query", *arguments.split()]) == 0
    assert "arm1" in capsys.readouterr().out


def test_offers_are_a_table_and_compositions_a_tree(ask, monkeypatch):
    monkeypatch.setenv("COLUMNS", "140")
    status, out, err = ask("Lift where payload >= 0.1")
    assert (status, err) == (0, [])
    assert out == [
        "from the files: nothing is running, live attributes are unknown",
        "",
        "Lift (skill.material_handling.lifting)",
        "RANK  AGENTS     HOST     HOW                         SCORE  ATTRIBUTES",
        "   1  arm1       alpha    direct                      0.xxx  stated: payload 20 kg, speed 0.5 m/s, "
        "environment terrestrial",
        "   2  arm2       bravo    direct                      0.xxx  stated: payload 1.2 kg, speed 0.5 m/s, "
        "environment terrestrial",
        "   3  mast       charlie  by climb-lifts              0.xxx  stated: payload 3 kg, speed 0.2 m/s, "
        "accuracy 0.02 m, tools sling",
        "   4  hand+mast  charlie  composed by grip-and-climb  0.xxx  stated: payload 0.4 kg, "
        "accuracy 0.02 m, speed 0.2 m/s",
        "",
        "4: composed by grip-and-climb",
        "  grip: hand at charlie, direct Grip; stated: payload 0.4 kg, accuracy 0.01 m",
        "  climb: mast at charlie, direct Climb; stated: payload 3 kg, speed 0.2 m/s, "
        "accuracy 0.02 m, tools sling",
    ]


def test_attributes_of_the_condition_come_first(ask):
    _, out, _ = ask("Lift where speed >= 0.5")
    assert "0.xxx  stated: speed 0.5 m/s, payload 20 kg, environment terrestrial" in out[4]


def test_explain_prints_reasons(ask):
    status, out, _ = ask("Lift where payload >= 2.0 && battery >= 0.5", "--explain")
    assert status == 1
    assert out[3:8] == [
        "no agent can",
        "",
        "not offered:",
        "  arm1: battery is not known: the team is not running",
        "  arm2: payload 1.2 < 2.0; battery is not known: the team is not running",
    ]


def test_every_candidate_is_offered_or_refused(ask):
    status, out, _ = ask("Lift where payload >= 5.0", "--explain")
    assert status == 0
    assert sum("arm1" in line for line in out) == 1
    assert "  1: score 0.xxx = 1 / (1 + cost)" in out
    refused = out[out.index("not offered:") + 1 :]
    assert "  arm2: payload 1.2 < 5.0" in refused
    assert any(line.startswith("  climb-lifts: ") for line in refused)
    assert any(line.startswith("  grip-and-climb: ") for line in refused)


def test_a_query_without_offers_has_a_status(ask):
    status, out, err = ask("Lift where payload >= 500.0")
    assert (status, err) == (1, [])
    assert out[2:] == ["Lift (skill.material_handling.lifting)", "no agent can; --explain prints the reasons"]


def test_an_id_asks_for_all_capabilities_below_it(ask):
    status, out, _ = ask("skill.material_handling")
    assert status == 0
    heads = [line.partition(" (")[0] for line in out if line.endswith(")") and " (skill." in line]
    assert heads == ["Grip", "Haul", "Lift", "PickAndPlace", "Reel", "Release", "Retrieve"]
    assert ask("skill.lifting")[1][2] == "Lift (skill.material_handling.lifting)"


def test_distances_depend_on_the_host_of_the_query(ask, capsys):
    def scores(*options):
        main(["query", "Lift", "--deploy", "mission.dL", "--files", "--json", *options])
        (answer,) = json.loads(capsys.readouterr().out)["capabilities"]
        return {offer["agent"]: offer["score"] for offer in answer["offers"]}

    here, there = scores("--at", "bravo"), scores()
    assert here["arm2"] > there["arm2"]
    assert here["arm1"] == there["arm1"]


def test_offers_are_printed_as_json(ask):
    status, out, _ = ask("Lift where payload >= 0.1", "--json")
    document = json.loads("\n".join(out).replace("0.xxx", "0.5"))
    assert status == 0
    assert {k: v for k, v in document.items() if k != "capabilities"} == {
        "query": "Lift where payload >= 0.1",
        "constraint": "payload >= 0.1",
        "source": "files",
        "answered": [],
        "silent": {},
        "codes": {},
    }
    (lift,) = document["capabilities"]
    assert (lift["primitive"], lift["id"]) == ("Lift", "skill.material_handling.lifting")
    first, _, third, fourth = lift["offers"]
    fields = {"primitive", "agent", "host", "kind", "rule", "score", "attributes", "parts"}
    assert set(first) == {*fields, "cost", "terms", "fitness"}
    terms = first["terms"].values()
    assert sum(term["weight"] * term["amount"] for term in terms) == pytest.approx(first["cost"])
    shares = first["fitness"].values()
    fitness = sum(share["share"] * share["penalty"] for share in shares)
    assert fitness == pytest.approx(first["terms"]["fitness"]["amount"])
    assert (first["agent"], first["kind"], first["rule"], first["parts"]) == ("arm1", "direct", None, {})
    assert first["attributes"]["payload"] == {"value": 20.0, "unit": "kg", "age": 0.0, "source": "stated"}
    assert first["attributes"]["environment"] == {
        "value": ["terrestrial"],
        "unit": "",
        "age": 0.0,
        "source": "stated",
    }
    assert (third["kind"], third["rule"], list(third["parts"])) == ("equivalent", "climb-lifts", ["by"])
    assert third["parts"]["by"]["primitive"] == "Climb"
    assert {need: part["agent"] for need, part in fourth["parts"].items()} == {
        "grip": "hand",
        "climb": "mast",
    }


def test_the_number_of_shown_offers_is_limited(ask, folder):
    many = "".join(f"//Hoist:more{i}@alpha\n" for i in range(38))
    (folder / "mission.dL").write_text(DEPLOYMENT + many)
    _, out, _ = ask("Lift where payload >= 20.0")
    assert out[-2].split()[:3] == ["32", "more30", "alpha"]
    assert out[-1] == "the best 32 of 39 offers are given"
    (lift,) = json.loads("\n".join(ask("Lift where payload >= 20.0", "--json")[1]))["capabilities"]
    assert (lift["count"], len(lift["offers"])) == (39, 32)


def test_refusals_are_printed_as_json(ask):
    status, out, _ = ask("Grip where payload >= 2.0", "--json")
    assert status == 1
    (grip,) = json.loads("\n".join(out))["capabilities"]
    (refusal,) = grip["refusals"]
    assert refusal == {"subject": "hand", "reasons": ["payload 0.4 < 2.0"], "inner": []}


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("query", "status", "message"),
    [
        (
            "Lift where paylod >= 2.0",
            65,
            [
                "query:1:12: error[C154]: there is no attribute 'paylod'",
                "    Lift where paylod >= 2.0",
                "               ^~~~~~",
                "    hint: did you mean 'payload'?",
                "lfield: 1 error",
            ],
        ),
        (
            "Lfit",
            65,
            [
                "query:1:1: error[C130]: there is no primitive 'Lfit'",
                "    Lfit",
                "    ^~~~",
                "    hint: did you mean 'Lift'?",
                "lfield: 1 error",
            ],
        ),
        (
            "skill.fabrication",
            65,
            [
                "query:1:1: error[C154]: nothing at or below 'skill.fabrication' can be called",
                "    skill.fabrication",
                "    ^~~~~~~~~~~~~~~~~",
                "lfield: 1 error",
            ],
        ),
        (
            "Lift limit -1",
            65,
            [
                "query:1:12: error[C154]: a limit is a whole number from 1 to 1000",
                "    Lift limit -1",
                "               ^",
                "    hint: such as limit 100",
                "lfield: 1 error",
            ],
        ),
        (
            "Lift where " + "payload > 1 && " * 700 + "true",
            64,
            ["lfield: a question has at most 4000 characters, and this one 10515"],
        ),
        ("Lift payload", 64, ['lfield: a question is written like "Lift" or "Lift where payload >= 2.0"']),
        (
            "",
            64,
            ["lfield: an argument is empty; is a shell variable not set?"],
        ),
    ],
)
def test_mistakes_in_a_query_are_reported(ask, query, status, message):
    assert ask(query) == (status, [], message)


def test_all_mistakes_are_reported_at_once(ask):
    status, out, err = ask('Lfit where paylod >= "x" && environment == airy')
    assert (status, out) == (65, [])
    assert sum("error[" in line for line in err) == 4


@pytest.mark.parametrize(
    "query", ["Lift where", "Lift where (", "Lift where " + "(" * 3000, "Lift where payload"]
)
def test_invalid_conditions_are_refused(ask, query):
    status, out, err = ask(query)
    assert status == 65
    assert out == []
    assert err


def test_a_broken_registry_is_refused(ask, folder):
    (folder / "mission.capabilities.yaml").write_text("registry: 1\nagents: {nobody: {payload: 1.0}}\n")
    status, out, err = ask("Lift")
    assert (status, out) == (65, [])
    assert err[0].startswith("mission.capabilities.yaml:2:10: error[C160]")


def test_a_registry_may_be_in_another_file(ask, folder):
    (folder / "other.yaml").write_text(CAPABILITIES.replace("20.0", "30.0"))
    assert "payload 30 kg" in ask("Lift", "--capabilities", "other.yaml")[1][4]
    assert ask("Lift", "--capabilities", "missing.yaml")[0] == 66


def test_an_unknown_host_is_refused(ask):
    status, _, err = ask("Lift", "--at", "alhpa")
    assert status == 64
    assert "alpha" in err[0]


# answers of hosts, without hosts


@pytest.fixture
def ask_with(folder, monkeypatch, capsys):
    """`ask_with(answers, query, *options)`: as `ask`, with these answers of the hosts."""

    def asked(answers, query: str, *options: str) -> tuple[int, list[str], list[str]]:
        monkeypatch.setattr("lfield.operator.client.ask_teams", lambda parties, request, keys: answers)
        monkeypatch.setattr("lfield.operator.client.by_host", lambda answers, party: answers)
        status = main(["query", query, "--deploy", "mission.dL", *options])
        output = capsys.readouterr()
        return status, output.out.splitlines(), output.err.splitlines()

    return asked


def directory(**agents):
    facts = [
        DirectoryEntry(agent, reason, {name: AttributeReading(*fact) for name, fact in facts.items()}, {})
        for agent, (reason, facts) in agents.items()
    ]
    return batch_of(Status("alpha", "", 0.0, b"", b"", [], [], [], [], facts))


def test_live_values_have_an_age(ask_with):
    alpha = directory(arm1=("", {"battery": [0.5, 2.54]}))
    status, out, err = ask_with({"alpha": alpha}, "Lift where battery >= 0.25")
    assert (status, err) == (0, [])
    assert out[0] == "from the running team: 1 of 1 hosts answered"
    assert "measured 2.5 s ago: battery 0.5; stated: payload 20 kg" in out[4]
    _, out, _ = ask_with({"alpha": alpha}, "Lift where battery >= 0.25", "--json")
    (offer,) = json.loads("\n".join(out))["capabilities"][0]["offers"]
    assert offer["attributes"]["battery"] == {"value": 0.5, "unit": "", "age": 2.54, "source": "measured"}


def test_uncallable_agents_and_silent_hosts_are_reported(ask_with):
    answers = {
        "alpha": directory(arm1=("motor: latched", {})),
        "bravo": AddressError("10.0.0.9:8181", "no program listens there; is its host up?"),
    }
    status, out, err = ask_with(answers, "Lift where speed >= 0.5", "--explain")
    assert status == 1
    assert out[0] == "from the running team: 1 of 2 hosts answered"
    assert out[6:8] == ["  arm1: motor: latched", "  arm2: its host bravo does not answer"]
    assert err == ["bravo: cannot use 10.0.0.9:8181: no program listens there; is its host up?"]


def test_refusals_of_hosts_are_reported(ask_with):
    refusal = HandshakeError("alpha wants a key")
    status, out, err = ask_with({"alpha": refusal}, "Lift")
    assert status == 0
    assert out[0] == "from the files: no host answered, live attributes are unknown"
    assert err == ["alpha: alpha wants a key"]


def test_text_of_hosts_is_escaped_for_the_terminal(ask_with):
    _, out, _ = ask_with({"alpha": directory(arm1=("\x1b[2J\x07 gone", {}))}, "Lift", "--explain")
    assert "  arm1: ·[2J· gone" in out


def test_a_query_at_a_host_fails_if_that_host_is_silent(ask_with):
    """Other hosts give another answer: a late host must not change the result."""
    silent = WireError("bravo does not answer in time")
    alpha = directory(arm1=("", {"battery": [0.5, 2.54]}), arm2=("unreachable for 3 s", {}))
    status, out, err = ask_with({"alpha": alpha, "bravo": silent}, "Lift", "--at", "bravo")
    assert (status, out) == (WireError.exit_status, [])
    assert "bravo does not answer in time" in err[0]
    status, out, _ = ask_with({"alpha": alpha, "bravo": silent}, "Lift", "--at", "alpha", "--explain")
    assert status == 0
    assert "  arm2: unreachable for 3 s" in out


def test_stated_attributes_of_the_devices_file_count_without_hosts(folder, ask):
    (folder / "mission.L").write_text(
        "resource Hoist { init(string[] arg) { } portal lift(real height) emit real { return height; }\n"
        "portal lower(real height) emit real { return height; } }\n"
        "coordinator Idle { init(string[] arg) { Lift[] who = findLift(); } }\n"
    )
    (folder / "mission.dL").write_text("//Hoist:arm1@alpha\n//Hoist:arm2@bravo\n//Idle:idle@alpha\n")
    (folder / "mission.capabilities.yaml").write_text(
        "registry: 1\nproviders: {Hoist: {nominal: {payload: 2.0}, serves: {Lift: {}}}}\n"
    )
    (folder / "mission.devices.yaml").write_text("agents: {arm1: {attributes: {mass: 7 kg}}}")
    _, out, _ = ask("Lift where mass == 7")
    assert [line.split()[1] for line in out[4:]] == ["arm1"]
    assert "stated: mass 7 kg" in out[4]


def test_every_term_of_a_score_is_explained(ask):
    _, out, _ = ask("Lift where payload >= 0.1", "--explain")
    terms = out[out.index("scores:") + 1 :]
    assert terms[:3] == [
        "  1: score 0.xxx = 1 / (1 + cost)",
        "    cost 0.5636 = fitness 1 * 0.4636 + hop 0.1 * 1 + near 0.2 * 0 + age 0.2 * 0",
        "      fitness 0.4636 = battery 0.3333 * 0.5 + payload 0.3333 * 0.09091 + speed 0.3333 * 0.8",
    ]
    assert any("hand, Grip: cost" in line for line in terms)


def test_teams_are_listed(ask):
    status, out, _ = ask("Lift where payload >= 0.1", "--team", "2")
    assert status == 0
    assert out[out.index("teams:") + 1 :] == [
        "   1  arm1, arm2",
        "   2  arm1, mast",
        "   3  arm2, mast",
        *_HAND,
    ]
    status, out, _ = ask("Lift where payload >= 0.1", "--team", "4")
    assert (status, out[-1]) == (1, "no team can: 4 agents could be in one")


#: The hand lifts only with the mast, so the mast is not a separate member.
_HAND = ["   4  arm1, hand+mast", "   5  arm2, hand+mast"]


@pytest.mark.parametrize("size", ["0", "-1", "x", "1001"])
def test_an_invalid_team_size_is_refused(ask, capsys, size):
    assert main(["query", "Lift", "--deploy", "mission.dL", f"--team={size}"]) == 64
    assert "a whole number of agents from 1 to 1000" in capsys.readouterr().err


def test_offers_are_ordered_and_limited(ask):
    status, out, _ = ask("Lift where payload >= 0.1 order by payload limit 2")
    assert status == 0
    assert [line.split()[1] for line in out if re.match(r"   \d", line)] == ["hand+mast", "arm2"]
    assert out[-1] == "the best 2 of 4 offers are given"
    assert ask("Lift limit 1")[1][-1] == "the best 1 of 4 offers are given"
    assert (
        ask("Lift order by endurance")[1][-1]
        == "no agent has a value of endurance: offers are not ordered by it"
    )


def test_a_truncated_search_is_reported(folder, ask):
    rule = """
equivalences:
  odd-pair:
    serves: Haul
    needs: {one: Lift, other: Lift}
    where: [one.reach - other.reach == 1234]
    through: GoAndHaul
    source: go_and_haul.L
agents:
"""
    many = 60
    values = "".join(f"  x{i}: {{reach: {1.0 + i}}}\n" for i in range(many))
    (folder / "go_and_haul.L").write_text("")
    (folder / "mission.capabilities.yaml").write_text(CAPABILITIES.replace("agents:\n", rule) + values)
    (folder / "mission.dL").write_text(DEPLOYMENT + "".join(f"//Hoist:x{i}@alpha\n" for i in range(many)))
    status, out, _ = ask("Haul")
    assert status == 1
    assert "odd-pair: more combinations of parts exist than could be tried" in out
