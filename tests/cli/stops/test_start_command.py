"""`lfield start`, and reports on a start that waits: for a robot that is off, or out of date."""

import json
import re

import pytest

pytestmark = pytest.mark.process

PROGRAM = """
resource Echo {
    init(string[] arg) { }
    portal say() { write("here\\n"); }
}
coordinator Caller {
    init(string[] arg) {
        print("begins");
        while (true) {
            try { findEcho("echo").say(); return; }
            catch (UnreachableResourceException e) { sleep(1.0); }
        }
    }
}
"""
TEAM = "//Caller:tom@alpha\n//Echo:echo@bravo\n"


@pytest.fixture
def maps(lfield, here):
    """The addresses of the hosts of a signed bundle."""
    lfield.mission(PROGRAM, TEAM)
    maps = lfield.maps(["alpha", "bravo"])
    here("build", "mission.dL", status=0)
    here("sign", "mission.lfm", status=0)
    return maps


def test_a_start_waits_until_the_operator_leaves_out_the_missing_host(lfield, here, maps) -> None:
    alpha = lfield.start("up", "mission.lfm", *maps, "--host", "alpha", "--first-start")
    alpha.wait_for(r"^tom not started: waiting for bravo \(no link yet\)")
    output = here("ps", "mission.lfm", *maps, status=69)
    assert any(re.search(r"alpha +tom +waits for bravo to start", line) for line in output.out)
    assert any("alpha: tom is not started: waiting for bravo" in line for line in output.out)
    data = json.loads("\n".join(here("ps", "mission.lfm", *maps, "--json").out))["alpha"]
    assert data["start"] == {"agents": ["tom"], "hosts": ["bravo"], "without": [], "held": ""}
    assert data["refused"] == []

    waits = here("start", "mission.lfm", *maps, status=1)
    assert any("alpha: tom is not started: waiting for bravo" in line for line in waits.err)
    wrong = here("start", "mission.lfm", *maps, "--without", "brovo", status=64)
    assert "the mission has no host 'brovo': did you mean 'bravo'?" in wrong.err[0]
    started = here("start", "mission.lfm", *maps, "--without", "bravo")
    assert (started.status, started.out) == (0, ["alpha: tom started"])
    alpha.wait_for("^tom: begins$")
    assert here("start", "mission.lfm", *maps, "--without", "bravo").out == [
        "alpha: no coordinator waits to be started"
    ]
    # The host that was left out starts later, and joins.
    bravo = lfield.start("up", "mission.lfm", *maps, "--host", "bravo", "--first-start")
    bravo.wait_for("^here$")


@pytest.mark.few(0)
def test_a_host_with_an_old_bundle_is_named_by_the_printed_digests(lfield, here, maps) -> None:
    (old,) = (re.search(r"bundle +(\w+)", line)[1] for line in here("inspect", "mission.lfm").out[:1])
    bravo = lfield.start("up", "mission.lfm", *maps, "--host", "bravo", "--first-start")
    bravo.wait_for("bravo listening ")
    lfield.mission(PROGRAM.replace("here", "there"), TEAM)
    built, signed = here("build", "mission.dL"), here("sign", "mission.lfm")
    (new,) = {re.search(r"bundle (\w+)", result.err[0])[1] for result in (built, signed)}
    assert new != old
    alpha = lfield.start("up", "mission.lfm", *maps, "--host", "alpha", "--first-start")
    reason = f"alpha runs bundle {new} and bravo runs bundle {old}, which differ in their program"
    also = f"bravo runs bundle {old} and alpha runs bundle {new}, which differ in their program"
    alpha.wait_for(rf"^tom not started: waiting for bravo \(refused: ({reason}|{also})")
    bravo.wait_for(f"{reason}|{also}")
    output = here("ps", "mission.lfm", *maps).out
    assert any(re.match(f"alpha refuses bravo: ({reason}|{also})", line) for line in output), output
    assert {line.split(",")[0] for line in output if line.startswith("bundle ")} == {
        f"bundle {new}",
        f"bundle {old}",
    }
    data = json.loads("\n".join(here("ps", "mission.lfm", *maps, "--json").out))
    assert [(one["host"], one["bundle"]) for one in data["alpha"]["refused"]] == [("bravo", old)]
    assert [(one["host"], one["bundle"]) for one in data["bravo"]["refused"]] == [("alpha", new)]
    assert alpha.said.count("tom: begins") == 0
