"""Random expressions of L by type: calculations, comparisons, reads and allocations."""

from __future__ import annotations

import random

from engine_fuzzer.program_tree import ProgramPiece, written
from engine_fuzzer.value_literals import literal

#: The forms of expressions by type: each `#` is a part, with its types after the last `|`. A part with `!` is
#: not the word null, a part with `*` is a variable.
FORMS: dict[str, tuple[str, ...]] = {
    "int": (
        *("(# + #)|int int", "(# - #)|int int", "(# * #)|int int", "(# / #)|int int", "(# % #)|int int"),
        *(
            "(-#)|int",
            "#.n|Node!",
            "#.next.n|Node!",
            "#[#]|int[]! int",
            "#[0]|int[]!",
            "#[1]|int[]!",
            "#.length()|int[]!",
            "#.length()|string!",
        ),
        *("#.indexOf(#)|string! string", "#.indexOf(#.substring(1, 2))|string! string!"),
        *(
            "(# + #).indexOf(#)|string string string",
            "f2i(#)|real",
            "s2i(#)|string",
            "s2i(i2s(#))|int",
            "abs(#)|int",
        ),
        *("min(#, #)|int int", "max(#, #)|int int", "#.length()|Node[]!", "(# % 7)|int", "(# + 1)|int"),
    ),
    "real": (
        *("(# + #)|real real", "(# - #)|real real", "(# * #)|real real", "(# / #)|real real"),
        *(
            "(# % #)|real real",
            "(-#)|real",
            "i2f(#)|int",
            "#.r|Node!",
            "#[#]|real[]! int",
            "#[0]|real[]!",
            "(# * #)|real int",
        ),
        *("sqrt(#)|real", "sin(#)|real", "cos(#)|real", "tan(#)|real", "asin(#)|real", "acos(#)|real"),
        *("atan2(#, #)|real real", "exp(#)|real", "log(#)|real", "pow(#, #)|real real", "floor(#)|real"),
        *("ceil(#)|real", "round(#)|real", "abs(#)|real", "min(#, #)|real real", "max(#, #)|real real"),
        *("s2f(#)|string", "s2f(f2s(#))|real"),
    ),
    "boolean": (
        *("(# < #)|int int", "(# <= #)|int int", "(# > #)|int int", "(# >= #)|int int", "(# == #)|int int"),
        *(
            "(# != #)|int int",
            "(# < #)|real real",
            "(# <= #)|real real",
            "(# > #)|real real",
            "(# >= #)|real real",
        ),
        *("(# == #)|real real", "(# != #)|real real", "(# == #)|string string", "(# != #)|string string"),
        *(
            "(# < #)|string string",
            "(# <= #)|string string",
            "(# > #)|string string",
            "(# >= #)|string string",
        ),
        *(
            "(# == #)|Node! Node",
            "(# != #)|Node! Node",
            "(# == null)|Node!",
            "(# != null)|int[]!",
            "(# == null)|string!",
        ),
        *("(!#)|boolean", "(# && #)|boolean boolean", "(# || #)|boolean boolean", "(# == #)|boolean boolean"),
        *(
            "(# != #)|boolean boolean",
            "#.b|Node!",
            "(# || #)|boolean* boolean*",
            "(# && #)|boolean* boolean*",
        ),
    ),
    "string": (
        *("(# + #)|string string", "#.substring(#, #)|string! int int", "i2s(#)|int", "f2s(#)|real"),
        *(
            "#.substring(1, 2)|string!",
            "#.substring(2, 3)|string!",
            "#.substring(1, #.length())|string! string!",
        ),
        *("#.substring(abs(# % 4), 4)|string! int", "(# + #).substring(2, 5)|string string"),
        *("f2s(#, #)|real int", "b2s(#)|boolean", "#.s|Node!"),
    ),
    "Node": ("(new Node(#))|int", "#.next|Node!", "#[#]|Node[]! int", "#[1]|Node[]!"),
    "int[]": ("(new int[#])|int", "#.a|Node!", "(new int[3])|", "(new int[] {#, #})|int int"),
    "real[]": ("(new real[#])|int", "(new real[4])|", "(new real[] {#, 0.5, #})|real real"),
    "Node[]": ("(new Node[#])|int", "(new Node[2])|", "(new Node[] {#, null, #})|Node Node"),
    "string[]": ("(new string[2])|", "(new string[] {#, #})|string string"),
    "Store": ("all[#]|int", 'findStore("store")|'),
}

#: Additional forms in half of the methods: changes of array lengths, and the library in L.
GROWTH_FORMS: dict[str, tuple[str, ...]] = {
    "int": (
        *("#.pop()|int[]*", "#.remove(#)|int[]* int", "#.remove(0)|int[]*", "#.indexOf(#)|int[]! int"),
        *("m0[#]|string", "m0.length()|", "m0.remove(#)|string", "m1.length()|", "m1.keys()[#]|int"),
    ),
    "real": ("#.pop()|real[]*", "#.remove(#)|real[]* int"),
    "boolean": (
        *("#.contains(#)|int[]! int", "#.contains(#)|Node[]! Node", "#.contains(#)|real[]! real"),
        *("m0.contains(#)|string", "m1.contains(#)|int", "#.contains(#)|string[]! string"),
    ),
    "string": ("#[#]|string[]! int", "#[0]|string[]!", "#.pop()|string[]*", "#.remove(#)|string[]* int"),
    "Node": ("#.pop()|Node[]*", "#.remove(0)|Node[]*", "m1[#]|int", "m1.remove(#)|int"),
    "int[]": (
        *("#.slice(#, #)|int[]! int int", "#.slice(0, 2)|int[]!", "(new int[0])|"),
        *("m2[#]|string", "m2.remove(#)|string"),
    ),
    "real[]": ("#.slice(1, 3)|real[]!",),
    "Node[]": ("#.slice(0, #)|Node[]! int",),
    "string[]": ("#.slice(1, #)|string[]! int", "m0.keys()|", "m2.keys()|"),
}

_REFERENCES = ("Node", "int[]", "real[]", "Node[]", "string[]", "Store", "string")


class ExpressionGenerator:
    """Draws expressions with the random generator from the available variables and calls."""

    def __init__(
        self,
        rng: random.Random,
        variables: dict[str, tuple[str, ...]],
        calls: dict[str, tuple[str, ...]],
        *,
        grows: bool = False,
    ) -> None:
        self.rng, self._variables = rng, variables
        #: The forms of valid calls by type.
        self.calls = calls
        self._depth = rng.choice((1, 2, 2, 3))
        #: True if arrays grow and shrink, and maps are used.
        self.grows = grows
        #: Variables of loops, which are read-only.
        self.counters: list[str] = []

    def draw(self, kind: str, depth: int = -1) -> ProgramPiece:
        """Draw an expression with a maximum depth; the default depth is random."""
        depth = self._depth if depth < 0 else depth
        chance = self.rng.random()
        if depth <= 0 or chance < 0.35:
            return self._leaf(kind)
        if chance < 0.42 and kind in self.calls:
            return self.form(kind, self.rng.choice(self.calls[kind]), depth - 1)
        growth = GROWTH_FORMS.get(kind, ()) if self.grows else ()
        return self.form(kind, self.rng.choice(FORMS[kind] + growth), depth - 1)

    def form(self, kind: str, row: str, depth: int) -> ProgramPiece:
        """Draw the parts of a form."""
        form, _, kinds = row.rpartition("|")
        return written(kind, form, *(self._part(k, depth) for k in kinds.split()))

    def _part(self, kind: str, depth: int) -> ProgramPiece:
        """Draw a part. Dereferenced parts are mostly variables, because null ends a statement early."""
        plain = kind.rstrip("!*")
        if kind.endswith("*") or (plain in _REFERENCES and self.rng.random() < 0.75):
            return self._variable(plain)
        drawn = self.draw(plain, depth)
        return self._variable(plain) if kind.endswith("!") and drawn.text() == "null" else drawn

    def _leaf(self, kind: str) -> ProgramPiece:
        if self.rng.random() < 0.7:
            return self._variable(kind)
        return ProgramPiece(kind, [literal(self.rng, kind)])

    def _variable(self, kind: str) -> ProgramPiece:
        names = self._variables[kind] + (tuple(self.counters) if kind == "int" else ())
        return ProgramPiece(kind, [self.rng.choice(names)])
