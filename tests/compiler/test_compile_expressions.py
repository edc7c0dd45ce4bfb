"""Expressions: they write their values directly to their targets, and they are evaluated in source order."""

from __future__ import annotations

import struct

import pytest
from listing import code, compiled_body, instructions

from lfield.bytecode.program import Program


def constants(program: Program) -> list[object]:
    return list(program.core.constants)


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("int i = 1; i = i + 1;", ["move, ^2, 1", "addi, ^2, ^2, 1"]),
        ("int i = 1; i = 1 + i;", ["move, ^2, 1", "addi, ^2, ^2, 1"]),
        ("int i = 1; i = 1 - i;", ["move, ^2, 1", "move, ^3, 1", "subi, ^2, ^3, ^2"]),
        ("int i = 1; int j = i * i - i;", ["move, ^2, 1", "muli, ^4, ^2, ^2", "subi, ^3, ^4, ^2"]),
        ("real r = 1;", ["move, ^2, 1.0"]),
        ("int i = -5;", ["move, ^2, -5"]),
        ("real r = -2.5;", ["move, ^2, -2.5"]),
        (
            'string s = "a" + arg[0];',
            ['lds, ^3, "a"', "gete, ^4, ^1, 0", "push, ^3", "push, ^4", "str_concat", "pop, ^2"],
        ),
        ("int i = -9223372036854775808;", ["move, ^2, -9223372036854775808"]),
        ("int i = 60 * 60 - 1;", ["move, ^2, 3599"]),
        ("boolean b = !true;", ["move, ^2, false"]),
        ('string s = "a";', ['lds, ^2, "a"']),
        ("int i = 2; i = -i;", ["move, ^2, 2", "negi, ^2, ^2"]),
        ("real r = 2.0; r = -r;", ["move, ^2, 2.0", "negf, ^2, ^2"]),
        ("int i = 1; real r = i;", ["move, ^2, 1", "push, ^2", "i2f", "pop, ^3"]),
        ("boolean b = arg == null;", ["eqnull, ^2, ^1"]),
        ("boolean b = null == arg;", ["eqnull, ^2, ^1"]),
        ("boolean b = arg != null;", ["eqnull, ^3, ^1", "not, ^2, ^3"]),
        ("int i = 1; boolean b = 0 < i;", ["move, ^2, 1", "sgti, ^3, ^2, 0"]),
        ("int i = 1; boolean b = 0 >= i;", ["move, ^2, 1", "slei, ^3, ^2, 0"]),
        ("boolean b = true; boolean c = b == true;", ["move, ^2, true", "eqb, ^3, ^2, true"]),
        ("int[] a = new int[3];", ["newarray, ^2, int[], 3"]),
        ("string s = arg[0];", ["gete, ^2, ^1, 0"]),
        ("arg[0] = null;", ["move, ^2, 0", "pute, ^1, ^2, null"]),
        ("Pair p = null; int i = p.a;", ["move, ^2, null", "getf, ^3, ^2, .a"]),
        ("Pair p = null; p.next.a = 1;", ["move, ^2, null", "getf, ^3, ^2, .next", "putf, ^3, .a, 1"]),
        ("Pair p = new Pair(1);", ["new, ^2, Pair", "push, ^2", "push, 1", "call, Pair.Pair(int)"]),
        ("write(1.5);", ["push, 1.5", "write_float"]),
        ("int i = 0; boolean b = i > 1 == false;", ["move, ^2, 0", "sgti, ^4, ^2, 1", "eqb, ^3, ^4, false"]),
    ],
)
def test_expressions_compile_to_few_instructions(body: str, expected: list[str]) -> None:
    assert code(body) == expected


def test_a_constant_expression_that_overflows_is_not_folded() -> None:
    assert code("int i = 9223372036854775807 + 1;") == ["move, ^3, 1", "addi, ^2, ^3, 9223372036854775807"]


def test_arguments_are_evaluated_before_the_first_push() -> None:
    made = code("int i = f(1, f(2, 3));", "private int f(int a, int b) { return a; }")
    inner = ["push, ^0", "push, 2", "push, 3", "call, R.f(int, int)", "pop, ^3"]
    assert made == [*inner, "push, ^0", "push, 1", "push, ^3", "call, R.f(int, int)", "pop, ^2"]


def test_a_discarded_result_is_popped() -> None:
    made = code("f();", "private int f() { return 1; }")
    assert made == ["push, ^0", "call, R.f()", "pop, ^2"]


def test_the_target_is_written_last() -> None:
    """On the right side, `a` has its old value, also after the call."""
    made = code("int a = 3; a = f(a) + a;", "private int f(int x) { return x; }")
    assert made[1:] == ["push, ^0", "push, ^2", "call, R.f(int)", "pop, ^3", "addi, ^2, ^3, ^2"]


def test_a_variable_is_assigned_after_its_new_object_is_complete() -> None:
    made = code("Pair p = null; p = new Pair(p.a);")
    assert made[1:] == [
        "new, ^3, Pair",
        "getf, ^4, ^2, .a",
        "push, ^3",
        "push, ^4",
        "call, Pair.Pair(int)",
        "move, ^2, ^3",
    ]


def test_a_variable_assigned_within_the_statement_is_copied_first() -> None:
    made = code("int[] a = null; int i = 0; a[i] = i = 2;")
    assert made[2:] == ["move, ^4, ^3", "move, ^3, 2", "move, ^5, ^3", "pute, ^2, ^4, ^5"]


def test_chained_assignments_share_the_value() -> None:
    made = code("Pair p = null; int i = 0; i = p.a = 7;")
    assert made[2:] == ["putf, ^2, .a, 7", "move, ^3, 7"]


def test_the_message_of_an_exception_is_stored_in_its_field() -> None:
    made = code('Exception e = new NullException("m");')
    assert made == ["new, ^3, NullException", 'lds, ^4, "m"', "putf, ^3, .message, ^4", "move, ^2, ^3"]
    assert code("NullException e = new NullException();") == ["new, ^2, NullException"]


def test_arrays_of_arrays_are_created() -> None:
    assert code("int[][] m = new int[2][3];") == [
        "newarray, ^2, int[][], 2",
        "move, ^3, 0",
        "jmp, L7",
        "newarray, ^5, int[], 3",
        "pute, ^2, ^3, ^5",
        "addi, ^3, ^3, 1",
        "slti, ^4, ^3, 2",
        "bnz, L4, ^4",
    ]


def test_arrays_without_a_given_length_stay_null() -> None:
    assert code("int[][] m = new int[2][];") == ["newarray, ^2, int[][], 2"]


def test_long_chains_need_few_slots() -> None:
    """Temporaries are released as soon as they are read."""
    program = compiled_body("int i = 1; i = " + " + ".join(["i * i"] * 50) + ";")
    init = program.core.methods[-1]
    assert len(init.slots) <= 6


def test_constants_are_pooled_by_kind_and_bits() -> None:
    program = compiled_body(
        "int i = 1; real r = 1.0; boolean b = true; r = 0.0; r = -0.0; i = 1; r = 1.0; i = 0; b = false;"
    )
    found = constants(program)
    assert [type(value) for value in found] == [int, float, bool, float, float, int, bool]
    assert [struct.pack("<d", v) for v in found if isinstance(v, float)] == [
        struct.pack("<d", v) for v in (1.0, 0.0, -0.0)
    ]


def test_string_constants_are_shared_only_with_equal_strings() -> None:
    program = compiled_body('string a = "1"; string b = "1"; int i = 1;')
    assert constants(program) == ["1", 1]


def test_logic_on_locals_needs_no_jump() -> None:
    made = code("boolean a = true; boolean b = false; boolean c = a && b; c = a || b;")
    assert made[2:] == ["and, ^4, ^2, ^3", "or, ^4, ^2, ^3"]


def test_the_right_side_of_logic_is_evaluated_only_when_needed() -> None:
    made = code("Pair p = null; boolean b = p != null && p.a == 1;")
    assert made[1:] == [
        "eqnull, ^4, ^2",
        "bnz, L9, ^4",
        "getf, ^5, ^2, .a",
        "eqi, ^4, ^5, 1",
        "bz, L9, ^4",
        "move, ^3, true",
        "jmp, L10",
        "move, ^3, false",
    ]


def test_methods_without_statements_compile() -> None:
    program = compiled_body("", "private void f() { } private int g() { while (true) { } }")
    assert instructions(program, "R.f") == ["rtn"]
    assert instructions(program, "R.g") == ["jmp, L1"]
