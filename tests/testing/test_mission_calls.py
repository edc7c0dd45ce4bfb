"""The record of the portal calls of a simulated team."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_team import SmallTeam

from lfield.testing import LObject

PROGRAM = """
class Place {
    public real x;
    public real[] more;
    public Place next;
    public Place(real at) { x = at; }
}
resource Post {
    int served;
    init(string[] arg) { sleep(0.1); }
    portal mix(int a, real b, boolean c, string d, string e, int[][] f, Place h) emit Place[] {
        Place[] all = new Place[2];
        all[0] = h;
        return all;
    }
    portal wait(real seconds) emit int { sleep(seconds); served = served + 1; return served; }
    portal fail(string text) { int[] none = new int[1]; none[2] = 1; }
    portal die() { while (true) { sleep(1.0); } }
}
resource Sick {
    init(string[] arg) { sleep(1.0); int[] none = new int[1]; none[3] = 1; }
    portal rest() { sleep(30.0); }
}
coordinator Boss {
    init(string[] arg) {
        Post one = findPost("one");
        Post two = findPost("two");
        //body
        print("the end");
    }
}
"""
DEPLOYMENT = "//Post:one@alpha //Post:two@bravo //Sick:sick@bravo //Boss:boss@alpha"


def team_of(folder: Path, body: str) -> SmallTeam:
    return SmallTeam(folder, PROGRAM.replace("//body", body), DEPLOYMENT)


def test_every_value_of_l_has_a_python_value(tmp_path: Path) -> None:
    team = team_of(
        tmp_path,
        """
        int[][] grid = new int[][] {new int[] {0, 7, 0}, null};
        Place place = new Place(1.5);
        place.more = new real[1];
        place.next = new Place(2.5);
        place.next.next = place;
        two.mix(-3, 0.5, true, "héllo", null, grid, place);
        """,
    )
    team.until("the end")
    call = team.call("mix")
    assert (call.caller, call.resource, call.thrown) == ("boss", "two", "")
    assert call.arguments[:6] == (-3, 0.5, True, "héllo", None, [[0, 7, 0], None])
    assert isinstance(call.arguments[2], bool)
    place = call.arguments[6]
    assert isinstance(place, LObject)
    assert (place.class_name, place.x, place.more) == ("Place", 1.5, [0.0])
    assert place.next.next is place
    assert isinstance(call.result, list)
    assert call.result == [place, None]
    assert call.result[0] is not place
    assert repr(place).startswith("Place(x=1.5, more=[0.0], next=Place(x=2.5, more=None, next=Place(x=1.5,")
    assert "Place(...)" in repr(place)


def test_a_call_is_recorded_at_its_start_and_end(tmp_path: Path) -> None:
    team = team_of(tmp_path, "two.wait(2.0); one.wait(0.0);")
    team.run(1.5)
    call = team.call("wait")
    assert (call.resource, call.ended, call.result) == ("two", None, None)
    team.until("the end")
    first, second = team.calls.record
    assert first is call
    assert first.ended is not None
    assert first.ended - first.at == pytest.approx(2.0, rel=0.02)
    assert (first.result, second.resource, second.arguments) == (1, "one", (0.0,))
    assert second.at >= first.ended
    assert team.now >= second.at


def test_calls_of_a_together_statement_are_recorded(tmp_path: Path) -> None:
    body = """
        int[] got = new int[2];
        together { got[0] = one.wait(1.0); got[1] = two.wait(1.5); }
    """
    team = team_of(tmp_path, body)
    team.until("the end")
    one, two = sorted(team.calls.record, key=lambda call: call.resource)
    assert one.ended is not None
    assert two.ended is not None
    assert two.at < one.ended < two.ended
    assert [one.result, two.result] == [1, 1]
    assert {one.caller, two.caller} == {"boss"}


def test_an_exception_of_a_portal_is_recorded(tmp_path: Path) -> None:
    team = team_of(tmp_path, 'try { two.fail("x"); } catch (IndexException e) { }')
    team.until("the end")
    call = team.call("fail")
    assert call.thrown == "IndexException: index 2 of an array of length 1"
    assert call.result is None
    assert call.ended is not None


def test_a_cancelled_portal_is_recorded_to_its_end(tmp_path: Path) -> None:
    body = """
        try { within (0.5) { together { two.die(); } } } catch (TimeLimitException e) { }
    """
    team = team_of(tmp_path, body)
    team.until("the end")
    call = team.call("die")
    assert call.thrown.startswith("CancelledException: ")
    assert call.ended is not None
    assert call.ended - call.at < 1.0


def test_portals_of_a_dead_resource_end_with_it(tmp_path: Path) -> None:
    body = 'Sick s = findSick("sick"); try { s.rest(); } catch (UnreachableResourceException e) { }'
    team = team_of(tmp_path, body)
    team.until("the end")
    call = team.call("rest")
    died = "sick has died: IndexException: index 3 of an array of length 1"
    assert call.thrown == f"UnreachableResourceException: {died}"
    assert call.ended is not None


def test_a_call_on_a_host_that_went_down_never_ends(tmp_path: Path) -> None:
    team = team_of(tmp_path, "try { two.wait(30.0); } catch (RestartException e) { two.wait(0.0); }")
    team.run(1.5)
    assert team.call("wait").ended is None
    team.crash("bravo")
    team.boot("bravo")
    team.until("the end")
    lost, again = team.calls.record
    assert (lost.ended, lost.result, lost.thrown) == (None, None, "")
    assert again.result == 1


def test_objects_are_compared_by_value_at_any_depth() -> None:
    def chain(length: int, last: float) -> LObject:
        found = LObject("Place", x=last)
        for _ in range(length):
            found = LObject("Place", next=[found])
        return found

    assert chain(5000, 1.0) == chain(5000, 1.0)
    assert chain(5000, 1.0) != chain(5000, 2.0)
    assert LObject("Place", x=1.0) != LObject("Spot", x=1.0)
    assert LObject("Place", x=1.0) != LObject("Place", y=1.0)
    assert LObject("Place", x=[1]) != LObject("Place", x=[1, 2])
    assert len({LObject("Place", x=[1]), LObject("Place", x=[1])}) == 1
    round_one, round_two = LObject("Ring", to=[]), LObject("Ring", to=[])
    round_one.to.append(round_two)
    round_two.to.append(round_one)
    assert round_one == round_two
    assert "Ring(...)" in repr(round_one)
    with pytest.raises(AttributeError, match="create another Ring"):
        round_one.to = None
