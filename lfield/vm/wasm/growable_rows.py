"""Rows of the table of instructions for arrays that grow, in the notation of `instruction_table.py`.

Traps and long arrays are left to the reference engine.
"""

from __future__ import annotations

from lfield.vm.memory import layout

_LENGTH, _ELEMENTS = 8 * layout.GROWABLE_LENGTH, 8 * layout.GROWABLE_ARRAY
#: The maximum number of elements; the reference engine creates and moves more of them.
_LONG = 8192
#: The length of the array in `{0}`.
_OLD_LENGTH = f"""
    (local.set $x (i64.load offset={_LENGTH} {{0_at}}))
    leave (i64.ge_u (local.get $x) (global.get $longest))
"""
#: The address of the elements, with space for one more.
_WITH_SPACE = f"""
    (local.set $p (i32.add (local.get $base)
        (i32.shl (i32.wrap_i64 (i64.load offset={_ELEMENTS} {{0_at}})) (i32.const 3))))
    (i64.ge_u (i64.add (local.get $x) (i64.const 1)) (i64.load32_u offset=4 (local.get $p)))
    if
    (local.set $p (global.get $top))
    (local.set $y (call $grow (local.get $base) {{0}} {{made}}
        (i64.extend_i32_u (i32.shr_u (i32.sub (global.get $end) (local.get $base)) (i32.const 3)))
        (global.get $longest)))
    leave (i64.eqz (local.get $y))
    (global.set $top (i32.add (local.get $p) (i32.shl (i32.wrap_i64 (local.get $y)) (i32.const 3))))
    end
"""

GROWABLE_ROWS: dict[str, str] = {
    "gete of growable": """
        null b
        (local.set $p {b_at})
        place {c}
        (local.set {a} ({t}.load (local.get $p)))
    """,
    "pute of growable": """
        null a
        (local.set $p {a_at})
        place {b}
        ({t}.store (local.get $p) {c})
    """,
    "array_len of growable": f"""
        null 0
        (local.set {{a}} (i64.load offset={_LENGTH} {{0_at}}))
    """,
    "newarray of growable": f"""
        leave (i64.gt_u {{c}} (global.get $longest))
        leave (i64.gt_u {{c}} (i64.const {_LONG}))
        (local.set $x (i64.shl (i64.add {{c}} (i64.const {layout.GROWABLE_WORDS + 1})) (i64.const 3)))
        (local.set $p (global.get $top))
        (local.set $y (i64.add (i64.extend_i32_u (local.get $p)) (local.get $x)))
        leave (i64.gt_u (local.get $y) (i64.extend_i32_u (global.get $end)))
        (i64.store (local.get $p) (i64.const {{head}}))
        (i64.store offset={_LENGTH} (local.get $p) {{c}})
        (i64.store offset={_ELEMENTS} (local.get $p)
            (i64.add {{made}} (i64.const {layout.GROWABLE_WORDS})))
        (i64.store offset={8 * layout.GROWABLE_WORDS} (local.get $p)
            (i64.or (i64.const {{plain_head}}) (i64.shl (i64.add {{c}} (i64.const 1)) (i64.const 32))))
        (memory.fill (i32.add (local.get $p) (i32.const {8 * layout.GROWABLE_WORDS + 8})) (i32.const 0)
            (i32.sub (i32.wrap_i64 (local.get $x)) (i32.const {8 * layout.GROWABLE_WORDS + 8})))
        (global.set $top (i32.wrap_i64 (local.get $y)))
        (local.set {{a}} {{made}})
    """,
    "append": f"""
        null 0
        {_OLD_LENGTH}
        {_WITH_SPACE}
        ({{t}}.store offset=8
            (i32.add (local.get $p) (i32.shl (i32.wrap_i64 (local.get $x)) (i32.const 3))) {{1}})
        (i64.store offset={_LENGTH} {{0_at}} (i64.add (local.get $x) (i64.const 1)))
    """,
    "insert": f"""
        null 0
        {_OLD_LENGTH}
        leave (i64.gt_u {{1}} (local.get $x))
        leave (i64.gt_u (i64.sub (local.get $x) {{1}}) (i64.const {_LONG}))
        {_WITH_SPACE}
        (local.set $p
            (i32.add (local.get $p) (i32.shl (i32.wrap_i64 (i64.add {{1}} (i64.const 1))) (i32.const 3))))
        (memory.copy (i32.add (local.get $p) (i32.const 8)) (local.get $p)
            (i32.shl (i32.wrap_i64 (i64.sub (local.get $x) {{1}})) (i32.const 3)))
        ({{t}}.store (local.get $p) {{2}})
        (i64.store offset={_LENGTH} {{0_at}} (i64.add (local.get $x) (i64.const 1)))
    """,
    "remove": f"""
        null 0
        (local.set $x (i64.load offset={_LENGTH} {{0_at}}))
        leave (i64.ge_u {{1}} (local.get $x))
        leave (i64.gt_u (i64.sub (local.get $x) {{1}}) (i64.const {_LONG}))
        (local.set $y (i64.load offset={_ELEMENTS} {{0_at}}))
        (i64.store offset={_LENGTH} {{0_at}} (i64.sub (local.get $x) (i64.const 1)))
        (local.set $x (i64.sub (i64.sub (local.get $x) (i64.const 1)) {{1}}))
        (local.set $p (i32.add
            (i32.add (local.get $base) (i32.shl (i32.wrap_i64 (local.get $y)) (i32.const 3)))
            (i32.shl (i32.wrap_i64 (i64.add {{1}} (i64.const 1))) (i32.const 3))))
        (local.set {{a}} ({{t}}.load (local.get $p)))
        (memory.copy (local.get $p) (i32.add (local.get $p) (i32.const 8))
            (i32.shl (i32.wrap_i64 (local.get $x)) (i32.const 3)))
        (i64.store (i32.add (local.get $p) (i32.shl (i32.wrap_i64 (local.get $x)) (i32.const 3)))
            (i64.const 0))
    """,
    "remove_last": f"""
        null 0
        (local.set $x (i64.sub (i64.load offset={_LENGTH} {{0_at}}) (i64.const 1)))
        leave (i64.lt_s (local.get $x) (i64.const 0))
        (local.set $p (i32.add
            (i32.add (local.get $base)
                (i32.shl (i32.wrap_i64 (i64.load offset={_ELEMENTS} {{0_at}})) (i32.const 3)))
            (i32.shl (i32.wrap_i64 (i64.add (local.get $x) (i64.const 1))) (i32.const 3))))
        (i64.store offset={_LENGTH} {{0_at}} (local.get $x))
        (local.set {{a}} ({{t}}.load (local.get $p)))
        (i64.store (local.get $p) (i64.const 0))
    """,
}
