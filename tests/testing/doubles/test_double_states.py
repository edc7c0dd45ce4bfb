"""Synchronized portals and live attributes of doubles."""

from __future__ import annotations

import itertools
import math
import shutil
from pathlib import Path

import pytest
from small_team import SmallTeam

from lfield.errors import DoubleError
from lfield.testing import After, Throws

EXAMPLES = Path(__file__).parents[3] / "examples"


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
    """Coordinators that take their number of items with a time limit; the last one starts later."""
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
    """A double that completes a climb immediately, and may report its battery."""

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


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("message", "words"),
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
def test_invalid_live_attributes_are_refused(tmp_path: Path, message: object, words: str) -> None:
    shutil.copytree(EXAMPLES / "02-equivalent-lift", tmp_path, dirs_exist_ok=True)
    sky = Climbs()
    sky.live_attributes = message
    with pytest.raises(DoubleError, match=words):
        SmallTeam(tmp_path, doubles={"sky": sky})
    sky.live_attributes = lambda: message
    with pytest.raises(DoubleError, match=words):
        SmallTeam(tmp_path, doubles={"sky": sky}).run(5.0)


def test_a_double_is_offered_as_its_resource(tmp_path: Path) -> None:
    """The double has no devices that could fail. The example's crane can Lift by itself, and ranks first."""
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
