"""Reports of invalid doubles, and of invalid results of doubles."""

from __future__ import annotations

import math
import traceback
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import pytest
from double_teams import DEPLOYMENT, PROGRAM, Pump, team_of

from lfield.errors import DoubleError, LfieldError, Stuck
from lfield.mission.loader import load_mission
from lfield.testing import After, LObject, Throws
from lfield.testing.mission.mission_team import MissionTeam
from lfield.testing.mission.resource_doubles import ResourceDoubles


@pytest.mark.parametrize(
    ("returned", "message"),
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
def test_a_returned_value_of_another_type_is_reported(tmp_path: Path, returned: object, message: str) -> None:
    team = team_of(tmp_path, "pump.flow(1, 2.0);", flow=lambda litres, seconds=0.0: returned)
    with pytest.raises(DoubleError) as error:
        team.until("the end")
    assert str(error.value).startswith("the portal pump.flow(int, real) returns int")
    assert message in str(error.value)
    assert not team.said("thrown")


@pytest.mark.parametrize(
    ("body", "returned", "message"),
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
def test_a_field_of_another_type_is_reported(
    tmp_path: Path, body: str, returned: object, message: str
) -> None:
    answer = {name: lambda *given: returned for name in ("stop", "split", "go")}
    team = team_of(tmp_path, body, **answer)
    with pytest.raises(DoubleError) as error:
        team.until("the end")
    assert message in str(error.value)


def test_a_missing_portal_of_a_double_is_reported_at_its_call(tmp_path: Path) -> None:
    team = team_of(tmp_path, "pump.flow(1); pump.stop();", flow=lambda litres, seconds=0.0: 1)
    with pytest.raises(DoubleError) as error:
        team.until("the end")
    assert str(error.value) == (
        "the mission calls pump.stop(), but the double of pump has no method stop: add one"
    )
    assert isinstance(error.value, LfieldError)


def broken(litres: int, seconds: float = 0.0) -> int:
    assert litres == 0, "a pump of none"
    return {}["nothing"]


@pytest.mark.parametrize(("litres", "kind"), [(1, AssertionError), (0, KeyError)])
def test_an_exception_of_the_double_is_raised_in_the_test(
    tmp_path: Path, litres: int, kind: type[Exception]
) -> None:
    team = team_of(tmp_path, f"pump.flow({litres});", flow=broken)
    with pytest.raises(kind) as error:
        team.until("the end")
    assert "broken" in [frame.name for frame in traceback.extract_tb(error.value.__traceback__)]
    team.run(5.0)
    assert not team.said("thrown")
    assert not team.said("the end")


def test_an_agent_that_waits_for_a_double_is_named(tmp_path: Path) -> None:
    (tmp_path / "mission.L").write_text(PROGRAM.replace("//body", "pump.flow(1);"))
    (tmp_path / "mission.dL").write_text("\n".join([*DEPLOYMENT.split(), ""]))
    double = SimpleNamespace(flow=lambda litres, seconds=0.0: After(1e6, 1))
    made = MissionTeam(tmp_path / "mission.dL", doubles={"pump": double})
    with closing(made) as team, pytest.raises(Stuck) as error:
        team.run(until_done=True, at_most=5.0)
    assert "pump on bravo: its double has not returned yet at Pump.flow (mission.L:" in str(error.value)


def test_pytest_fail_in_a_double_fails_the_test(tmp_path: Path) -> None:
    team = team_of(tmp_path, "pump.flow(1);", flow=lambda litres, seconds=0.0: pytest.fail("enough"))
    with pytest.raises(pytest.fail.Exception, match="enough"):
        team.until("the end")


@pytest.mark.parametrize(
    ("doubles", "message"),
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
def test_an_invalid_double_is_refused(tmp_path: Path, doubles: Mapping[str, object], message: str) -> None:
    (tmp_path / "mission.L").write_text(PROGRAM)
    (tmp_path / "mission.dL").write_text("\n".join([*DEPLOYMENT.split(), ""]))
    mission = load_mission(tmp_path / "mission.dL", simulate=True)
    with pytest.raises(DoubleError) as error:
        ResourceDoubles(mission, doubles)
    assert str(error.value) == message


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
