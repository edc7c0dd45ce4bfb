"""The table of instructions that the engine executes itself, each with its WebAssembly as text.

A line is plain WebAssembly with operands in braces. `{a}` is the local of the destination, `{b}`, `{c}` are
the values of the other operands, `{0}`, `{1}` the pushed ones; `{b_at}` is the address of a reference's
target. `{t}` is the type of the source or target slot of the value. There are more kinds of lines:

    leave CONDITION    if it is true, the reference engine executes the instruction
    null b             throws if a reference is null
    zero CONDITION     throws if the divisor is zero
    over CONDITION     throws if the result does not fit an int
    index {c}          throws if an index is outside the array at $p
    place {c}          the same for the growable array at $p; $p is then the address of the element

So a row has only the common cases; rare ones exist once, in the reference engine. The locals `x`, `y` (i64),
`u` (f64) and `p` (i32) are free for every row.

Instructions that end a basic block are in CONTROL: their text contains the jumps to other blocks
(`MethodLowering._end`). Pushes and pops are operands of their head (GROUPED). Instructions in no table exit.
So do slow cases, such as long strings and arrays: a run of limited instructions must end soon.
"""

from __future__ import annotations

from lfield.vm.memory import layout
from lfield.vm.wasm.growable_rows import GROWABLE_ROWS
from lfield.vm.wasm.lowering.maths_lowering import maths_name

_MEMBER, _HOPS = 8 * layout.PROXY_MEMBER, 8 * layout.W_HOPS
_MINIMUM = -(1 << 63)


def _compare(kind: str, sign: str) -> dict[str, str]:
    names = {
        "eq": "eq",
        "sle": f"le{sign}",
        "sge": f"ge{sign}",
        "sne": "ne",
        "slt": f"lt{sign}",
        "sgt": f"gt{sign}",
    }
    letter = "i" if kind == "i64" else "f"
    return {
        name + letter: f"(local.set {{a}} (i64.extend_i32_u ({kind}.{operation} {{b}} {{c}})))"
        for name, operation in names.items()
    }


def exceeds_heap(size: object, top: str = "(global.get $top)") -> str:
    """Whether `size` bytes above the top exceed the heap.

    Computed in 64 bits without overflow: the end of the arena may be near, and the top may be above the limit
    (`Block.use_reserve`).
    """
    above = f"(i64.add (i64.extend_i32_u {top}) (i64.const {size}))"
    return f"(i64.gt_u {above} (i64.extend_i32_u (global.get $end)))"


def _order(operation: str) -> str:
    """A comparison of strings; null has no order."""
    return f"""
        (local.set $p (call $str_order (local.get $base) {{b}} {{c}}))
        leave (i32.eq (local.get $p) (i32.const 2))
        (local.set {{a}} (i64.extend_i32_u (i32.{operation} (local.get $p) (i32.const 0))))
    """


def _text(function: str, *arguments: str) -> str:
    """A runtime function that creates a string at the heap's top, and returns its size in words."""
    return f"""
        (local.set $p (global.get $top))
        (local.set $y {{made}})
        (local.set $x (call ${function} (local.get $base) (local.get $y)
            (i64.extend_i32_u (i32.shr_u (i32.sub (global.get $end) (local.get $base)) (i32.const 3)))
            (global.get $text) {" ".join(arguments)}))
        leave (i64.eqz (local.get $x))
        (global.set $top (i32.add (global.get $top) (i32.shl (i32.wrap_i64 (local.get $x)) (i32.const 3))))
        (local.set {{a}} (local.get $y))
    """


def _maths(opcode: str, *arguments: str) -> str:
    """A function of L's maths; the reference engine handles missing results."""
    return f"""
        (local.set $u (call {maths_name(opcode)} {" ".join(arguments)}))
        leave (f64.ne (f64.sub (local.get $u) (local.get $u)) (f64.const 0))
        (local.set {{a}} (local.get $u))
    """


_EQUAL = "(local.set {a} (i64.extend_i32_u (i64.eq {b} {c})))"
_DIFFERS = "(local.set {a} (i64.extend_i32_u (i64.ne {b} {c})))"
_EQUAL_TEXTS = """
    (local.set $p (call $str_equal (local.get $base) {b} {c}))
    leave (i32.eq (local.get $p) (i32.const 2))
"""
#: Proxies are equal if they are for the same agent.
_MEMBERS = f"""
    (local.set $x {{b}})
    (local.set $y {{c}})
    (if (i32.eqz (i32.or (i64.eqz (local.get $x)) (i64.eqz (local.get $y))))
        (then (local.set $x (i64.load offset={_MEMBER} {{b_at}}))
              (local.set $y (i64.load offset={_MEMBER} {{c_at}}))))
"""

ROWS: dict[str, str] = {
    **GROWABLE_ROWS,
    # moves, fields, elements
    "move": "(local.set {a} {b})",
    "getf": """
        null b
        (local.set {a} ({t}.load offset={field} {b_at}))
    """,
    "putf": """
        null a
        ({t}.store offset={field} {a_at} {c})
    """,
    "gete": """
        null b
        (local.set $p {b_at})
        index {c}
        (local.set {a} ({t}.load offset=8
            (i32.add (local.get $p) (i32.shl (i32.wrap_i64 {c}) (i32.const 3)))))
    """,
    "pute": """
        null a
        (local.set $p {a_at})
        index {b}
        ({t}.store offset=8 (i32.add (local.get $p) (i32.shl (i32.wrap_i64 {b}) (i32.const 3))) {c})
    """,
    # memory
    "lds": """
        leave {no_room}
        (local.set $p (global.get $top))
        {image}
        (global.set $top (i32.add (local.get $p) (i32.const {size})))
        (local.set {a} {made})
    """,
    "new": """
        leave {no_room}
        (local.set $p (global.get $top))
        {image}
        (global.set $top (i32.add (local.get $p) (i32.const {size})))
        (local.set {a} {made})
    """,
    "newarray": """
        leave (i64.gt_u {c} (global.get $longest))
        leave (i64.gt_u {c} (i64.const 8192))
        (local.set $x (i64.shl (i64.add {c} (i64.const 1)) (i64.const 3)))
        (local.set $p (global.get $top))
        (local.set $y (i64.add (i64.extend_i32_u (local.get $p)) (local.get $x)))
        leave (i64.gt_u (local.get $y) (i64.extend_i32_u (global.get $end)))
        (i64.store (local.get $p) (i64.or (i64.const {head}) (i64.shl (local.get $x) (i64.const 29))))
        (memory.fill (i32.add (local.get $p) (i32.const 8)) (i32.const 0)
            (i32.sub (i32.wrap_i64 (local.get $x)) (i32.const 8)))
        (global.set $top (i32.wrap_i64 (local.get $y)))
        (local.set {a} {made})
    """,
    # subroutines
    "frame": f"""
        (local.set $x (i64.load offset={8 * layout.W_OWNER} (local.get $base)))
        leave (i32.and (i64.ne (local.get $x) (i64.const 0)) (i64.ne (local.get $x) (global.get $thread)))
        (i64.store offset={8 * layout.W_OWNER} (local.get $base) (global.get $thread))
        (i64.store offset={8 * layout.W_ENTRIES} (local.get $base)
            (i64.add (i64.load offset={8 * layout.W_ENTRIES} (local.get $base)) (i64.const 1)))
    """,
    # arithmetic: a sum overflows if its sign differs from those of both operands
    "addi": """
        (local.set $x (i64.add {b} {c}))
        over (i64.lt_s (i64.and (i64.xor (local.get $x) {b}) (i64.xor (local.get $x) {c})) (i64.const 0))
        (local.set {a} (local.get $x))
    """,
    "subi": """
        (local.set $x (i64.sub {b} {c}))
        over (i64.lt_s (i64.and (i64.xor {b} {c}) (i64.xor (local.get $x) {b})) (i64.const 0))
        (local.set {a} (local.get $x))
    """,
    "muli": """
        (i64.mul_wide_s {b} {c})
        local.set $y
        local.set $x
        over (i64.ne (local.get $y) (i64.shr_s (local.get $x) (i64.const 63)))
        (local.set {a} (local.get $x))
    """,
    "divi": f"""
        zero (i64.eqz {{c}})
        over (i32.and (i64.eq {{b}} (i64.const {_MINIMUM})) (i64.eq {{c}} (i64.const -1)))
        (local.set {{a}} (i64.div_s {{b}} {{c}}))
    """,
    "mod": """
        zero (i64.eqz {c})
        (local.set {a} (i64.rem_s {b} {c}))
    """,
    "negi": f"""
        over (i64.eq {{b}} (i64.const {_MINIMUM}))
        (local.set {{a}} (i64.sub (i64.const 0) {{b}}))
    """,
    # NaN results are canonical, by the settings of the compiler
    "addf": "(local.set {a} (f64.add {b} {c}))",
    "subf": "(local.set {a} (f64.sub {b} {c}))",
    "mulf": "(local.set {a} (f64.mul {b} {c}))",
    "divf": """
        zero (f64.eq {c} (f64.const 0))
        (local.set {a} (f64.div {b} {c}))
    """,
    "negf": """
        leave (f64.ne {b} {b})
        (local.set {a} (f64.neg {b}))
    """,
    # logic and comparisons
    "and": "(local.set {a} (i64.and {b} {c}))",
    "or": "(local.set {a} (i64.or {b} {c}))",
    "not": "(local.set {a} (i64.extend_i32_u (i64.eqz {b})))",
    **_compare("i64", "_s"),
    **_compare("f64", ""),
    "eqb": _EQUAL,
    "sneb": _DIFFERS,
    "eqr": _EQUAL,
    "sner": _DIFFERS,
    "eqr of proxies": _MEMBERS + "(local.set {a} (i64.extend_i32_u (i64.eq (local.get $x) (local.get $y))))",
    "sner of proxies": _MEMBERS + "(local.set {a} (i64.extend_i32_u (i64.ne (local.get $x) (local.get $y))))",
    "eqs": _EQUAL_TEXTS + "(local.set {a} (i64.extend_i32_u (local.get $p)))",
    "snes": _EQUAL_TEXTS + "(local.set {a} (i64.extend_i32_u (i32.eqz (local.get $p))))",
    "sles": _order("le_s"),
    "sges": _order("ge_s"),
    "slts": _order("lt_s"),
    "sgts": _order("gt_s"),
    "eqnull": "(local.set {a} (i64.extend_i32_u (i64.eqz {b})))",
    # library
    "array_len": """
        null 0
        (local.set {a} (i64.sub (i64.load32_u offset=4 {0_at}) (i64.const 1)))
    """,
    "str_len": """
        (local.set $x (call $str_len (local.get $base) {0}))
        leave (i64.lt_s (local.get $x) (i64.const 0))
        (local.set {a} (local.get $x))
    """,
    "str_hash": """
        (local.set $x (call $str_hash (local.get $base) {0}))
        leave (i64.lt_s (local.get $x) (i64.const 0))
        (local.set {a} (local.get $x))
    """,
    "index_of": """
        (local.set $x (call $index_of (local.get $base) {0} {1}))
        leave (i64.eq (local.get $x) (i64.const -2))
        (local.set {a} (local.get $x))
    """,
    "str_concat": _text("str_concat", "{0}", "{1}"),
    "substring": _text("substring", "{0}", "{1}", "{2}"),
    "i2s": _text("i2s", "{0}"),
    "b2s": _text("b2s", "{0}"),
    "s2i": """
        (call $s2i (local.get $base) {0})
        local.set $p
        local.set $x
        leave (i32.eqz (local.get $p))
        (local.set {a} (local.get $x))
    """,
    "hops": f"(local.set {{a}} (i64.load offset={_HOPS} (local.get $base)))",
    "i2f": "(local.set {a} (f64.convert_i64_s {0}))",
    "f2i": """
        leave (i32.eqz (i32.and (f64.ge {0} (f64.const -0x1p63)) (f64.lt {0} (f64.const 0x1p63))))
        (local.set {a} (i64.trunc_f64_s {0}))
    """,
    "abs_int": f"""
        over (i64.eq {{0}} (i64.const {_MINIMUM}))
        (local.set {{a}} (select {{0}} (i64.sub (i64.const 0) {{0}}) (i64.ge_s {{0}} (i64.const 0))))
    """,
    "min_int": "(local.set {a} (select {0} {1} (i64.le_s {0} {1})))",
    "max_int": "(local.set {a} (select {0} {1} (i64.ge_s {0} {1})))",
    "abs_float": """
        leave (f64.ne {0} {0})
        (local.set {a} (f64.abs {0}))
    """,
    "min_float": """
        leave (i32.or (f64.ne {0} {0}) (f64.ne {1} {1}))
        (local.set {a} (f64.min {0} {1}))
    """,
    "max_float": """
        leave (i32.or (f64.ne {0} {0}) (f64.ne {1} {1}))
        (local.set {a} (f64.max {0} {1}))
    """,
    "sqrt": """
        leave (i32.eqz (f64.ge {0} (f64.const 0)))
        (local.set {a} (f64.sqrt {0}))
    """,
    # -0.0 does not occur, because these values were ints in between
    "floor": """
        leave (f64.ne {0} {0})
        (local.set {a} (f64.add (f64.floor {0}) (f64.const 0)))
    """,
    "ceil": """
        leave (f64.ne {0} {0})
        (local.set {a} (f64.add (f64.ceil {0}) (f64.const 0)))
    """,
    "round": """
        leave (f64.ne {0} {0})
        (local.set $u (f64.floor (f64.abs {0})))
        (local.set {a} (f64.copysign (f64.add (local.get $u)
            (f64.convert_i32_u (f64.ge (f64.sub (f64.abs {0}) (local.get $u)) (f64.const 0.5)))) {0}))
    """,
    **{name: _maths(name, "{0}") for name in ("sin", "cos", "tan", "asin", "acos", "exp", "log")},
    **{name: _maths(name, "{0}", "{1}") for name in ("atan2", "pow")},
    "modf": _maths("modf", "{b}", "{c}"),
}

#: The end of a block by each instruction: the class in `control_flow_graph.py`, whose text is a case of
#: `MethodLowering._end`.
CONTROL = {
    "jmp": "JumpExit",
    "bnz": "BranchExit",
    "bz": "BranchExit",
    "call": "CallExit",
    "return": "ReturnExit",
    "rtn": "ReturnExit",
    "throw": "ThrowExit",
}
#: Instructions without code of their own: the head of their group includes them as operands.
GROUPED = ("push", "pop")

#: Runtime functions (`lfield.vm.wasm.runtime`) called by rows, with their types.
RUNTIME = {
    **dict.fromkeys(("str_equal", "str_order"), "(param i32 i64 i64) (result i32)"),
    **dict.fromkeys(("str_len", "str_hash"), "(param i32 i64) (result i64)"),
    "grow": "(param i32 i64 i64 i64 i64) (result i64)",
    "index_of": "(param i32 i64 i64) (result i64)",
    "s2i": "(param i32 i64) (result i64 i32)",
    "str_concat": "(param i32 i64 i64 i64 i64 i64) (result i64)",
    "substring": "(param i32 i64 i64 i64 i64 i64 i64) (result i64)",
    **dict.fromkeys(("i2s", "b2s"), "(param i32 i64 i64 i64 i64) (result i64)"),
}
#: The rows that call L's maths.
MATHS = ("sin", "cos", "tan", "asin", "acos", "exp", "log", "atan2", "pow", "modf")
