"""Resources whose portals answer from Python."""

from __future__ import annotations

import itertools
import math
import shutil
import traceback
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import pytest
from small_team import SmallTeam

from lfield.errors import BindingError, DoubleError, LfieldError, ProgramError, Stuck
from lfield.mission.loader import load_mission
from lfield.testing import After, LObject, Throws
from lfield.testing.mission.mission_team import MissionTeam
from lfield.testing.mission.resource_doubles import ResourceDoubles

EXAMPLES = Path(__file__).parents[2] / "examples"
PROGRAM = """
class Place {
    public real x;
    public real[] more;
    public Place next;
    public Place(real at) { x = at; }
}
resource Pump {
    Mavlink fc;
    init(string[] arg) { print("the init of " + arg[0]); fc.release(); while (true) { sleep(1.0); } }
    portal flow(int litres, real seconds) emit int {
        try { fc.release(); sleep(seconds); } catch (Exception e) { return -1; }
        return litres;
    }
    portal flow(int litres) emit int { return litres; }
    portal stop() { fc.release(); }
    portal name(string text) emit string { return text; }
    portal go(Place there, int[][] grid) emit Place { return there; }
    portal split(real[] parts) emit real[] { return parts; }
    portal is(boolean on) emit boolean { return on; }
}
coordinator Boss {
    init(string[] arg) {
        Pump pump = findPump("pump");
        Pump other = findPump("other");
        try {
            //body
        } catch (Exception e) { print("thrown: " + e.message() + " of " + e.source()); }
        print("the end");
    }
}
"""
DEPLOYMENT = "//Pump:pump@bravo //Pump:other@alpha //Boss:boss@alpha"


def team_of(
    folder: Path, body: str, doubles: Mapping[str, object] | None = None, **pump: object
) -> SmallTeam:
    """A team whose pump is doubled by functions, or other resources by objects."""
    chosen = doubles or {"pump": SimpleNamespace(**pump)}
    return SmallTeam(folder, PROGRAM.replace("//body", body), DEPLOYMENT, chosen)


class Pump:
    """A double with state: methods without an underscore are portals."""

    def __init__(self) -> None:
        self.total = 0

    def flow(self, litres: int, seconds: float = 0.0) -> int:
        self._add(litres)
        return self.total

    def _add(self, litres: int) -> None:
        self.total += litres

    @property
    def full(self) -> bool:
        raise AssertionError("nobody asks for it")


def test_a_double_answers_without_init_and_devices(tmp_path: Path) -> None:
    pump = Pump()
    body = 'print("got " + i2s(pump.flow(3, 0.5)) + " " + i2s(pump.flow(4)));'
    team = team_of(tmp_path, body, {"pump": pump})
    team.until("the end")
    assert team.said("got 3 7")
    assert pump.total == 7
    assert team.said("the init of other")
    assert not team.said("the init of pump")
    assert team.mission.bindings.devices["pump"] == {}
    assert team.mission.bindings.devices["other"].keys() == {"fc"}
    first, second = team.calls.record
    assert (first.caller, first.resource, first.portal) == ("boss", "pump", "flow")
    assert (first.arguments, first.result, first.ended) == ((3, 0.5), 3, first.at)
    assert (second.arguments, second.result) == ((4,), 7)


def test_values_are_converted_in_both_directions(tmp_path: Path) -> None:
    seen: list[object] = []

    def go(there: LObject, grid: list[object]) -> LObject:
        seen.extend((there, grid))
        circle = LObject("Place", x=2, more=(1, 2.5), next=None)
        return LObject("Place", x=there.x, more=[], next=LObject("Place", x=1.0, more=None, next=circle))

    body = """
        Place p = pump.go(new Place(0.25), new int[][] {new int[] {1, 2}});
        print("x " + f2s(p.x + p.next.x + p.next.next.x) + " " + f2s(p.next.next.more[1]));
        print(pump.name("a" + pump.name("é")));
        real[] parts = pump.split(new real[] {1.0});
        print("parts " + f2s(parts[1]));
        if (pump.is(false)) { print("it is"); }
        pump.stop();
    """
    team = team_of(
        tmp_path,
        body,
        go=go,
        name=lambda text: f"<{text}>",
        split=lambda parts: [*parts, math.pi],
        stop=lambda: None,
        **{"is": lambda on: not on},
    )
    team.until("the end")
    assert seen == [LObject("Place", x=0.25, more=None, next=None), [[1, 2]]]
    assert team.said("x 3.25 2.5")
    assert team.said("<a<é>>")
    assert team.said(f"parts {math.pi}")
    assert team.said("it is")


def test_aliases_cycles_and_depth_are_preserved(tmp_path: Path) -> None:
    def go(there: LObject, grid: object) -> LObject:
        chain = LObject("Place", x=7.0, more=None, next=None)
        for _ in range(5000):
            chain = LObject("Place", x=0.0, more=None, next=chain)
        return chain if there.x else there

    body = """
        Place ring = new Place(0.0);
        ring.next = ring;
        Place back = pump.go(ring, null);
        if (back.next == back && back != ring) { print("a ring"); }
        Place at = pump.go(new Place(1.0), null);
        int n = 0;
        while (at.next != null) { at = at.next; n = n + 1; }
        print(i2s(n) + " to " + f2s(at.x));
    """
    team = team_of(tmp_path, body, go=go)
    team.until("the end")
    assert team.said("a ring")
    assert team.said("5000 to 7.0")


def test_an_exception_of_a_double_is_thrown_in_l(tmp_path: Path) -> None:
    def flow(litres: int, seconds: float = 0.0) -> int:
        raise Throws("DeviceTimeoutException", "no water")

    body = """
        try { pump.flow(1); } catch (DeviceException e) { print("caught " + e.message()); }
        pump.flow(1, 2.0);
    """
    team = team_of(tmp_path, body, flow=flow)
    team.until("the end")
    assert team.said("caught no water")
    # Nothing of the portal itself is executed, its own catch included.
    assert team.said("thrown: no water of pump")
    assert [call.thrown for call in team.calls.record] == ["DeviceTimeoutException: no water"] * 2


def test_a_double_may_answer_later(tmp_path: Path) -> None:
    answers = {1: After(2.0, 5), 2: After(0.5, Throws("DeviceException", "it leaks"))}
    body = "pump.flow(1); pump.flow(2);"
    team = team_of(tmp_path, body, flow=lambda litres, seconds=0.0: answers[litres])
    team.until("the end")
    first, second = team.calls.record
    assert first.ended is not None
    assert second.ended is not None
    assert first.ended - first.at == pytest.approx(2.0)
    assert second.ended - second.at == pytest.approx(0.5)
    assert (first.result, second.thrown) == (5, "DeviceException: it leaks")


def test_a_double_answers_calls_of_a_together_statement(tmp_path: Path) -> None:
    body = """
        int[] got = new int[3];
        together {
            got[0] = pump.flow(1);
            got[1] = pump.flow(2);
            got[2] = other.flow(3);
        }
        print("got " + i2s(got[0]) + i2s(got[1]) + i2s(got[2]));
    """
    doubles = {
        "pump": SimpleNamespace(flow=lambda litres, seconds=0.0: After(3.0 - litres, 10 * litres)),
        "other": Pump(),
    }
    team = team_of(tmp_path, body, doubles)
    team.until("the end")
    assert team.said("got 10203")
    slow, fast = (call for call in team.calls.record if call.resource == "pump")
    assert slow.ended is not None
    assert fast.ended is not None
    assert fast.ended < slow.ended


def test_an_exception_of_a_double_is_thrown_at_the_end_of_a_together(tmp_path: Path) -> None:
    def flow(litres: int, seconds: float = 0.0) -> object:
        if litres == 1:
            raise Throws("DeviceException", "no water")
        return After(2.0, 3)

    doubles = {"pump": SimpleNamespace(flow=flow), "other": SimpleNamespace(flow=flow)}
    team = team_of(tmp_path, "together { pump.flow(1); other.flow(2); pump.flow(2); }", doubles)
    team.until("the end")
    assert team.said("thrown: no water of pump")
    assert [(call.result, call.thrown) for call in team.calls.record if call.resource == "pump"] == [
        (None, "DeviceException: no water"),
        (3, ""),
    ]


def test_a_call_that_waits_for_a_double_can_be_cancelled(tmp_path: Path) -> None:
    doubles = {
        name: SimpleNamespace(flow=lambda litres, seconds=0.0: After(20.0, 3)) for name in ("pump", "other")
    }
    body = "within (1.0) { together { pump.flow(1); other.flow(2); pump.flow(2, 1.0); } }"
    team = team_of(tmp_path, body, doubles)
    team.until("the end")
    assert team.now < 5.0
    thrown = [call.thrown.partition(":")[0] for call in team.calls.record]
    assert thrown == ["CancelledException"] * 3
    # The late answer is dropped.
    team.run(30.0)
    assert team.call_results("flow") == [None, None, None]
    assert team.lives.keys() == {"alpha", "bravo"}


def test_an_answer_too_large_for_its_resource_is_a_limit_exception(tmp_path: Path) -> None:
    body = 'real[] parts = pump.split(null); print("got " + i2s(parts.length()));'
    team = team_of(tmp_path, body, split=lambda parts: [0.5] * 200_000)
    team.until("the end")
    assert team.said("thrown: the heap of pump is over its limit of 1048576 bytes")
    team = team_of(tmp_path, body, split=lambda parts: [0.5] * 100_000)
    team.until("the end")
    assert team.said("got 100000")


def test_a_late_answer_is_dropped(tmp_path: Path) -> None:
    body = (
        'try { within (1.0) { pump.flow(1); } } catch (TimeLimitException e) { print("late"); } pump.flow(1);'
    )
    answers = [After(5.0, 1), 2]
    team = team_of(tmp_path, body, flow=lambda litres, seconds=0.0: answers.pop(0))
    team.until("the end")
    assert team.said("late")
    team.run(10.0)
    assert team.call_results("flow") == [None, 2]
    assert team.lives.keys() == {"alpha", "bravo"}


def test_a_host_that_dies_loses_the_answer(tmp_path: Path) -> None:
    answers = [After(5.0, 1), 2]
    body = 'try { pump.flow(1); } catch (RestartException e) { print("again " + i2s(pump.flow(1))); }'
    team = team_of(tmp_path, body, flow=lambda litres, seconds=0.0: answers.pop(0))
    team.run(2.0)
    team.crash("bravo")
    team.boot("bravo")
    team.until("the end")
    assert team.said("again 2")
    team.run(10.0)
    assert team.call_results("flow") == [None, 2]


@pytest.mark.parametrize("body", ["pump.flow(1); pump.flow(2);", "together { pump.flow(1); } pump.flow(2);"])
def test_a_double_that_ends_its_own_host_has_not_answered(tmp_path: Path, body: str) -> None:
    asked: list[int] = []

    def flow(litres: int, seconds: float = 0.0) -> int:
        asked.append(litres)
        team.crash("bravo")
        return litres

    team = team_of(tmp_path, body, flow=flow)
    team.run(3.0)
    assert asked == [1]
    assert team.call("flow").ended is None
    team.boot("bravo")
    team.until("the end")
    assert team.said("thrown: bravo restarted")
    assert asked == [1]


def test_the_same_seed_is_the_same_run(tmp_path: Path) -> None:
    digests = set()
    for _ in range(2):
        team = team_of(
            tmp_path, "pump.flow(1); other.stop();", flow=lambda litres, seconds=0.0: After(1.0, 2)
        )
        team.until("the end")
        digests.add(team.digest)
    assert len(digests) == 1


# --- a double in place of devices ----------------------------------------------------------------

NO_DRIVER = """
resource Welder {
    Xyzzy torch;
    real heat = torch.heat();
    init(string[] arg) { torch.release(); }
    portal synchronized weld(real seconds) emit boolean { torch.arc(seconds); return hot(torch); }
    portal cool() { torch.arc(0.0); }
    private boolean hot(Xyzzy one) { return one.heat() > 0.0; }
}
resource Pump {
    Mavlink fc;
    init(string[] arg) { }
    portal fill() { fc.release(); }
}
coordinator Boss {
    init(string[] arg) {
        if (findWelder("welder").weld(1.0)) print("welded");
        findPump("pump").fill();
        print("the end");
    }
}
"""
ITS_DEVICES = """
agents:
  welder:
    heap: 64 KiB
    devices: {torch: {driver: xyzzy, endpoint: "serial:/dev/ttyUSB9"}}
"""


class Welder:
    def weld(self, seconds: float) -> bool:
        return True


def test_the_driver_of_a_doubled_resource_need_not_be_installed(tmp_path: Path) -> None:
    hosts = "//Welder:welder@alpha //Pump:pump@alpha //Boss:boss@bravo"
    (tmp_path / "mission.devices.yaml").write_text(ITS_DEVICES)
    team = SmallTeam(tmp_path, NO_DRIVER, hosts, {"welder": Welder()})
    team.until("the end")
    assert team.said("welded")
    assert team.mission.bindings.limits("welder").heap == 64 << 10
    assert team.mission.bindings.devices.get("welder", {}) == {}
    assert team.mission.bindings.devices["pump"].keys() == {"fc"}
    # The driver of a running resource must be.
    with pytest.raises(ProgramError) as caught:
        SmallTeam(tmp_path, NO_DRIVER, f"{hosts} //Welder:other@alpha", {"welder": Welder()})
    assert "Xyzzy" in caught.value.diagnostics[0].render()


def test_a_doubled_resource_needs_no_binding(tmp_path: Path) -> None:
    (tmp_path / "mission.L").write_text(PROGRAM)
    (tmp_path / "mission.dL").write_text("\n".join([*DEPLOYMENT.split(), ""]))
    with pytest.raises(BindingError) as caught:
        load_mission(tmp_path / "mission.dL", doubled={"pump"})
    assert [problem.partition(" (")[0] for problem in caught.value.problems] == ["other.fc"]
    mission = load_mission(tmp_path / "mission.dL", doubled={"pump", "other"})
    assert mission.bindings.all == []


# --- errors --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("returned", "told"),
    [
        ("five", "returns int, but its double has returned str 'five': return a value of that type"),
        (True, "returns int, but its double has returned bool True"),
        (1.0, "returns int, but its double has returned float 1.0"),
        (None, "returns int, but its double has returned NoneType None"),
        (1 << 63, "returns int, but its double has returned int 9223372036854775808"),
        (After(1.0, "five"), "returns int, but its double has returned str 'five'"),
        ("x" * 200, f"has returned str 'xxx{75 * 'x'}…: return"),
    ],
)
def test_a_returned_value_of_another_type_is_reported(tmp_path: Path, returned: object, told: str) -> None:
    team = team_of(tmp_path, "pump.flow(1, 2.0);", flow=lambda litres, seconds=0.0: returned)
    with pytest.raises(DoubleError) as caught:
        team.until("the end")
    assert str(caught.value).startswith("the portal pump.flow(int, real) returns int")
    assert told in str(caught.value)
    assert not team.said("thrown")


@pytest.mark.parametrize(
    ("body", "returned", "told"),
    [
        ("pump.stop();", 1, "returns nothing, but its double has returned int 1"),
        (
            "pump.split(null);",
            [1.0, "x"],
            "returns real[], and in it real, but its double has returned str 'x'",
        ),
        ("pump.split(null);", [True], "has returned bool True"),
        ("pump.split(null);", 1 << 2000, "returns real[], but its double has returned int"),
        ("pump.split(null);", [1 << 2000], "and in it real, but its double has returned int"),
        (
            "pump.go(null, null);",
            LObject("Spot"),
            "returns Place, but its double has returned an object of Spot",
        ),
        (
            "pump.go(null, null);",
            LObject("Place", x=1.0),
            "has returned Place(x=1.0), whose fields are not x, m",
        ),
        ("pump.go(null, null);", {"x": 1.0}, "returns Place, but its double has returned dict {'x': 1.0}"),
    ],
)
def test_a_field_of_another_type_is_reported(tmp_path: Path, body: str, returned: object, told: str) -> None:
    answer = {name: lambda *given: returned for name in ("stop", "split", "go")}
    team = team_of(tmp_path, body, **answer)
    with pytest.raises(DoubleError) as caught:
        team.until("the end")
    assert told in str(caught.value)


def test_a_missing_portal_of_a_double_is_reported_at_its_call(tmp_path: Path) -> None:
    team = team_of(tmp_path, "pump.flow(1); pump.stop();", flow=lambda litres, seconds=0.0: 1)
    with pytest.raises(DoubleError) as caught:
        team.until("the end")
    assert str(caught.value) == (
        "the mission calls pump.stop(), but the double of pump has no method stop: add one"
    )
    assert isinstance(caught.value, LfieldError)


def broken(litres: int, seconds: float = 0.0) -> int:
    assert litres == 0, "a pump of none"
    return {}["nothing"]


@pytest.mark.parametrize(("litres", "kind"), [(1, AssertionError), (0, KeyError)])
def test_an_exception_of_the_double_is_raised_in_the_test(
    tmp_path: Path, litres: int, kind: type[Exception]
) -> None:
    team = team_of(tmp_path, f"pump.flow({litres});", flow=broken)
    with pytest.raises(kind) as caught:
        team.until("the end")
    assert "broken" in [frame.name for frame in traceback.extract_tb(caught.value.__traceback__)]
    team.run(5.0)
    assert not team.said("thrown")
    assert not team.said("the end")


def test_an_agent_that_waits_for_a_double_is_named(tmp_path: Path) -> None:
    (tmp_path / "mission.L").write_text(PROGRAM.replace("//body", "pump.flow(1);"))
    (tmp_path / "mission.dL").write_text("\n".join([*DEPLOYMENT.split(), ""]))
    double = SimpleNamespace(flow=lambda litres, seconds=0.0: After(1e6, 1))
    made = MissionTeam(tmp_path / "mission.dL", doubles={"pump": double})
    with closing(made) as team, pytest.raises(Stuck) as caught:
        team.run(until_done=True, at_most=5.0)
    assert "pump on bravo: its double has not returned yet at Pump.flow (mission.L:" in str(caught.value)


def test_pytest_fail_in_a_double_fails_the_test(tmp_path: Path) -> None:
    team = team_of(tmp_path, "pump.flow(1);", flow=lambda litres, seconds=0.0: pytest.fail("enough"))
    with pytest.raises(pytest.fail.Exception, match="enough"):
        team.until("the end")


@pytest.mark.parametrize(
    ("doubles", "told"),
    [
        (
            {"bump": SimpleNamespace()},
            "there is a double of 'bump', but the deployment has no such resource: did you mean 'pump'?",
        ),
        (
            {"xyzzy": SimpleNamespace()},
            "there is a double of 'xyzzy', but the deployment has no such resource: it has pump and other",
        ),
        (
            {"boss": SimpleNamespace()},
            "'boss' is a coordinator, which has no portals: give doubles to the resources that it calls",
        ),
        (
            {"pump": SimpleNamespace(flwo=lambda: 0)},
            "the double of pump has a method flwo, but Pump has no such portal: did you mean 'flow'?; "
            "start the names of its own methods with an underscore",
        ),
        (
            {"pump": SimpleNamespace(xyzzy=lambda: 0)},
            "the double of pump has a method xyzzy, but Pump has no such portal: its portals are flow, stop, "
            "name, go, split and is; start the names of its own methods with an underscore",
        ),
        (
            {"pump": SimpleNamespace(flow=lambda litres: 0)},
            "the method flow of the double of pump cannot take the 2 arguments of the portal flow(int, "
            "real): give it as many parameters",
        ),
        (
            {"pump": SimpleNamespace(name=lambda: 0)},
            "the method name of the double of pump cannot take the 1 argument of the portal name(string): "
            "give it as many parameters",
        ),
        ({"pump": Pump}, "the double of pump is the class Pump: give an instance, Pump()"),
    ],
)
def test_an_invalid_double_is_refused(tmp_path: Path, doubles: Mapping[str, object], told: str) -> None:
    (tmp_path / "mission.L").write_text(PROGRAM)
    (tmp_path / "mission.dL").write_text("\n".join([*DEPLOYMENT.split(), ""]))
    mission = load_mission(tmp_path / "mission.dL", simulate=True)
    with pytest.raises(DoubleError) as caught:
        ResourceDoubles(mission, doubles)
    assert str(caught.value) == told


def test_an_unknown_l_exception_and_an_invalid_delay_are_refused() -> None:
    with pytest.raises(DoubleError, match=r"'DeviceExeption'.*did you mean 'DeviceException'"):
        Throws("DeviceExeption", "x")
    with pytest.raises(DoubleError, match="use one of Exception, Unreach"):
        Throws("xyzzy")
    for kind, message in ((3, ""), ("DeviceException", 3)):
        with pytest.raises(DoubleError, match="give the name of a built-in exception of L, and a text"):
            Throws(kind, message)  # type: ignore[arg-type]
    for seconds in (-1.0, math.nan, math.inf, "1"):
        with pytest.raises(DoubleError, match="is not a time"):
            After(seconds, 1)  # type: ignore[arg-type]


LOCKED = """
resource Depot {
    init(string[] arg) { }
    portal synchronized take(int amount) emit int { return amount; }
    portal look() emit int { return 0; }
}
coordinator Porter {
    init(string[] arg) {
        Depot depot = findDepot("depot");
        sleep(s2f(arg[3]));
        try { within (s2f(arg[2])) { print(arg[0] + " took " + i2s(depot.take(s2i(arg[1])))); } }
        catch (TimeLimitException e) { print(arg[0] + " is late"); }
        depot.look();
        print(arg[0] + " has looked");
    }
}
"""


class Depot:
    """Records the calls that are inside when another is admitted."""

    def __init__(self, *seconds: float) -> None:
        self._seconds = list(seconds)
        self.taken: list[int] = []
        self.looks = 0

    def take(self, amount: int) -> After:
        self.taken.append(amount)
        return After(self._seconds.pop(0), amount)

    def look(self) -> int:
        self.looks += 1
        return self.looks


def porters(folder: Path, depot: Depot, *patience: float, after: float = 0.0) -> SmallTeam:
    """Coordinators that take as many as their number, with that time limit; the last one starts later."""
    agents = [f"//Porter:p{n}@alpha?{n}&{seconds}&0" for n, seconds in enumerate(patience, 1)]
    agents[-1] = f"{agents[-1][:-1]}{after}"
    return SmallTeam(folder, LOCKED, " ".join(["//Depot:depot@bravo", *agents]), {"depot": depot})


def test_synchronized_portals_of_a_double_run_one_at_a_time(tmp_path: Path) -> None:
    depot = Depot(2.0, 1.0, 0.0)
    team = porters(tmp_path, depot, 60.0, 60.0, 60.0)
    team.run(1.0)
    assert len(depot.taken) == 1
    team.run(1.5)
    assert len(depot.taken) == 2
    assert depot.looks == 1
    team.run(1.0)
    assert sorted(depot.taken) == [1, 2, 3]
    assert depot.looks == 3
    calls = sorted(call.ended or 0.0 for call in team.calls.record if call.portal == "take")
    assert [b - a for a, b in itertools.pairwise(calls)] == pytest.approx([1.0, 0.0], abs=0.01)


def test_a_cancelled_call_admits_the_next_and_an_expired_one_is_skipped(tmp_path: Path) -> None:
    depot = Depot(60.0, 0.5)
    team = porters(tmp_path, depot, 3.0, 1.0, 60.0)
    team.run(2.0)
    assert depot.taken == [1]
    assert team.said("p2 is late")
    team.until("p3 took 3")
    assert team.said("p1 is late")
    assert depot.taken == [1, 3]
    assert 3.0 < team.now < 4.0


def test_a_restarted_host_has_no_call_inside(tmp_path: Path) -> None:
    depot = Depot(60.0, 0.5)
    team = porters(tmp_path, depot, 100.0, 100.0, after=5.0)
    team.run(1.0)
    assert depot.taken == [1]
    team.crash("bravo")
    team.boot("bravo")
    team.until("p2 took 2")


class Climbs:
    """It climbs by returning, and may report its battery."""

    def climb(self, metres: float) -> float:
        return metres

    def descend(self, metres: float) -> float:
        return metres


class Broken:
    """A crane without lifts."""

    def home(self) -> None:
        pass

    def lower(self, metres: float) -> float:
        return metres

    def lift(self, metres: float) -> float:
        raise Throws("DeviceException", "the rope is torn")


@pytest.mark.parametrize("battery", [0.9, 0.2, lambda: 0.9])
def test_live_attributes_are_those_of_the_double(tmp_path: Path, battery: object) -> None:
    """The examples' copter can Lift while its battery lasts."""
    shutil.copytree(EXAMPLES / "02-equivalent-lift", tmp_path, dirs_exist_ok=True)
    sky = Climbs()
    sky.live_attributes = (lambda: {"battery": battery()}) if callable(battery) else {"battery": battery}
    team = SmallTeam(tmp_path, doubles={"sky": sky, "crane": Broken(), "arm": Climbs()})
    team.until("crane could not: the rope is torn")
    team.run(5.0)
    assert team.said("sky shall lift") == (battery != 0.2)


@pytest.mark.parametrize(
    ("told", "words"),
    [
        (
            {"batery": 0.9},
            "provides 'batery', but Copter has no such live attribute .* did you mean 'battery'",
        ),
        ({"battery": "full"}, "provides battery = 'full', which is not a value of type real"),
        ({"battery": math.nan}, "provides battery = nan, which is not a value of type real"),
        (0.9, "the live_attributes of the double of sky are 0.9: give a dict"),
    ],
)
def test_invalid_live_attributes_are_refused(tmp_path: Path, told: object, words: str) -> None:
    shutil.copytree(EXAMPLES / "02-equivalent-lift", tmp_path, dirs_exist_ok=True)
    sky = Climbs()
    sky.live_attributes = told
    with pytest.raises(DoubleError, match=words):
        SmallTeam(tmp_path, doubles={"sky": sky})
    sky.live_attributes = lambda: told
    with pytest.raises(DoubleError, match=words):
        SmallTeam(tmp_path, doubles={"sky": sky}).run(5.0)


def test_a_double_is_offered_as_its_resource(tmp_path: Path) -> None:
    """It has no devices that could fail. The examples' crane can Lift by itself, and is the best."""
    lifted: list[float] = []

    class Crane:
        def home(self) -> None:
            lifted.clear()

        def lower(self, metres: float) -> After:
            return After(1.0, metres)

        def lift(self, metres: float) -> float:
            lifted.append(metres)
            return metres

    shutil.copytree(EXAMPLES / "02-equivalent-lift", tmp_path, dirs_exist_ok=True)
    team = SmallTeam(tmp_path, doubles={"crane": Crane()})
    team.until("and down again by 0.8 m")
    assert team.said("crane shall lift")
    assert lifted == [0.8]
    assert [call.portal for call in team.calls.record] == ["home", "lower", "lift", "lower"]
