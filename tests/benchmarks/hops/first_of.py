"""Costs and savings of the first of N calls: N resources search, each on its own host; one of them succeeds.

The resource in the middle of the team needs a tenth of a second, the others half a second and find nothing.
One after another the coordinator asks until one has found it. With futures it hops to begin each search, to
the one that has found it, and at most twice to each other one to cancel. The network in memory counts hops
and takes next to no time itself.
"""

from __future__ import annotations

from hops.memory_team import figure_of

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


def agents(count: int) -> list[str]:
    """The resources on a host each, and the coordinator on the last one."""
    return [*(f"//Searcher:s{i}@h{i}" for i in range(count)), f"//Team:team@h{count - 1}"]


FIGURE = figure_of(
    "one of N resources on N hosts finds it in 0.1 s, the others need 0.5 s: hops, and how long it takes",
    _PROGRAM,
    WAYS,
    agents,
    {"first of": "at most 3N hops"},
)
