"""What the first of several costs and saves: N resources, each on a host of its own; one of them finds it.

The resource in the middle of the team needs a tenth of a second, the others half a second and find nothing.
One after another the coordinator asks until one has found it. With futures it hops to begin each search, to
the one that has found it, and at most twice to each other one to cancel. The network in memory counts hops
and takes next to no time itself.
"""

from __future__ import annotations

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.number_text import COUNT
from harness.paced import Round
from harness.processes import Processes
from harness.samples import Contender
from hops.memory_team import carry_out

SIZES = (2, 4, 8, 16)

_PROGRAM = """
resource Searcher {
    init(string[] arg) { }

    portal search(boolean here) emit boolean {
        if (here) sleep(0.1);
        else sleep(0.5);
        return here;
    }

    portal tell(real seconds) { write(f2s(seconds, 3) + "\\n"); }
}

coordinator Team {
    private boolean found(boolean here) { return here; }

    init(string[] arg) {
        Searcher[] searchers = findSearcher();
        int place = searchers.length() / 2;
        int first = -1;
        real began = now();
        WORK
        real took = now() - began;
        if (first != place) throw new Exception("found at " + i2s(first));
        searchers[searchers.length() - 1].tell(took);
    }
}
"""
WAYS = {
    "one after another": "for (first = 0; !searchers[first].search(first == place); first += 1) { }",
    "first of": """
        future<boolean>[] searches = {};
        for (Searcher one : searchers)
            searches.append(async one.search(searches.length() == place));
        first = searches.race(found);""",
}


def searched(way: str) -> Opener:
    """How many hops it takes in one way, and how many seconds."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        return lambda: _round(processes, WAYS[way])

    return opener


def _round(processes: Processes, work: str) -> Round:
    """The hops and the seconds for every number of resources."""
    found: Round = {}
    for count in SIZES:
        agents = [f"//Searcher:s{i}@h{i}" for i in range(count)]
        team = f"//Team:team@h{count - 1}"
        sent, written = carry_out(processes.folder(), _PROGRAM.replace("WORK", work), [*agents, team])
        found[f"N = {count}: hops"] = [sent["Transfer"]]
        found[f"N = {count}: seconds"] = [float(written[-1])]
    return found


FIGURE = Figure(
    "one of N resources on N hosts finds it in 0.1 s, the others need 0.5 s: hops, and how long it takes",
    {way: searched(way) for way in WAYS},
    base=("one after another",),
    rounds=3,
    units={f"N = {count}: hops": COUNT for count in SIZES},
    sizes={f"N = {count}": count for count in SIZES},
    targets={"first of": "at most 3N hops"},
)
