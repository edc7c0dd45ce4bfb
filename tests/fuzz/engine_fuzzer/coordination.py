"""Random statements of coordinators: time limits, reservations, concurrent calls.

One host has no hops, restarts and expired leases; all other effects of these statements occur.
"""

from __future__ import annotations

import random
from collections.abc import Callable

from engine_fuzzer.expression_generator import ExpressionGenerator
from engine_fuzzer.program_tree import ProgramPiece, written

#: The names of these statements.
COORDINATED = ("within", "reserve", "together", "futures")
#: Locals that are only targets of calls in a together.
RESULTS = (("int", "t0", "0"), ("int", "t1", "5"), ("int[]", "u0", "new int[3]"))
#: Locals of futures, and statements with them.
FUTURES = (("future<int>", "f0", "null"), ("future<int>[]", "g0", "new future<int>[3]"))
_BEGIN = (
    "f0 = async #.ask(#, #);|Store! int Node",
    "for (int m = 0; m < 3; m = m + 1) g0[m] = async #.ask(m, #);|Store! Node",
    "for (int m = 0; m < 3; m = m + 1) if (#) g0[m] = async #.ask(m, #);|boolean Store! Node",
    "g0[#] = async #.ask(#, #);|int Store! int Node",
)
_FETCH = (
    *("i0 = f0.await();|", "i1 = f0.await(0.3);|", "b0 = f0.done();|", "f0.cancel();|", "f0 = null;|"),
    *("i0 = g0.race();|", "i1 = g0.race(big);|", "i2 = g0.next();|", "i2 = g0[#].await();|int"),
    *("g0[1] = f0;|", "g0[#] = null;|int"),
    "for (int m = g0.next(); m >= 0; m = g0.next()) { i0 = i0 + m; g0[m] = null; }|",
)
#: Draws statements, with their maximum depth and number.
Block = Callable[[int, int], list[ProgramPiece]]


class Coordination:
    """Draws such statements; `block` draws their inner statements, `wait` one that leaves the engine."""

    def __init__(
        self, expressions: ExpressionGenerator, portals: int, block: Block, wait: Callable[[], ProgramPiece]
    ) -> None:
        self._expressions, self._rng, self._portals = expressions, expressions.rng, portals
        self._block, self._wait = block, wait
        self._together = False

    @property
    def choices(self) -> tuple[str, ...]:
        """The statements of COORDINATED that are valid here."""
        return ("within",) if self._together else COORDINATED

    @property
    def calls(self) -> bool:
        """True if any statement may call a portal; false inside a together."""
        return not self._together

    def draw(self, which: str, depth: int) -> ProgramPiece:
        """Draw one of COORDINATED."""
        drawers = {
            "within": self._within,
            "reserve": self._reserve,
            "together": self._calls,
            "futures": self._futures,
        }
        return drawers[which](depth)

    def _futures(self, depth: int) -> ProgramPiece:
        """Calls that are started and fetched, raced, cancelled or dropped among other statements."""
        between = self._block(depth - 1, 1) if self._rng.random() < 0.5 else []
        return written("", "{ # }", [*self._some(_BEGIN, 2), *between, *self._some(_FETCH, 3)])

    def _some(self, forms: tuple[str, ...], most: int) -> list[ProgramPiece]:
        chosen = self._rng.choices(forms, k=self._rng.randint(1, most))
        return [self._expressions.form("", form, 1) for form in chosen]

    def _within(self, depth: int) -> ProgramPiece:
        """A body with a time limit, which expires in sleeps only."""
        seconds = self._rng.choice(("0.1", "0.6", "x"))
        return written("", f"within ({seconds}) {{ # }}", [*self._block(depth - 1, 2), self._wait()])

    def _reserve(self, depth: int) -> ProgramPiece:
        """A reservation; the resource may be reserved by another agent, or be null."""
        resource = self._expressions.form("", self._rng.choice(("#|Store", "#|Store!", "all|")), 1)
        return written("", "reserve (#) { # }", resource, [*self._block(depth - 1, 2), self._wait()])

    def _calls(self, depth: int) -> ProgramPiece:
        """Calls with separate targets, among other statements."""
        self._together = True
        body = [self._expressions.form("", form, 1) for form in self._forms()]
        for _ in range(self._rng.choice((0, 0, 1, 2))):
            at = self._rng.randint(0, len(body))
            body[at:at] = self._block(depth - 1, 1)
        self._together = False
        after = ProgramPiece("", [self._rng.choice(("i0 = t0;", "i1 = u0[1];", "i2 = t1 - u0[0];", ""))])
        return written("", "together { # } #", body, after)

    def _forms(self) -> list[str]:
        """Forms of calls; each variable is the target of one call."""
        rounds = self._rng.choice((2, 3, 3, 4))
        loop = f"for (int m = 0; m < {rounds}; m = m + 1)"
        kinds = [
            ("t0 = #.ask(#, #);|Store! int Node",),
            ("t1 = #.ask(#, #);|Store! int Node", "if (#) t1 = #.ask(#, #);|boolean Store! int Node"),
            (
                f"{loop} u0[m] = #.ask(m, #);|Store! Node",
                f"{loop} if (#) u0[{rounds - 1} - m] = #.ask(m, #);|boolean Store! Node",
            ),
            ("#.ask(#, #);|Store! int Node", f"{loop} #.ask(m, #);|Store! Node"),
        ]
        if self._portals > 1:
            kinds.append(
                (
                    "#.tell(#, #, #);|Store! real string int[]",
                    f"{loop} #.tell(#, #, #);|Store! real string int[]",
                )
            )
        chosen = self._rng.sample(kinds, self._rng.randint(1, 3))
        return [self._rng.choice(forms) for forms in chosen]


# --- queries with parameters --------------------------------------------------------------------------------

_ASKER = r"""
// registry: hauling.yaml
// deploy: Mule:m1
// deploy: Mule:m2
// deploy: Asker:asker
enum Colour { red, blue }
class Spot { public real north; public string name; public Spot next; }
resource Mule {
init(string[] arg) { }
portal carry(real x) emit string { sleep(0.1); return "to " + f2s(x); } }
coordinator Asker {
real kg = 3.5;
private void ask(int n, real x, string s, boolean b, real[] at, Spot p, Colour c) {
map<string, int> m = new map<string, int>(); m["m1"] = 3; m["b \"c"] = n;
#
}
init(string[] arg) {
int[] ints = {2, 0, -7, 9223372036854775807, 1}; real[] reals = {2.5, -0.0, 1e-300, 1e308, 40.0};
string[] texts = {"m1", "", null, "red\0n1 x\0", "m2\" || payload > \"0"};
reals[3] *= 10; Spot p = new Spot(); p.north = 0.5; p.name = "m2";
for (int k = 0; k < 5; k += 1) {
ask(ints[k], reals[k], texts[k], k % 2 == 0, reals, p, Colour.values()[k / 3]);
if (k == 3) p.next = p; } } }
"""
_ATOMS = (
    *("payload > $x", "payload * $n >= $x[g]", "agent != $s", "colour == $c", "$b", "!($b && $n > 1)"),
    *("distance($at[0], $at[$n]) < $kg[km]", "north <= $m[$s]", r"payload < $m[\"b \\\"c\"]"),
    *("$p.name == agent", "payload > $p.next.north", "-$x < payload + $kg", "agent == $s"),
)
_ORDERS = (
    "",
    "",
    " order by $x * north desc",
    " order by distance($kg, $at[1]), -payload limit 2",
    " limit 1",
)
_ASKS = (
    'print(findHaul("#").length());',
    'print(explainHaul("#"));',
    'print(teamsHaul("#", n % 3).length());',
    'for (Haul one : findHaul("#")) print(one.agent() + one.haul(x) + f2s(one.score()));',
)


def random_asker(rng: random.Random) -> str:
    """A coordinator with queries to tests/golden/programs/hauling.yaml, and its resources."""
    queries = []
    for _ in range(rng.randint(1, 5)):
        query = rng.choice((" && ", " || ")).join(rng.sample(_ATOMS, rng.randint(1, 3))) + rng.choice(_ORDERS)
        call = rng.choice(_ASKS).replace("#", query)
        queries.append(f"try {{ {call} }} catch (Exception e) {{ print(e.type() + e.message()); }}\n")
    return _ASKER.replace("#", "".join(queries))
