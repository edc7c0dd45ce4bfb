"""Calls of an absent host: how long they wait for it, and with which exception they end."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from lfield.host.inputs import HostExited
from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal look() emit int { return 1; }
    portal stay(real seconds) emit int { sleep(seconds); return 7; }
}
coordinator Walker {
    init(string[] arg) {
        Post near = findPost("near");
        Post far = findPost("far");
        print("met " + i2s(far.look()) + i2s(near.look()));
        sleep(s2f(arg[1]));
        print("asks");
        //call
        print("over");
    }
}
"""
CALL = """
        try {
            print("got " + i2s(far.look()));
        } catch (UnreachableResourceException e) {
            print("threw " + e.message());
        }
"""
BEGUN = """
        int[] got = new int[1];
        try {
            together { got[0] = far.stay(s2f(arg[2])); near.stay(s2f(arg[3])); }
            print("got " + i2s(got[0]));
        } catch (UnreachableResourceException e) {
            print("threw " + e.message());
        }
"""
TOGETHER = """
        try {
            together { near.stay(0.5); far.look(); }
        } catch (UnreachableResourceException e) {
            print("threw " + e.message());
        }
"""
TEAM = "//Post:near@alpha\n//Post:far@bravo\n//Walker:w@alpha?{0}\n"


def fleet_of(folder: Path, words: str, call: str = CALL, program: str = PROGRAM) -> Fleet:
    (folder / "mission.L").write_text(program.replace("//call", call))
    (folder / "mission.dL").write_text(TEAM.format(words))
    return Fleet(load_mission(folder / "mission.dL"), seed=3)


def logged(fleet: Fleet, word: str) -> tuple[float, str]:
    """The time of the first line that begins with a word, and the rest of the line."""
    for at, _, text in fleet.log:
        line = text.strip().removeprefix("w: ")
        if line == word or line.startswith(f"{word} "):
            return at, line.removeprefix(word).strip()
    raise AssertionError(f"no line begins with {word}: {fleet.log}")


def start_of(fleet: Fleet) -> None:
    fleet.run(1.0)
    assert logged(fleet, "met")


@pytest.mark.parametrize("end", ["crash", "power_off"])
def test_a_host_killed_seven_seconds_ago_is_waited_for_only_the_rest_of_the_time(tmp_path, end):
    fleet = fleet_of(tmp_path, "12.0")
    start_of(fleet)
    met = logged(fleet, "met")[0]
    fleet.run(met + 5.0 - (3.0 if end == "power_off" else 0.0) - fleet.now)
    getattr(fleet, end)("bravo")
    fleet.run(20.0)
    (asked_at, _), (threw, reason) = logged(fleet, "asks"), logged(fleet, "threw")
    assert threw - asked_at < 0.1
    before, seconds, after = re.split(r"([\d.]+)", reason)
    assert before == "bravo could not be reached: there has been no link for "
    assert 6.0 < float(seconds) < 8.0
    assert after == " s; is it up?"


def test_a_together_does_not_wait_for_an_absent_host_without_begun_calls(tmp_path):
    fleet = fleet_of(tmp_path, "12.0", TOGETHER)
    start_of(fleet)
    fleet.run(logged(fleet, "met")[0] + 5.0 - fleet.now)
    fleet.crash("bravo")
    fleet.run(20.0)
    (asked_at, _), (threw, reason) = logged(fleet, "asks"), logged(fleet, "threw")
    assert threw - asked_at < 0.6, "as long as the other call takes"
    assert re.fullmatch(
        r"bravo could not be reached: there has been no link for .* \(far.look\(\) has not begun\)", reason
    )


def test_the_time_of_an_absent_host_counts_from_the_end_of_its_link(tmp_path):
    fleet = fleet_of(tmp_path, "5.0")
    start_of(fleet)
    met = logged(fleet, "met")[0]
    fleet.run(max(0.0, met + 2.0 - fleet.now))
    fleet.crash("bravo")
    killed = fleet.now
    fleet.run(20.0)
    (asked_at, _), (threw, reason) = logged(fleet, "asks"), logged(fleet, "threw")
    assert asked_at - killed < 5.0
    assert threw - killed == pytest.approx(10.0, abs=0.3)
    assert reason == "bravo could not be reached within 10 s; is it up?"


def test_a_host_that_returns_in_time_is_called(tmp_path):
    fleet = fleet_of(tmp_path, "5.0")
    start_of(fleet)
    fleet.run(3.0)
    fleet.cut("alpha", "bravo")
    fleet.run(4.0)
    fleet.heal("alpha", "bravo")
    fleet.run(5.0)
    assert logged(fleet, "got")[1] == "1"


def test_a_host_that_has_surely_ended_is_not_waited_for(tmp_path):
    fleet = fleet_of(tmp_path, "6.0")
    start_of(fleet)
    fleet.run(4.0)
    fleet.crash("bravo")
    alpha = fleet.runs["alpha"]
    alpha.process.loop.enter(lambda: alpha.host.dispatch(HostExited("bravo")))
    fleet.run(10.0)
    (asked_at, _), (threw, reason) = logged(fleet, "asks"), logged(fleet, "threw")
    assert threw - asked_at < 0.1
    assert reason == "bravo could not be reached: it has ended"


def test_a_host_that_was_never_linked_is_waited_for_once(tmp_path):
    (tmp_path / "mission.devices.yaml").write_text("start: {without: [bravo]}\n")
    twice = CALL.replace('"threw', '"first') + CALL
    fleet = fleet_of(tmp_path, "0.1", twice, re.sub(r'print\("met .*', "", PROGRAM))
    fleet.crash("bravo")
    fleet.run(25.0)
    (asked_at, _), (first, reason), (threw, again) = (
        logged(fleet, "asks"),
        logged(fleet, "first"),
        logged(fleet, "threw"),
    )
    assert first - asked_at == pytest.approx(10.0, abs=0.3)
    assert reason == "bravo could not be reached within 10 s; is it up?"
    assert threw - first < 0.1
    assert again.startswith("bravo could not be reached: there has been no link for 1")


def test_begun_calls_on_an_absent_host_are_waited_for(tmp_path):
    fleet = fleet_of(tmp_path, "0.1&7.0&1.0", BEGUN)
    start_of(fleet)
    asked_at = logged(fleet, "asks")[0]
    fleet.run(max(0.0, asked_at + 0.5 - fleet.now))
    fleet.cut("alpha", "bravo")
    fleet.run(asked_at + 12.0 - fleet.now)
    fleet.heal("alpha", "bravo")
    fleet.run(5.0)
    assert logged(fleet, "got")[1] == "7"
