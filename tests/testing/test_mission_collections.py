"""Dynamic arrays, maps and enums between L and the doubles of a test: lists, dicts and names."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
from small_team import SmallTeam

from lfield.errors import DoubleError

PROGRAM = """
class Place {
    public real north;
    public Place(real n) { north = n; }
}
resource Pump {
    init(string[] arg) { while (true) yield(); }
    portal places(map<string, Place> more) emit map<string, Place> { return more; }
    portal counts() emit map<int, int[]> { return null; }
    portal wrong() emit map<string, int> { return null; }
}
coordinator Boss {
    init(string[] arg) {
        Pump pump = findPump("pump");
        map<string, Place> m = new map<string, Place>();
        m["a"] = new Place(1);
        m["gone"] = new Place(9);
        m.remove("gone");
        map<string, Place> all = pump.places(m);
        for (string key : all) print(key + " " + f2s(all[key].north));
        all["z"] = new Place(5);
        all.remove("b");
        print("z " + f2s(all["z"].north) + " of " + i2s(all.length()));
        map<int, int[]> counts = pump.counts();
        print("keys " + i2s(counts.keys().length()) + " values " + i2s(counts.values().length()));
        counts[-7].append(4);
        print("sum " + i2s(counts[-7][0] + counts[-7][1]));
        print("the end");
        pump.wrong();
    }
}
"""
DEPLOYMENT = "//Pump:pump@bravo //Boss:boss@alpha"


def test_maps_are_dicts(tmp_path: Path) -> None:
    observed: list[dict[str, object]] = []

    def places(more: dict[str, object]) -> dict[str, object]:
        observed.append(dict(more))
        return {"b": more["a"], **more}

    double = SimpleNamespace(places=places, counts=lambda: {-7: [3], 2: []}, wrong=dict)
    team = SmallTeam(tmp_path, PROGRAM, DEPLOYMENT, {"pump": double})
    team.until("the end")
    assert [list(one) for one in observed] == [["a"]]
    for line in ("b 1.0", "a 1.0", "z 5.0 of 2", "keys 2 values 2", "sum 7"):
        assert team.said(line), line


@pytest.mark.parametrize(
    ("returned", "problem"),
    [
        ({"x": 1.5}, "returns map<string, int>, and in it int, but its double has returned float 1.5"),
        ({3: 1}, "and in it string, but its double has returned int 3"),
        ({None: 1}, "returns map<string, int>, but its double has returned a dict with a key None"),
        ([1], "returns map<string, int>, but its double has returned list [1]"),
    ],
)
def test_a_dict_of_other_types_is_refused(tmp_path: Path, returned: object, problem: str) -> None:
    double = SimpleNamespace(
        places=lambda more: {**more, "b": more["a"]},
        counts=lambda: {-7: [3], 2: []},
        wrong=lambda: returned,
    )
    team = SmallTeam(tmp_path, PROGRAM, DEPLOYMENT, {"pump": double})
    with pytest.raises(DoubleError) as error:
        team.until("no such line")
    assert problem in str(error.value)


# --- enums ----------------------------------------------------------------------------------------------

ENUM_PROGRAM = """
enum Phase { SEARCH, LIFT, HOME }
const Phase GOAL = Phase.HOME;
Phase later(Phase a, Phase b) { if (a > b) return a; return b; }
class Step {
    public Phase phase;
    public map<Phase, int> tries = new map<Phase, int>();
}
resource Arm {
    init(string[] arg) { while (true) yield(); }
    portal go(Phase to, Phase[] others) emit Phase { return to; }
    portal step(Step step) emit Step { return step; }
    portal wrong() emit Phase { return GOAL; }
}
coordinator Boss {
    init(string[] arg) {
        Arm arm = findArm("arm");
        Phase[] others = {Phase.SEARCH, GOAL};
        Phase got = arm.go(Phase.LIFT, others);
        print("got " + later(got, Phase.LIFT).name());
        Step step = new Step();
        step.tries[Phase.LIFT] = 2;
        step = arm.step(step);
        print("step " + step.phase.name() + " " + i2s(step.tries[Phase.HOME]));
        print("the end");
        arm.wrong();
    }
}
"""
ENUM_DEPLOYMENT = "//Arm:arm@bravo //Boss:boss@alpha"


def test_enum_members_are_names(tmp_path: Path) -> None:
    observed: list[object] = []

    def go(to: str, others: list[str]) -> str:
        observed.extend([to, others])
        return "HOME"

    def step(given: SimpleNamespace) -> object:
        observed.extend([given.phase, given.tries])
        given.fields.update(phase="LIFT", tries={"HOME": 7})
        return given

    double = SimpleNamespace(go=go, step=step, wrong=lambda: "Home")
    team = SmallTeam(tmp_path, ENUM_PROGRAM, ENUM_DEPLOYMENT, {"arm": double})
    with pytest.raises(DoubleError, match=r"returns Phase, but its double has returned str 'Home'"):
        team.until("no such line")
    assert observed == ["LIFT", ["SEARCH", "HOME"], "SEARCH", {"LIFT": 2}]
    assert team.said("got HOME")
    assert team.said("step LIFT 7")


def test_recorded_calls_have_names_of_enum_members(tmp_path: Path) -> None:
    team = SmallTeam(tmp_path, ENUM_PROGRAM, ENUM_DEPLOYMENT)
    team.until("got LIFT")
    assert team.call("go").arguments == ("LIFT", ["SEARCH", "HOME"])
    assert team.call_results("go") == ["LIFT"]
