"""Resources whose portals answer from Python."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import pytest
from double_teams import DEPLOYMENT, PROGRAM, Pump, team_of
from small_team import SmallTeam

from lfield.errors import BindingError, ProgramError
from lfield.mission.loader import load_mission
from lfield.testing import After, LObject, Throws


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
    calls: list[object] = []

    def go(there: LObject, grid: list[object]) -> LObject:
        calls.extend((there, grid))
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
    assert calls == [LObject("Place", x=0.25, more=None, next=None), [[1, 2]]]
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
    # The code of the portal is not executed, including its catch.
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
    assert team.runs.keys() == {"alpha", "bravo"}


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
    assert team.runs.keys() == {"alpha", "bravo"}


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
    requests: list[int] = []

    def flow(litres: int, seconds: float = 0.0) -> int:
        requests.append(litres)
        team.crash("bravo")
        return litres

    team = team_of(tmp_path, body, flow=flow)
    team.run(3.0)
    assert requests == [1]
    assert team.call("flow").ended is None
    team.boot("bravo")
    team.until("the end")
    assert team.said("thrown: bravo restarted")
    assert requests == [1]


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
    # The driver of a running resource must be installed.
    with pytest.raises(ProgramError) as error:
        SmallTeam(tmp_path, NO_DRIVER, f"{hosts} //Welder:other@alpha", {"welder": Welder()})
    assert "Xyzzy" in error.value.diagnostics[0].render()


def test_a_doubled_resource_needs_no_binding(tmp_path: Path) -> None:
    (tmp_path / "mission.L").write_text(PROGRAM)
    (tmp_path / "mission.dL").write_text("\n".join([*DEPLOYMENT.split(), ""]))
    with pytest.raises(BindingError) as error:
        load_mission(tmp_path / "mission.dL", doubled={"pump"})
    assert [problem.partition(" (")[0] for problem in error.value.problems] == ["other.fc"]
    mission = load_mission(tmp_path / "mission.dL", doubled={"pump", "other"})
    assert mission.bindings.all == []
