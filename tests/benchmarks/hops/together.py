"""Costs and savings of `together`: N resources, each on its own host, work for a tenth of a second.

The coordinator starts on the last host. In sequence it hops to each resource on another host and waits
there. With `together` it hops once to start each call and once to fetch each result, at most 2N hops, and
all calls take the time of one. The in-memory network counts the hops and takes almost no time.
"""

from __future__ import annotations

from hops.memory_team import figure_of

_PROGRAM = """
resource Worker {
    init(string[] arg) { }

    portal work(int number) emit int {
        sleep(0.1);
        return number * number;
    }

    portal tell(real seconds) { write(f2s(seconds, 3) + "\\n"); }
}

coordinator Team {
    init(string[] arg) {
        Worker[] workers = findWorker();
        int[] squares = new int[workers.length()];
        real began = now();
        WORK
        real took = now() - began;
        int all = 0;
        for (int square : squares) all += square;
        if (all != s2i(arg[1])) throw new Exception("they gave " + i2s(all));
        workers[workers.length() - 1].tell(took);
    }
}
"""
_LOOP = "for (int i = 0; i < workers.length(); i += 1) squares[i] = workers[i].work(i);"
WAYS = {"one after another": _LOOP, "together": f"together {{ {_LOOP} }}"}


def agents(count: int) -> list[str]:
    """One resource on each host, and the coordinator on the last host with the expected sum of squares."""
    squares = sum(i * i for i in range(count))
    return [*(f"//Worker:w{i}@h{i}" for i in range(count)), f"//Team:team@h{count - 1}?{squares}"]


FIGURE = figure_of(
    "N resources on N hosts work for 0.1 s each: hops, counted, and how long it takes",
    _PROGRAM,
    WAYS,
    agents,
    {"together": "at most 2N hops"},
)
