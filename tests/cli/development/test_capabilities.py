"""`lfield capabilities`: the registry as a tree and on sheets, and its errors."""

from __future__ import annotations

import os
import pty
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from lfield.capability.registry_reader.registry_files import read_registry
from lfield.capability.registry_reader.registry_files import shipped as shipped_files
from lfield.cli.main import main
from lfield.operator.registry.sheets import describe

#: Output of `lfield capabilities import` of version 0.3 for ROS specs and a VDA 5050 factsheet.
IMPORTED = Path(__file__).with_name("imported-0.3.yaml")

MISSION = """\
registry: 1
taxonomy:
  skill.juggling: {name: Juggling, meaning: keeps things in the air, aliases: [skill.tossing]}
  skill.juggling.clubs: {meaning: with clubs}
  skill.throwing: {meaning: an old word, deprecated: skill.juggling}
attributes:
  balls: {type: int, better: more, typical: 3.0, meaning: how many}
  tired: {type: real, better: less, live: true, max_age: 30.0}
primitives:
  Juggle:
    id: skill.juggling
    meaning: keeps balls in the air
    portals:
      juggle:
        parameters: {height: {type: real, unit: m, meaning: how high}, seconds: {type: real, unit: s}}
        emit: real
        unit: m
        raises: [DeviceException]
        meaning: juggles so long
providers:
  Clown:
    meaning: two arms and a nose
    attributes: {balls: 5, environment: [terrestrial, aquatic]}
    live: {tired: body.tired}
    serves:
      Juggle:
        when: balls >= 3
        portals: {juggle: {portal: toss, arguments: [{parameter: height, unit: mm}, 7], emit: {unit: cm}}}
agents:
  beppo: {balls: 7}
equivalences:
  climb-juggles:
    serves: Juggle
    by: Climb
    portals: {juggle: {portal: climb, arguments: [height]}}
    when: payload >= 0.5
    loss: 0.9
    meaning: hardly
"""
PROGRAM = """\
resource Clown {
    Body body;
    init(string[] arg) { }
    portal toss(real height, int count) emit real { return height; }
}
"""


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """`run(*words)`: the status, output and errors, in a folder with a mission."""
    (tmp_path / "mission.capabilities.yaml").write_text(MISSION)
    monkeypatch.chdir(tmp_path)

    def ran(*arguments: str) -> tuple[int, list[str], list[str]]:
        status = main(["capabilities", *arguments])
        output = capsys.readouterr()
        assert "a bug in lfield" not in output.err
        return status, output.out.splitlines(), output.err.splitlines()

    ran.folder = tmp_path
    return ran


ADDED = ("--capabilities", "mission.capabilities.yaml")


# tree


def test_tree_shows_a_term_and_its_children(run):
    assert run("tree", "skill.juggling", *ADDED) == (
        0,
        ["skill.juggling: keeps things in the air [Juggle]", "  clubs: with clubs"],
        [],
    )


def test_tree_shows_every_term_once(run):
    status, out, _ = run("tree")
    assert status == 0
    assert len(out) == 1 + len(read_registry().terms)
    assert "    lifting: raises a load and holds it [Lift]" in out
    assert out[0] == f"taxonomy, version {read_registry().version}"
    assert out[1].startswith("descriptive: ")


def test_tree_names_the_replacement_of_a_deprecated_term(run):
    _, out, _ = run("tree", "skill", *ADDED)
    assert "  throwing: out of use, write skill.juggling" in out


@pytest.mark.parametrize("id", ["skill.tossing", "skill.throwing"])
def test_tree_resolves_aliases(run, id):
    assert run("tree", id, *ADDED)[1][0].startswith("skill.juggling: ")


def test_tree_refuses_an_unknown_term(run):
    status, out, err = run("tree", "skill.jugling", *ADDED)
    assert (status, out) == (64, [])
    assert err == ["lfield: the registry has no 'skill.jugling': did you mean 'skill.juggling'?"]


def test_tree_is_drawn_on_a_terminal(run):
    parent, child = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100", "NO_COLOR": "1", "LC_ALL": "C.UTF-8"}
    command = [sys.executable, "-m", "lfield", "capabilities", "tree", "skill.material_handling"]
    done = subprocess.Popen(command, stdout=child, stderr=child, stdin=child, env=environment)
    os.close(child)
    output = b""
    while b"reeling" not in output:
        output += os.read(parent, 4096)
    assert done.wait(60) == 0
    os.close(parent)
    assert "├── " in output.decode()
    assert "[Lift]" in output.decode()


# show


def test_show_prints_a_capability_with_its_term(run):
    status, out, _ = run("show", "Juggle", *ADDED)
    assert status == 0
    assert out == [
        "term skill.juggling",
        "  name     Juggling",
        "  meaning  keeps things in the air",
        "  also     skill.tossing",
        "  below    skill.juggling.clubs",
        "",
        "primitive Juggle",
        "  id          skill.juggling",
        "  meaning     keeps balls in the air",
        "  portals     real juggle(real height, real seconds)",
        "                  juggles so long",
        "                  height: m, how high",
        "                  seconds: s",
        "                  emits m",
        "                  actuate, raises DeviceException",
        "  served by   Clown when balls >= 3",
        "              climb-juggles: every provider of Climb when payload >= 0.5, loss 0.9",
        "  attributes  balls, environment, tired",
    ]
    assert run("show", "skill.tossing", *ADDED)[1] == out
    assert run("show", "juggling", *ADDED)[1] == out


def test_show_prints_a_provider(run):
    assert run("show", "Clown", *ADDED)[1] == [
        "provider Clown",
        "  meaning  two arms and a nose",
        "  source   the mission's own",
        "  states   balls: 5",
        "           environment: aquatic and terrestrial",
        "  reports  tired: body.tired",
        "  serves   Juggle when balls >= 3",
        "               juggle: Clown.toss(height * 1000, 7) -> emitted * 0.01",
    ]


def test_show_prints_an_attribute(run):
    assert run("show", "balls", *ADDED)[1] == [
        "attribute balls",
        "  meaning    how many",
        "  type       int",
        "  better     more",
        "  typical    3",
        "  stated by  Clown: 5",
        "             agent beppo: 7",
    ]
    assert run("show", "tired", *ADDED)[1][-2:] == [
        "  live       counts for 30 s",
        "  stated by  Clown: live, body.tired",
    ]


def test_show_prints_rules(run):
    assert run("show", "climb-juggles", *ADDED)[1] == [
        "one-to-one rule climb-juggles",
        "  meaning  hardly",
        "  serves   Juggle",
        "  by       Climb",
        "  when     payload >= 0.5",
        "  portals  juggle: Climb.climb(height)",
        "  loss     0.9",
    ]
    out = run("show", "grip-and-climb")[1]
    assert out[0] == "one-to-many rule grip-and-climb"
    assert "  serves   Lift" in out
    assert "  through  class GripAndClimb in grip_and_climb.L" in out


def test_everything_in_the_registry_can_be_shown():
    registry = read_registry()
    kinds = (registry.terms, registry.primitives, registry.attributes, registry.providers)
    rules = (registry.equivalences, registry.compositions)
    for name in [name for names in (*kinds, *rules) for name in names]:
        sheets = describe(registry, name)
        assert sheets, name
        assert all(sheet.rows for sheet in sheets), name


def test_show_refuses_an_unknown_name(run):
    status, out, err = run("show", "Juggel", *ADDED)
    assert (status, out) == (64, [])
    assert err == ["lfield: the registry has no 'Juggel': did you mean 'Juggle'?"]


def test_show_prints_the_class_that_a_program_gets(run):
    (run.folder / "mission.L").write_text(PROGRAM)
    status, out, _ = run("show", "Juggle", "--L", "--program", "mission.L", *ADDED)
    assert status == 0
    assert "class Juggle coordinator specific {" in out
    assert "    private Clown byClown;" in out
    assert "            return byClown.toss(height * 1000.0, 7) * 0.01;" in out
    assert not any("as_climb_juggles" in line for line in out)
    everything = run("show", "Juggle", "--L", *ADDED)[1]
    assert "    private Climb as_climb_juggles;" in everything


def test_show_prints_no_class_without_a_capability(run):
    assert run("show", "payload", "--L")[0] == 64
    assert run("show", "Juggle", "--program", "mission.L", *ADDED)[0] == 64
    (run.folder / "mission.L").write_text("resource Juggle { init(string[] arg) { } }\n")
    status, _, err = run("show", "Juggle", "--L", "--program", "mission.L", *ADDED)
    assert (status, err) == (
        64,
        ["lfield: mission.L has a unit 'Juggle' of its own, which hides the capability"],
    )


# check


def test_check_accepts_the_shipped_registry_and_a_valid_mission(run):
    assert run("check") == (0, ["no errors"], [])
    assert run("check", "mission.capabilities.yaml") == (0, ["no errors"], [])


def test_check_reports_all_mistakes_of_all_files(run):
    (run.folder / "one.yaml").write_text("registry: 1\nproviders: {Crane: {serves: {Lfit: {}}}}\n")
    (run.folder / "two.yaml").write_text("registry: 2\nattributes: {weight: {type: real, unit: stone}}\n")
    (run.folder / "bad.capabilities.yaml").write_text("registry: 1\nagents: {x: {paylod: 1}}\n")
    status, out, err = run(
        "check", "one.yaml", "two.yaml", "mission.capabilities.yaml", "bad.capabilities.yaml"
    )
    assert (status, out) == (65, [])
    assert [line for line in err if "error[" in line] == [
        "bad.capabilities.yaml:2:14: error[C120]: there is no attribute 'paylod'",
        "one.yaml:2:30: error[C130]: there is no primitive 'Lfit'",
        "two.yaml:1:11: error[C100]: this is not a registry of version 1",
        "two.yaml:2:41: error[C123]: there is no unit 'stone'",
    ]
    assert err[1:3] == ["    agents: {x: {paylod: 1}}", "                 ^~~~~~"]
    assert err[-1] == "lfield: 4 errors"


def test_check_does_not_fail_on_warnings(run):
    text = MISSION.replace("    id: skill.juggling\n", "    id: skill.throwing\n")
    (run.folder / "mission.capabilities.yaml").write_text(text)
    status, out, err = run("check", "mission.capabilities.yaml")
    assert (status, out) == (0, ["no errors, 1 warning"])
    assert "warning[C190]" in err[0]


def test_check_reads_the_agents_of_a_mission_from_its_deployment(run):
    (run.folder / "mission.dL").write_text("//Clown:pippo@tent\n")
    status, _, err = run("check", "mission.capabilities.yaml")
    assert status == 65
    assert "error[C160]: the deployment has no agent 'beppo'" in err[0]


def test_check_reads_a_registry_alone(run):
    (run.folder / "mine.yaml").write_text("registry: 1\ntaxonomy: {skill: {meaning: mine}}\n")
    assert run("check", "mine.yaml")[0] == 65
    assert run("check", "mine.yaml", "--alone")[0] == 0
    assert run("check", "--alone")[0] == 64


def test_check_compares_a_registry_with_a_program(run):
    (run.folder / "mission.L").write_text(PROGRAM.replace("toss(real", "toss(string"))
    status, _, err = run("check", "mission.capabilities.yaml", "--program", "mission.L")
    assert status == 65
    assert any("error[C171]" in line for line in err)
    assert run("check", "mission.capabilities.yaml", "--program", "missing.L")[0] == 66


#: A program whose Copter is not the one of the stock library.
OWN_COPTER = """
resource Copter {
    init(string[] arg) { }
    portal land() { }
    portal hold() { }
}
"""


def test_a_resource_with_only_the_name_of_a_stock_one_is_a_note(run):
    (run.folder / "own.L").write_text(OWN_COPTER)
    status, out, err = run("check", "--program", "own.L")
    assert (status, out) == (0, ["no errors"])
    assert len(err) == 1
    assert err[0].startswith("note: resource Copter of the program does not serve Move, Climb, Turn, ")
    assert err[0].endswith(" and ReadBattery, unlike the one in lfield: it lacks the portals")
    assert "Land" not in err[0]
    assert "Hold" not in err[0]


def test_a_wrong_promise_of_the_mission_for_it_is_an_error(run):
    (run.folder / "own.L").write_text(OWN_COPTER)
    (run.folder / "own.capabilities.yaml").write_text(
        "registry: 1\nproviders: {Copter: {serves: {Orbit: {portals: {orbit: circle}}}}}\n"
    )
    for arguments in (("own.capabilities.yaml",), ("own.capabilities.yaml", "--program", "own.L")):
        status, _, err = run("check", *arguments)
        assert status == 65
        assert [line for line in err if "error[" in line] == [
            "own.capabilities.yaml:2:49: error[C170]: resource Copter has no portal 'circle'"
        ]
        assert "Orbit" not in err[-2]
        assert err[-1] == "lfield: 1 error"


def test_a_named_file_is_checked_against_the_program(run):
    """A driver's `capabilities.yaml` is checked against the sources in the same folder."""
    (run.folder / "own.L").write_text(OWN_COPTER)
    (run.folder / "capabilities.yaml").write_text(
        "registry: 1\nproviders: {Copter: {serves: {Land: {}, Lift: {}}}}\n"
    )
    status, _, err = run("check", "capabilities.yaml", "--alone", "--program", "own.L")
    assert status == 65
    shipped = next(path for path in shipped_files() if path.name == "providers-mavlink.yaml")
    status, _, err = run("check", str(shipped), "--program", "own.L")
    assert status == 65
    assert sum("error[C170]" in line for line in err) > 3


def test_unreadable_files_have_their_statuses(run):
    status, _, err = run("check", "missing.yaml")
    assert status == 66
    assert err == ["lfield: cannot read missing.yaml: No such file or directory"]
    (run.folder / "bytes.yaml").write_bytes(bytes(range(256)))
    assert run("check", "bytes.yaml")[0] == 65


def test_files_of_the_0_3_importer_are_still_read(run):
    """Files of the removed command `capabilities import` are ordinary registries."""
    shutil.copy(IMPORTED, run.folder / "imported.yaml")
    assert run("check", "imported.yaml") == (0, ["no errors"], [])
    assert run("import", "mule.json")[0] == 64


def test_usage_errors_of_capabilities(run):
    assert run()[0] == 64
    assert run("juggle")[0] == 64
