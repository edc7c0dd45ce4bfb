"""Programs that only calculate: a few expressions on every pair of strange values, each result kept.

What other programs overwrite before anybody looks is seen here, and what happens at the ends of numbers.
"""

from __future__ import annotations

import random

from lfield.testing.fuzz.expressions import Expressions
from lfield.testing.fuzz.tree import Piece, written

_INTS = (
    *("0", "1", "2", "3", "7", "(-1)", "(-2)", "(-7)", "64", "4294967296", "9007199254740993", "3037000500"),
    *("9223372036854775807", "9223372036854775806", "(-9223372036854775807)", "(-9223372036854775807 - 1)"),
)
_REALS = (
    *(
        "0.0",
        "(-0.0)",
        "1.0",
        "(-1.0)",
        "0.5",
        "(-0.5)",
        "2.5",
        "3.0",
        "(-3.0)",
        "1e-320",
        "1e-300",
        "1e16",
        "1e308",
    ),
    *("9223372036854775808.0", "(-9223372036854775808.0)", "(1e308 * 10.0)", "(-1e308 * 10.0)", "0.1"),
    *("(1e308 * 10.0 - 1e308 * 10.0)", "4503599627370495.5", "0.49999999999999994", "710.0", "(-746.0)"),
)
_STRINGS = (
    '""',
    '"a"',
    '"ab"',
    '"b"',
    '"größe"',
    '"-12"',
    '"1.5e3"',
    '" 7 "',
    "null",
    '"9223372036854775808"',
)
#: How many values of each type are paired.
_VALUES = 6
_TYPES = ("int", "real", "boolean", "string")
#: The values of a pair by type, and objects that are there, or not.
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


def random_calculation(dice: random.Random) -> Piece:
    """A program by what the dice say."""
    expressions = Expressions(dice, _PAIR, {})
    kinds = [dice.choice(_TYPES) for _ in range(dice.choice((6, 12, 20)))]
    forms = [_kept(expressions, kind, number, len(kinds)) for number, kind in enumerate(kinds)]
    text = _PROGRAM.format(room=_VALUES * _VALUES * len(kinds), values=_VALUES)
    return written("", text, Piece("", [_given(dice)]), Piece("", [forms]))


def _given(dice: random.Random) -> list[Piece]:
    values = {"v": _INTS, "w": _REALS, "texts": _STRINGS}
    return [
        Piece("", [f"{name}[{at}] = {value};"])
        for name, known in values.items()
        for at, value in enumerate(dice.sample(known, _VALUES))
    ]


def _kept(expressions: Expressions, kind: str, number: int, of: int) -> Piece:
    """One result for each pair, or one more that has failed."""
    drawn = expressions.draw(kind, expressions.dice.choice((1, 1, 2)))
    failed = f"failed = failed % 1000000 * 3 + {number};"
    form = f"try {{ {kind}s[at * {of} + {number}] = #; }} catch (Exception e) {{ {failed} }}"
    return written("", form, drawn)
