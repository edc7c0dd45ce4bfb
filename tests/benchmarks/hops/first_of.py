"""Costs and savings of the first of N calls: N resources search, each on its own host; one of them succeeds.

The resource in the middle of the team succeeds after 0.1 s, the others fail after 0.5 s. In sequence, the
coordinator calls one resource after another until the first success. With futures it hops once to start
each search, once to the successful resource, and at most twice to each other one to cancel. The in-memory
network counts hops and takes almost no time.
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
    """One resource on each host, and the coordinator on the last host."""
    return [*(f"//Searcher:s{i}@h{i}" for i in range(count)), f"//Team:team@h{count - 1}"]


FIGURE = figure_of(
    "one of N resources on N hosts finds it in 0.1 s, the others need 0.5 s: hops, and how long it takes",
    _PROGRAM,
    WAYS,
    agents,
    {"first of": "at most 3N hops"},
)
