"""Random programs of L: a class with linked objects, a resource, and coordinators that call it.

A program is correctly typed and mostly ends; the trial stops the others.
"""

from __future__ import annotations

import random
import re
import zlib
from collections.abc import Iterator
from itertools import count

from engine_fuzzer.calculations import random_calculation
from engine_fuzzer.coordination import FUTURES, RESULTS, random_asker
from engine_fuzzer.expression_generator import ExpressionGenerator
from engine_fuzzer.program_tree import PLAIN, ProgramPiece, written
from engine_fuzzer.statement_generator import StatementGenerator

#: The variables of every method: type, name, and initial value.
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
    *(("map<string, int[]>", "m2", "new map<string, int[]>()"), ("string[]", "z0", "new string[3]")),
    *(("int[]", "v1", "o0.a"), ("real[]", "w0", "new real[3]"), ("Node[]", "q0", "new Node[2]")),
)
_VARIABLES: dict[str, tuple[str, ...]] = {
    kind: tuple(name for of, name, _ in _LOCALS if of == kind) for kind in PLAIN if kind != "Store"
}
#: Additional variables of coordinators: proxies.
_PROXIES = {"Store": ("st", "all[0]")}
#: Pauses of a portal, in which other threads can run and lock its monitor.
_PAUSES = ("sleep(0.25);", "yield();", "sleep(i2f(n) / 4.0);")
#: Parameters of every method: the remaining depth of calls, and some values.
_PARAMETERS = "int d, int n, real x, Node p"

#: The order functions of a unit; some throw.
_ORDERS = {
    "before": "private boolean before(Node v, Node w) { return v.n < w.n; }",
    "key": "private real key(Node v) { return v.r; }",
    "torn": "private boolean torn(Node v, Node w) { return 7 / (v.n - w.n) > v.next.n; }",
    "part": "private int part(Node v) { if (v.n == 3) throw v; return v.a[1] % 5; }",
}
_NODE = """class Node {
public int n; public real r; public boolean b; public string s; public Node next; public int[] a;
public Node(int k) {
n = k; r = i2f(k) / 3.0; a = new int[3]; a[1] = k; if (k > 5) next = new Node(k / 2 - 1); }
public Node link(int k, Node o) { next = o; n = n + k; return this; }
public int dive(int k) { int m = k + 1; return dive(m) - k; }
#
#
}"""
_RESOURCE = """resource Store {
int n; real x; Node p; string s;
#
#
#
#
}"""
_COORDINATOR = """coordinator Walker {
Store st; Store[] all; int n; real x; Node p;
private boolean big(int k) { return k > 3; }
#
#
#
}"""


def _declared(body: list[ProgramPiece]) -> list[ProgramPiece]:
    """The declarations of the variables of a body, including those of their initial values."""
    text = " ".join(piece.text() for piece in body)
    found: list[ProgramPiece] = []
    for kind, name, value in reversed(_LOCALS + RESULTS + FUTURES):
        if re.search(rf"\b{name}\b", text):
            text += f" {value}"
            found.insert(0, ProgramPiece("", [f"{kind} {name} = {value};"]))
    return found


def _orders(bodies: list[ProgramPiece]) -> ProgramPiece:
    """The order functions with which these methods sort arrays."""
    used = "".join(body.text() for body in bodies)
    return ProgramPiece("", [text for name, text in _ORDERS.items() if f".sort({name})" in used])


#: Statements of a method, and their depth: most programs are small, because small programs run faster.
_SIZES = (*((1, 1),) * 4, *((1, 2),) * 2, *((2, 1),) * 2, (2, 2), (3, 2))
#: Statements that leave the engine: in every unit, in coordinators, in resources.
_WAITS = (
    *("yield();|", "print(#);|int", "sleep(0.25);|", "r1 = random();|", "i2 = random(5);|", "r0 = now();|"),
)
_OF_WALKERS = (
    "r1 = lived();|",
    "heartbeatInterval(#);|real",
    "all = findStore();|",
    "for (Store k6 : findStore()) s0 += k6.agent();|",
    # The checker rejects an empty literal (L427); engines look up a computed empty id.
    'st = findStore("" + #);|string',
    # The coordinator `third` is startable.
    *('start("third", 0.5);|', 'stop("third", 0.5);|', 's0 = awaitEnd("third", 0.5);|'),
    *("start(#, 0.25);|string", 'print(b2s(running("third", 0.5)));|'),
)
_OF_STORES = (
    *("write(#);|int", "write(#);|real", "write(#);|string", "write(#);|boolean"),
    *("write(read(0.25));|", "s0 = read(r0 * #);|real"),
)
#: Additional statements of a synchronized method of a resource.
_IN_MONITOR = ("wait until (#) within (0.3);|boolean", "wait until (n > #) within (x);|int", "n = n + 1;|")
#: Portal calls of coordinators, by number of portals.
_ASKED = ("i0 = #.ask(#, #);|Store! int Node", "#.tell(#, #, #);|Store! real string int[]")
#: Expressions of coordinators only, by type.
_KNOWN = {
    "int": ("hops()|",),
    "boolean": ("(# == #)|Store! Store", "(# != #)|Store! Store", "(# == null)|Store!"),
    "string": ("#.agent()|Store!", "#.host()|Store!"),
}
#: Result types of methods.
_KINDS = ("int", "int", "real", "boolean", "string", "Node", "int[]")


#: A second resource, in some programs.
_OTHER = "// deploy: Store:other\n"


class _ProgramGenerator:
    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        self.size, self.depth = rng.choice(_SIZES)
        self.portals = rng.choice((1, 2))
        #: The methods that an expression may call, by unit and result type.
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
        other = ProgramPiece("", [self.rng.choice(("", _OTHER))])
        init, start = self._init("Store"), self._init("Walker")
        loops = [self._loop(number) for number in range(self.rng.choice((0, 0, 1, 2)))]
        return written(
            "",
            "// deploy: Store:store\n#// deploy: Walker:one?1\n// deploy: Walker:two?2\n"
            "// startable: Walker:third?3\n#\n#\n#\n",
            other,
            written("", _NODE, _orders(node), ProgramPiece("", list(node))),
            written(
                "",
                _RESOURCE,
                _orders([init, *store, *portals, *loops]),
                init,
                ProgramPiece("", [*store, *portals]),
                ProgramPiece("", list(loops)),
            ),
            written("", _COORDINATOR, _orders([start, *walker]), start, ProgramPiece("", list(walker))),
        )

    def _all(self, unit: str) -> list[tuple[str, str]]:
        return [(kind, name) for kind, names in self.methods[unit].items() for name in names]

    def _calls(self, unit: str) -> dict[str, tuple[str, ...]]:
        """Forms of calls by type: of methods of the same unit, and of objects."""
        found: dict[str, tuple[str, ...]] = {"int": ("o0.dive(#)|int",), "Node": ("o1.link(#, #)|int Node",)}
        if unit == "Walker":
            for kind, forms in _KNOWN.items():
                found[kind] = (*found.get(kind, ()), *forms)
        for of, target in {"Node": "#.", unit: ""}.items():
            parameter = "Node! " if target else ""
            for kind, name in self._all(of):
                call = f"{target}{name}(d - 1, #, #, #)|{parameter}int real Node"
                found[kind] = (*found.get(kind, ()), *((call,) * 3))
        return found

    def _body(
        self,
        unit: str,
        result: str,
        end: str,
        guarded: bool = False,
        pauses: bool = False,
        locked: bool = False,
    ) -> ProgramPiece:
        """The body of a method: its variables, statements, and end."""
        walks = unit == "Walker"
        waits = _WAITS + {"Walker": _OF_WALKERS, "Store": _OF_STORES}.get(unit, ())
        waits += _IN_MONITOR * 3 if locked and unit == "Store" else ()
        variables = _VARIABLES | _PROXIES if walks else _VARIABLES
        grows = self.rng.random() < 0.5
        expressions = ExpressionGenerator(self.rng, variables, self._calls(unit), grows=grows)
        asks = _ASKED[: self.portals] if walks else ()
        statements = StatementGenerator(self.rng, expressions, variables, result, waits, asks)
        body = statements.block(self.depth, self.size + guarded)
        if walks:
            body += [statements.wait() for _ in range(2)]
        if guarded:
            own = [(kind, f"{name}(d - 1, #, #, #)|int real Node") for kind, name in self._all(unit)]
            calls = [(kind, expressions.form(kind, form, 1)) for kind, form in own]
            body += [written("", f"{variables[kind][0]} = #;", call) for kind, call in calls]
            rounds = self.rng.choice((1, 3, 10) if unit == "Walker" else (1, 2))
            often = f"for (int k8 = 0; k8 < {rounds}; k8 = k8 + 1) {{ # }}"
            body = [written("", often, [self._guarded(piece) for piece in body])]
        if pauses:
            body.insert(self.rng.randint(0, len(body)), ProgramPiece("", [self.rng.choice(_PAUSES)]))
        body += [ProgramPiece("", [end])] if end else []
        return ProgramPiece("", [[*_declared(body), *body]])

    def _guarded(self, piece: ProgramPiece) -> ProgramPiece:
        """Catch the exceptions of each statement: otherwise most programs end early."""
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
            self._body(unit, kind, end, locked="synchronized" in how),
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
        result, end = ("int", "return i1;") if number == 0 else ("", "")
        body = self._body("Store", result, end, pauses=True, locked="synchronized" in how)
        return written("", f"\n{how} {head} {{ int d = 3;\n#\n}}", body)

    def _loop(self, number: int) -> ProgramPiece:
        """A loop of the resource, which may suppress the other one, or be suppressed."""
        rate = self.rng.choice(("at 4", "every 0.2", "at 3 + n", "every 0.5", "every x"))
        when = self.rng.choice((" when (n > 1)", f" when (loop{number}.overruns() < 2 && n > 0)"))
        priority = f" priority {self.rng.choice((-1, 1, 2))}{when}" if self.rng.random() < 0.7 else when
        throws = self.rng.choice(
            ("", 'if (n > 3) throw new DeviceException("f");', f"print(loop{number}.running());")
        )
        body = self._body("Store", "", "n = n + 1;", guarded=self.rng.random() < 0.8, pauses=True)
        return written("", f"\nloop loop{number} {rate}{priority} {{ int d = 3; {throws}\n#\n}}", body)


# --- constants, enums and functions -------------------------------------------------------------------------

#: One of this many programs has these declarations.
_TOP_LEVEL_EVERY = 3
_TOP_LEVEL = """
const int MANY = 5 * LEAST - 3;
const int LEAST = -2;
const real CALM = 2.5 / 4;
const string LABEL = "l" + "ö";
const boolean LOUD = !(MANY > 0) && LABEL != "";
const Phase FIRST = Phase.HOME;
enum Phase { SEARCH, LIFT, HOME }

int squared(int n) { return n * n % 1000003; }
real squared(real x) { return x * x; }
int steps(int n) { if (n < 2) return n; return steps(n - 1) + steps(n - 2); }
boolean isEven(int n) { if (n < 0) return isEven(-n % 50); return n == 0 || isOdd(n % 50 - 1); }
boolean isOdd(int n) { return n != 0 && isEven(n % 50 - 1); }
string doubled(string s) { if (s.length() > 40) return LABEL; return s + s; }
boolean larger(int a, int b) { return a > b; }
int[] copied(int[] given) {
int[] made = new int[0];
for (int n : given) made.append(squared(n));
if (made.length() < 20) made.sort(larger);
return made; }
int[] sliced(int[] given) {
if (given.length() < 2) throw new IndexException(LABEL);
return given.slice(0, 2); }
Phase following(Phase p) { if (p == Phase.HOME) return Phase.SEARCH; return Phase.values()[p.ordinal() + 1]; }
Phase ranked(int n) {
Phase p = FIRST;
for (int i = 0; i < abs(n % 4); i += 1) p = following(p);
return p; }
int counted(int[] given) {
map<Phase, int> found = new map<Phase, int>();
for (int n : given) { Phase p = ranked(n); if (!found.contains(p)) found[p] = 0; found[p] += 1; }
int sum = 0;
for (Phase p : found) sum = sum * 7 + found[p] + p.ordinal();
return sum; }
int attempted(string s) {
try { return Phase.of(s).ordinal(); }
catch (ConversionException e) { return s.length(); } finally { s = ""; } }
"""
#: The names of these declarations; a name may have several.
_NAMED = {
    declared: re.findall(r"(\w+)(?: =| \{|\()", declared)[0]
    for declared in re.split(r"\n+(?=const |enum |\w[\w\[\]]* \w+\()", _TOP_LEVEL.strip())
}
#: The new form of an expression by type; `#` is the old expression.
_TOP_LEVEL_FORMS = {
    "int": (
        *("squared(#)", "steps(# % 12)", "(# + MANY)", "ranked(#).ordinal()", "attempted(i2s(#))"),
        *("counted(new int[] {#, MANY, 1, 4})", "copied(new int[] {#, LEAST})[1]", "(# * LEAST)"),
    ),
    "real": ("squared(#)", "(# * CALM)", "i2f(squared(f2i(#)))"),
    "boolean": (
        "(isEven(MANY) == #)",
        "(# || ranked(MANY) > FIRST)",
        "(LOUD && #)",
        "(# != (FIRST == Phase.LIFT))",
    ),
    "string": ("doubled(#)", "(# + LABEL)", "(ranked(#.length()).name() + #)", "(FIRST.name() + #)"),
    "int[]": ("copied(#)", "sliced(#)"),
}


def _with_top_level(program: ProgramPiece) -> ProgramPiece:
    """The program; one of several also gets constants, enums and functions in some expressions.

    The text of the program selects them, so that the random generator draws the same programs as before.
    """
    text = program.text()
    chance = zlib.crc32(text.encode("utf-8"))
    if chance % _TOP_LEVEL_EVERY:
        return program
    rng = random.Random(chance)
    places = [piece for piece in _values(program) if piece.kind in _TOP_LEVEL_FORMS]
    for piece in rng.sample(places, min(len(places), rng.randint(1, 12))):
        form = rng.choice(_TOP_LEVEL_FORMS[piece.kind])
        piece.parts = written(
            piece.kind, form, *([ProgramPiece(piece.kind, piece.parts)] * form.count("#"))
        ).parts
    return written("", "##", program, ProgramPiece("", [_declarations(program.text())]))


def _declarations(text: str) -> str:
    """The declarations of _TOP_LEVEL that a text uses, directly or indirectly."""
    names: set[str] = set()
    while used := {name for name in {*_NAMED.values()} - names if re.search(rf"\b{name}\b", text)}:
        names |= used
        text = "\n".join(declared for declared, name in _NAMED.items() if name in used)
    return "".join(f"\n{declared}\n" for declared, name in _NAMED.items() if name in names)


def _values(program: ProgramPiece) -> Iterator[ProgramPiece]:
    """The expressions that are only read."""
    for piece in program.pieces():
        for at, part in enumerate(piece.parts):
            following = piece.parts[at + 1] if at + 1 < len(piece.parts) else ""
            before = following.lstrip() if isinstance(following, str) else ""
            is_read = before[:1] not in (".", "[", "=") or before[:2] == "=="
            for one in part if isinstance(part, list) else [part]:
                if isinstance(one, ProgramPiece) and one.kind and is_read:
                    yield one


# --- queries with parameters --------------------------------------------------------------------------------

#: One of this many programs has a coordinator with queries.
_QUERIES_EVERY = 5


def _with_queries(program: ProgramPiece) -> ProgramPiece:
    """The program; one of several gets a coordinator with queries, selected like those with functions."""
    text = program.text()
    chance = zlib.crc32(text.encode("utf-8"))
    if chance % _QUERIES_EVERY or "// deploy: Store:store" not in text:
        return program
    return written("", "##", program, ProgramPiece("", [random_asker(random.Random(chance))]))


def random_program(rng: random.Random) -> ProgramPiece:
    """Draw a program; `ProgramPiece.text` gives its L text."""
    drawn = random_calculation(rng) if rng.random() < 0.4 else _ProgramGenerator(rng).program()
    return _with_queries(_with_top_level(drawn))
