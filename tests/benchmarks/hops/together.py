"""What `together` costs and saves: N resources, each on a host of its own, work for a tenth of a second.

The coordinator starts on the last host. One after another it makes a hop to each that is elsewhere and stands
while that works. Together it hops to begin each and to fetch from each, at most 2N, and the work takes as
long as one. The in-memory network counts the hops and takes next to no time itself.
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


def worked(way: str) -> Opener:
    """How many hops it takes in one way, and how many seconds."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        return lambda: _round(processes, WAYS[way])

    return opener


def _round(processes: Processes, work: str) -> Round:
    """The hops and the seconds for every number of resources."""
    found: Round = {}
    for count in SIZES:
        agents = [f"//Worker:w{i}@h{i}" for i in range(count)]
        squares = sum(i * i for i in range(count))
        team = f"//Team:team@h{count - 1}?{squares}"
        program = _PROGRAM.replace("WORK", work)
        sent, written = carry_out(processes.folder(), program, [*agents, team])
        found[f"N = {count}: hops"] = [sent["Transfer"]]
        found[f"N = {count}: seconds"] = [float(written[-1])]
    return found


FIGURE = Figure(
    "N resources on N hosts work for 0.1 s each: hops, counted, and how long it takes",
    {way: worked(way) for way in WAYS},
    base=("one after another",),
    rounds=3,
    units={f"N = {count}: hops": COUNT for count in SIZES},
    sizes={f"N = {count}": count for count in SIZES},
    targets={"together": "at most 2N hops"},
)
