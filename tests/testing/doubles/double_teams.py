"""Teams with doubles for some resources."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace

from small_team import SmallTeam

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
    """A team with functions as the double of its pump, or objects as doubles of other resources."""
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
        raise AssertionError("a property is no portal, so it is not read")
