"""Random programs of L: a class with objects that hang together, a resource, and coordinators that call it.

A program has its types right and ends by itself mostly; what does not is stopped by the trial.
"""

from __future__ import annotations

import random
import re
from itertools import count

from engine_fuzzer.calculations import random_calculation
from engine_fuzzer.coordination import RESULTS
from engine_fuzzer.expression_generator import ExpressionGenerator
from engine_fuzzer.program_tree import PLAIN, ProgramPiece, written
from engine_fuzzer.statement_generator import StatementGenerator

#: The variables of every method: type, name, and what it is at first.
_LOCALS = (
    *(
        ("int", "i0", "3"),
        ("int", "i1", "n"),
        ("int", "i2", "0"),
        ("int", "i3", "9223372036854775800"),
        ("real", "r0", "x"),
        ("real", "r1", "1.5"),
    ),
    *(
        ("boolean", "b0", "true"),
        ("boolean", "b1", "n > 2"),
        ("string", "s0", '"ab"'),
        ("string", "s1", '"größe"'),
    ),
    *(("Node", "o0", "new Node(n)"), ("Node", "o1", "new Node(7)"), ("int[]", "v0", "new int[4]")),
    *(("map<string, int>", "m0", "new map<string, int>()"), ("map<int, Node>", "m1", "new map<int, Node>()")),
    *(("int[]", "v1", "o0.a"), ("real[]", "w0", "new real[3]"), ("Node[]", "q0", "new Node[2]")),
)
_VARIABLES: dict[str, tuple[str, ...]] = {
    kind: tuple(name for of, name, _ in _LOCALS if of == kind) for kind in PLAIN if kind != "Store"
}
#: Those of coordinators, who know resources.
_PROXIES = {"Store": ("st", "all[0]")}
#: How a portal lets others in, who want its monitor perhaps.
_PAUSES = ("sleep(0.25);", "yield();", "sleep(i2f(n) / 4.0);")
#: What every method takes: how deep calls may go yet, and some values.
_PARAMETERS = "int d, int n, real x, Node p"

_NODE = """class Node {
public int n; public real r; public boolean b; public string s; public Node next; public int[] a;
public Node(int k) {
n = k; r = i2f(k) / 3.0; a = new int[3]; a[1] = k; if (k > 5) next = new Node(k / 2 - 1); }
public Node link(int k, Node o) { next = o; n = n + k; return this; }
public int dive(int k) { int m = k + 1; return dive(m) - k; }
private boolean before(Node v, Node w) { return v.n < w.n; }
private real key(Node v) { return v.r; }
#
}"""
_RESOURCE = """resource Store {
int n; real x; Node p; string s;
private boolean before(Node v, Node w) { return v.n < w.n; }
private real key(Node v) { return v.r; }
#
#
}"""
_COORDINATOR = """coordinator Walker {
Store st; Store[] all; int n; real x; Node p;
private boolean before(Node v, Node w) { return v.n < w.n; }
private real key(Node v) { return v.r; }
#
#
}"""


def _declared(body: list[ProgramPiece]) -> list[ProgramPiece]:
    """The declarations of what a body uses, and of what those use."""
    text = " ".join(piece.text() for piece in body)
    found: list[ProgramPiece] = []
    for kind, name, value in reversed(_LOCALS + RESULTS):
        if re.search(rf"\b{name}\b", text):
            text += f" {value}"
            found.insert(0, ProgramPiece("", [f"{kind} {name} = {value};"]))
    return found


#: What only the machine can carry out: in every unit, in coordinators, in resources.
_WAITS = (
    *("yield();|", "print(#);|int", "sleep(0.25);|", "r1 = random();|", "i2 = random(5);|", "r0 = now();|"),
)
_OF_WALKERS = (
    "r1 = lived();|",
    "heartbeatInterval(#);|real",
    "all = findStore();|",
    # The checker refuses a literal that is empty (L427); engines look up an empty id like any other.
    'st = findStore("" + #);|string',
)
_OF_STORES = (
    *("write(#);|int", "write(#);|real", "write(#);|string", "write(#);|boolean"),
    *("write(read(0.25));|", "s0 = read(#);|real"),
)
#: What coordinators ask, by how many portals there are.
_ASKED = ("i0 = #.ask(#, #);|Store! int Node", "#.tell(#, #, #);|Store! real string int[]")
#: What only coordinators can say, by type.
_KNOWN = {
    "int": ("hops()|",),
    "boolean": ("(# == #)|Store! Store", "(# != #)|Store! Store", "(# == null)|Store!"),
    "string": ("#.agent()|Store!", "#.host()|Store!"),
}
#: What methods give.
_KINDS = ("int", "int", "real", "boolean", "string", "Node", "int[]")


#: A second resource, in some programs.
_OTHER = "// deploy: Store:other\n"


class _ProgramGenerator:
    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        self.size, self.depth = rng.choice(((1, 1), (1, 1), (1, 2), (2, 1), (2, 2), (3, 2)))
        self.portals = rng.choice((1, 2))
        #: By unit, its methods by the type they give: what an expression may call.
        self.methods = {unit: self._names(unit) for unit in ("Node", "Store", "Walker")}

    def _names(self, unit: str) -> dict[str, tuple[str, ...]]:
        kinds = self.rng.choices(_KINDS, k=self.rng.choice((1, 1, 2) if unit == "Node" else (0, 1, 1)))
        numbers = count()
        found: dict[str, tuple[str, ...]] = {}
        for kind in kinds:
            found[kind] = (*found.get(kind, ()), f"{unit.lower()}{next(numbers)}")
        return found

    def program(self) -> ProgramPiece:
        node = [self._method("Node", kind, name) for kind, name in self._all("Node")]
        store = [self._method("Store", kind, name) for kind, name in self._all("Store")]
        walker = [self._method("Walker", kind, name) for kind, name in self._all("Walker")]
        portals = [self._portal(number) for number in range(self.portals)]
        return written(
            "",
            "// deploy: Store:store\n#// deploy: Walker:one?1\n// deploy: Walker:two?2\n#\n#\n#\n",
            ProgramPiece("", [self.rng.choice(("", _OTHER))]),
            written("", _NODE, ProgramPiece("", list(node))),
            written("", _RESOURCE, self._init("Store"), ProgramPiece("", [*store, *portals])),
            written("", _COORDINATOR, self._init("Walker"), ProgramPiece("", list(walker))),
        )

    def _all(self, unit: str) -> list[tuple[str, str]]:
        return [(kind, name) for kind, names in self.methods[unit].items() for name in names]

    def _calls(self, unit: str) -> dict[str, tuple[str, ...]]:
        """Calls by type, as forms: of the own methods, and of objects."""
        found: dict[str, tuple[str, ...]] = {"int": ("o0.dive(#)|int",), "Node": ("o1.link(#, #)|int Node",)}
        if unit == "Walker":
            for kind, forms in _KNOWN.items():
                found[kind] = (*found.get(kind, ()), *forms)
        for of, target in {"Node": "#.", unit: ""}.items():
            given = "Node! " if target else ""
            for kind, name in self._all(of):
                call = f"{target}{name}(d - 1, #, #, #)|{given}int real Node"
                found[kind] = (*found.get(kind, ()), *((call,) * 3))
        return found

    def _body(
        self, unit: str, result: str, end: str, guarded: bool = False, pauses: bool = False
    ) -> ProgramPiece:
        """A method's own: the variables that it uses, statements, and an end."""
        walks = unit == "Walker"
        waits = _WAITS + {"Walker": _OF_WALKERS, "Store": _OF_STORES}.get(unit, ())
        variables = _VARIABLES | _PROXIES if walks else _VARIABLES
        grows = self.rng.random() < 0.5
        expressions = ExpressionGenerator(self.rng, variables, self._calls(unit), grows=grows)
        asks = _ASKED[: self.portals] if walks else ()
        statements = StatementGenerator(self.rng, expressions, variables, result, waits, asks)
        body = statements.block(self.depth, self.size + guarded)
        if walks:
            body += [statements.wait() for _ in range(2)]
        if guarded:
            rounds = self.rng.choice((1, 3, 10) if unit == "Walker" else (1, 2))
            often = f"for (int k8 = 0; k8 < {rounds}; k8 = k8 + 1) {{ # }}"
            body = [written("", often, [self._guarded(piece) for piece in body])]
        if pauses:
            body.insert(self.rng.randint(0, len(body)), ProgramPiece("", [self.rng.choice(_PAUSES)]))
        body += [ProgramPiece("", [end])] if end else []
        return ProgramPiece("", [[*_declared(body), *body]])

    def _guarded(self, piece: ProgramPiece) -> ProgramPiece:
        """Whatever a statement throws, the next one comes: else most programs would be over soon."""
        if self.rng.random() < 0.1:
            return piece
        return written(
            "", "try { # } catch (Exception e) { # }", [piece], [ProgramPiece("", ["print(e.type());"])]
        )

    def _method(self, unit: str, kind: str, name: str) -> ProgramPiece:
        access = "public" if unit == "Node" else "private"
        how = access if unit == "Walker" else self.rng.choice((access, f"{access} synchronized"))
        end = "" if self.rng.random() < 0.05 else f"return {self.rng.choice(_VARIABLES[kind])};"
        return written(
            "",
            f"\n{how} {kind} {name}({_PARAMETERS}) {{ if (d <= 0) return {PLAIN[kind]};\n#\n}}",
            self._body(unit, kind, end),
        )

    def _init(self, unit: str) -> ProgramPiece:
        found = "all = findStore(); st = all[0];" if unit == "Walker" else ""
        return written(
            "",
            f"init(string[] arg) {{ {found} int d = 4; n = 2; x = 0.25; p = new Node(9);\n#\n}}",
            self._body(unit, "", "", guarded=True),
        )

    def _portal(self, number: int) -> ProgramPiece:
        how = self.rng.choice(("portal", "portal synchronized"))
        head = ("ask(int m, Node o) emit int", "tell(real y, string t, int[] v)")[number]
        body = self._body("Store", *(("int", "return i1;") if number == 0 else ("", "")), pauses=True)
        return written("", f"\n{how} {head} {{ int d = 3;\n#\n}}", body)


def random_program(rng: random.Random) -> ProgramPiece:
    """A program by what the dice say; `ProgramPiece.text` is its L."""
    return random_calculation(rng) if rng.random() < 0.4 else _ProgramGenerator(rng).program()
