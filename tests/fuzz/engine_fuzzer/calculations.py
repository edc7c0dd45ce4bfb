"""Programs with calculations only: a few expressions on every pair of edge values; all results are stored.

They detect wrong results that other programs overwrite before the comparison, and errors at number limits.
"""

from __future__ import annotations

import random
import re

from engine_fuzzer.expression_generator import FORMS, ExpressionGenerator
from engine_fuzzer.program_tree import ProgramPiece, written
from engine_fuzzer.value_literals import edge

#: The types of stored results.
_TYPES = ("int", "real", "boolean", "string")
#: The operations; built-in functions are drawn more often than operators.
_FORMS = [
    (kind, row) for kind in _TYPES for row in FORMS[kind] for _ in range(3 if re.search(r"\w\(", row) else 1)
]
#: Number of paired values of each type, and of results of each pair.
_SIZES = ((6, 16), (8, 9), (12, 4), (16, 2))
#: The values of a pair by type, and objects or null.
_PAIR: dict[str, tuple[str, ...]] = {
    "int": ("a", "b"),
    "real": ("x", "y"),
    "boolean": ("p",),
    "string": ("s", "t"),
    "Node": ("o", "none"),
    "int[]": ("v",),
    "real[]": ("w",),
    "Node[]": ("q",),
}

_PROGRAM = """// deploy: Store:store
// room: enough
class Node {{
public int n; public real r; public boolean b; public string s; public Node next; public int[] a;
public Node(int k) {{ n = k; r = i2f(k); next = this; }} }}
resource Store {{
int[] ints; real[] reals; boolean[] booleans; string[] strings; int failed;
init(string[] arg) {{
ints = new int[{room}]; reals = new real[{room}];
booleans = new boolean[{room}]; strings = new string[{room}];
int[] v = new int[{values}]; real[] w = new real[{values}]; string[] texts = new string[{values}];
Node[] q = new Node[3]; Node o = new Node(3); Node none = null; q[1] = o;
#
for (int i = 0; i < {values}; i = i + 1) {{ for (int j = 0; j < {values}; j = j + 1) {{
int a = v[i]; int b = v[j]; real x = w[i]; real y = w[j]; string s = texts[i]; string t = texts[j];
boolean p = i < j; int at = i * {values} + j;
#
}} }}
}}
}}
"""


def random_calculation(rng: random.Random) -> ProgramPiece:
    """A program drawn from the random generator."""
    expressions = ExpressionGenerator(rng, _PAIR, {})
    values, count = rng.choice(_SIZES)
    forms = [_kept(expressions, *rng.choice(_FORMS), number, count) for number in range(count)]
    text = _PROGRAM.format(room=values * values * count, values=values)
    return written("", text, ProgramPiece("", [_given(rng, values)]), ProgramPiece("", [forms]))


def _given(rng: random.Random, values: int) -> list[ProgramPiece]:
    """The drawn values; both zeros are always present, because functions of two numbers distinguish them."""
    names = {"v": "int", "w": "real", "texts": "string"}
    zeros = {"w[0]": "0.0", "w[1]": "(-0.0)"}
    return [
        ProgramPiece("", [f"{place} = {zeros.get(place) or _value(rng, kind)};"])
        for name, kind in names.items()
        for place in (f"{name}[{at}]" for at in range(values))
    ]


def _value(rng: random.Random, kind: str) -> str:
    return "null" if kind == "string" and rng.random() < 0.08 else edge(rng, kind)


def _kept(expressions: ExpressionGenerator, kind: str, row: str, number: int, of: int) -> ProgramPiece:
    """A statement that stores the result of each pair, or counts a failure."""
    drawn = expressions.form(kind, row, expressions.rng.choice((0, 0, 1)))
    failed = f"failed = failed % 1000000 * 3 + {number};"
    form = f"try {{ {kind}s[at * {of} + {number}] = #; }} catch (Exception e) {{ {failed} }}"
    return written("", form, drawn)
