"""Compiler of L's maths from Python source to WebAssembly text: the functions of the reference engine.

Supported: reals (f64), ints within 64 bits (i64, not negative before `//` and `%`), booleans (i32), `if`,
`while`, `for` over a constant tuple (unrolled), and functions with one or several results. Every operation
has a counterpart with identical bits, except the bits of a NaN; the functions never use the bits of a NaN,
and an engine only checks whether a result is finite (decision 58).
"""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable, Iterable
from functools import lru_cache
from math import copysign, sqrt
from types import FunctionType, ModuleType
from typing import Any

from lfield.vm.maths.intrinsics import MATHS
from lfield.vm.memory.word_codec import bits_of_real, real_from_bits

F64, I64, I32 = "f64", "i64", "i32"
_TYPES = {"float": F64, "int": I64, "bool": I32}

#: By Python operator: the instruction and the type of its result.
_INTRINSICS: dict[Any, tuple[str, str]] = {
    abs: ("f64.abs", F64),
    copysign: ("f64.copysign", F64),
    sqrt: ("f64.sqrt", F64),
    float: ("f64.convert_i64_s", F64),
    int: ("i64.trunc_sat_f64_s", I64),
    real_from_bits: ("f64.reinterpret_i64", F64),
    bits_of_real: ("i64.reinterpret_f64", I64),
}

_OPERATORS: dict[type[ast.operator], dict[str, str]] = {
    ast.Add: {F64: "f64.add", I64: "i64.add"},
    ast.Sub: {F64: "f64.sub", I64: "i64.sub"},
    ast.Mult: {F64: "f64.mul", I64: "i64.mul"},
    ast.Div: {F64: "f64.div"},
    ast.FloorDiv: {I64: "i64.div_s"},
    ast.Mod: {I64: "i64.rem_s"},
    ast.LShift: {I64: "i64.shl"},
    ast.RShift: {I64: "i64.shr_s"},
    ast.BitAnd: {I64: "i64.and"},
    ast.BitOr: {I64: "i64.or"},
}

_COMPARISONS: dict[type[ast.cmpop], dict[str, str]] = {
    ast.Eq: {F64: "f64.eq", I64: "i64.eq", I32: "i32.eq"},
    ast.NotEq: {F64: "f64.ne", I64: "i64.ne", I32: "i32.ne"},
    ast.Lt: {F64: "f64.lt", I64: "i64.lt_s"},
    ast.LtE: {F64: "f64.le", I64: "i64.le_s"},
    ast.Gt: {F64: "f64.gt", I64: "i64.gt_s"},
    ast.GtE: {F64: "f64.ge", I64: "i64.ge_s"},
}


def maths_name(opcode: str) -> str:
    """The WebAssembly function of an instruction of `MATHS`: f64 arguments to an f64."""
    return _symbol(MATHS[opcode])


def maths_text(opcodes: Iterable[str]) -> str:
    """The functions of these instructions and all functions that they call, for inclusion in a module."""
    return functions_text(MATHS[opcode] for opcode in opcodes)


def functions_text(functions: Iterable[Callable[..., Any]]) -> str:
    """Functions in the subset and all functions that they call, once each."""
    texts: dict[Any, str] = {}
    waiting: list[Any] = list(functions)
    while waiting:
        function = waiting.pop()
        if function not in texts:
            texts[function], dependencies = _lowered(function)
            waiting += dependencies
    return "\n".join(texts[name] for name in sorted(texts, key=str))


def _symbol(function: Callable[..., Any]) -> str:
    assert isinstance(function, FunctionType)
    return f"$maths.{function.__module__.rpartition('.')[2]}.{function.__name__}"


@lru_cache(maxsize=1024)
def _lowered(source: Callable[..., Any] | tuple[str, tuple[float, ...]]) -> tuple[str, tuple[Any, ...]]:
    """The text of a function, or of a named table, and its dependencies."""
    if isinstance(source, tuple):
        return _table(*source), ()
    assert isinstance(source, FunctionType)
    module = sys.modules[source.__module__]
    body = _parsed(module)[source.__name__]
    function = _Function(module, body)
    return function.text(_symbol(source)), tuple(function.dependencies)


@lru_cache(maxsize=64)
def _parsed(module: ModuleType) -> dict[str, ast.FunctionDef]:
    tree = ast.parse(inspect.getsource(module))
    return {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}


def _constant(value: float) -> str:
    """An instruction that pushes a constant."""
    if isinstance(value, bool):
        return f"i32.const {int(value)}"
    if isinstance(value, int):
        return f"i64.const {value}"
    return f"f64.const {value.hex()}"


def _type_of(value: float) -> str:
    return _TYPES[type(value).__name__]


def _table(symbol: str, values: tuple[float, ...]) -> str:
    """A function from an index to the constants of a tuple."""
    labels = " ".join(str(number) for number in range(len(values)))
    lines = [f"(func {symbol} (param i64) (result {_type_of(values[0])})"]
    lines += ["  block"] * len(values)
    lines += [f"  local.get 0 i32.wrap_i64 br_table {labels} {len(values) - 1}"]
    lines += [f"  end {_constant(value)} return" for value in values]
    return "\n".join([*lines, "  unreachable)"])


class _Function:
    """A function being lowered."""

    def __init__(self, module: ModuleType, node: ast.FunctionDef) -> None:
        self.names = vars(module)
        self.node = node
        self.locals = {a.arg: self.annotated(a.annotation)[0] for a in node.args.args}
        self.constants: dict[str, float] = {}
        self.lines: list[str] = []
        self.dependencies: list[Any] = []
        self.labels = 0

    def text(self, symbol: str) -> str:
        for statement in self.node.body:
            self.statement(statement)
        arguments = [a.arg for a in self.node.args.args]
        params = "".join(f" (param ${name} {self.locals[name]})" for name in arguments)
        results = " ".join(self.annotated(self.node.returns))
        own = [f"  (local ${name} {kind})" for name, kind in self.locals.items() if name not in arguments]
        body = [f"  {line}" for line in self.lines]
        return "\n".join([f"(func {symbol}{params} (result {results})", *own, *body, "  unreachable)"])

    def annotated(self, node: ast.expr | None) -> list[str]:
        """The types of an annotation: several for a tuple."""
        if isinstance(node, ast.Subscript):
            assert isinstance(node.slice, ast.Tuple)
            return [kind for part in node.slice.elts for kind in self.annotated(part)]
        assert isinstance(node, ast.Name)
        return [_TYPES[node.id]]

    def refuse(self, node: ast.AST) -> TypeError:
        return TypeError(
            f"'{ast.unparse(node)}' in {self.node.name} cannot be lowered to WebAssembly: see "
            "lfield/vm/wasm/lowering/maths_lowering.py"
        )

    # --- statements -----------------------------------------------------------------------------------

    def statement(self, node: ast.stmt) -> None:
        """Lower one statement."""
        match node:
            case ast.Expr(ast.Constant()):
                return
            case ast.Assign([ast.Name(name)], value):
                self.store(name, *self.values(value))
            case ast.Assign([ast.Tuple(names)], value):
                kinds = self.values(value)
                for target, kind in reversed(list(zip(names, kinds, strict=True))):
                    assert isinstance(target, ast.Name)
                    self.store(target.id, kind)
            case ast.Return(value) if value is not None:
                self.values(value)
                self.lines.append("return")
            case ast.If(test, body, orelse):
                self.condition(test)
                self.branches("if", body, orelse)
            case ast.While(test, body, []):
                self.loop(test, body)
            case ast.For(ast.Name(name), ast.Name(table), body, []):
                self.unrolled(name, self.names[table], body)
            case _:
                raise self.refuse(node)

    def store(self, name: str, kind: str) -> None:
        if self.locals.setdefault(name, kind) != kind:
            raise TypeError(f"{name} in {self.node.name} is of two types")
        self.lines.append(f"local.set ${name}")

    def branches(self, opening: str, body: list[ast.stmt], orelse: list[ast.stmt]) -> None:
        self.lines.append(opening)
        for statement in body:
            self.statement(statement)
        if orelse:
            self.lines.append("else")
        for statement in orelse:
            self.statement(statement)
        self.lines.append("end")

    def loop(self, test: ast.expr, body: list[ast.stmt]) -> None:
        self.labels += 1
        self.lines.append(f"loop $again{self.labels}")
        label = f"br $again{self.labels}"
        self.condition(test)
        self.lines.append("if")
        for statement in body:
            self.statement(statement)
        self.lines += [label, "end", "end"]

    def unrolled(self, name: str, table: tuple[float, ...], body: list[ast.stmt]) -> None:
        for value in table:
            self.constants[name] = value
            for statement in body:
                self.statement(statement)

    # --- expressions ----------------------------------------------------------------------------------

    def values(self, node: ast.expr) -> list[str]:
        """Lower an expression with one or several values; returns their types."""
        match node:
            case ast.Tuple(parts) | ast.Call(ast.Name("tuple"), parts):
                return [self.value(part) for part in parts]
            case ast.Starred(inner):
                return self.values(inner)
            case ast.Call(ast.Name(name), arguments):
                return self.call(
                    node, self.names.get(name, getattr(sys.modules["builtins"], name, None)), arguments
                )
        return [self.value(node)]

    def value(self, node: ast.expr) -> str:
        """Lower an expression with one value; returns its type."""
        match node:
            case ast.Constant(bool() | int() | float() as constant):
                return self.constant(constant)
            case ast.Name(name):
                return self.name(node, name)
            case ast.BinOp(left, operator, right):
                return self.operation(node, _OPERATORS.get(type(operator), {}), left, right)
            case ast.Compare(left, [operator], [right]):
                self.operation(node, _COMPARISONS.get(type(operator), {}), left, right)
                return I32
            case ast.BoolOp(operator, parts):
                return self.either(isinstance(operator, ast.And), parts)
            case ast.UnaryOp(operator, operand):
                return self.unary(node, operator, operand)
            case ast.IfExp(test, body, orelse):
                return self.choice(test, body, orelse)
            case ast.Subscript(ast.Name(table), index):
                return self.element(table, index)
            case ast.Call():
                (kind,) = self.values(node)
                return kind
        raise self.refuse(node)

    def constant(self, value: float) -> str:
        self.lines.append(_constant(value))
        return _type_of(value)

    def name(self, node: ast.expr, name: str) -> str:
        if name in self.constants:
            return self.constant(self.constants[name])
        if name in self.locals:
            self.lines.append(f"local.get ${name}")
            return self.locals[name]
        if not isinstance(self.names.get(name), int | float):
            raise self.refuse(node)
        return self.constant(self.names[name])

    def operation(self, node: ast.expr, table: dict[str, str], left: ast.expr, right: ast.expr) -> str:
        kind = self.value(left)
        if self.value(right) != kind or kind not in table:
            raise self.refuse(node)
        self.lines.append(table[kind])
        return kind

    def condition(self, node: ast.expr) -> None:
        """Lower a boolean expression: L's maths has no truth value of numbers."""
        if self.value(node) != I32:
            raise self.refuse(node)

    def either(self, both: bool, parts: list[ast.expr]) -> str:
        """`and` and `or`: the right side is evaluated only if needed."""
        self.condition(parts[0])
        for part in parts[1:]:
            self.lines.append("if (result i32)")
            if not both:
                self.lines += ["i32.const 1", "else"]
            self.condition(part)
            if both:
                self.lines += ["else", "i32.const 0"]
            self.lines.append("end")
        return I32

    def unary(self, node: ast.expr, operator: ast.unaryop, operand: ast.expr) -> str:
        if isinstance(operator, ast.USub) and self.is_int(operand):
            self.lines.append("i64.const 0")
            self.value(operand)
            self.lines.append("i64.sub")
            return I64
        kind = self.value(operand)
        if (type(operator), kind) not in ((ast.USub, F64), (ast.Not, I32)):
            raise self.refuse(node)
        self.lines.append("f64.neg" if kind == F64 else "i32.eqz")
        return kind

    def is_int(self, node: ast.expr) -> bool:
        """Whether an expression is an int, by a trial lowering."""
        lines, dependencies = list(self.lines), list(self.dependencies)
        kind = self.value(node)
        self.lines, self.dependencies = lines, dependencies
        return kind == I64

    def choice(self, test: ast.expr, body: ast.expr, orelse: ast.expr) -> str:
        self.condition(test)
        at = len(self.lines)
        kind = self.value(body)
        self.lines.insert(at, f"if (result {kind})")
        self.lines.append("else")
        if self.value(orelse) != kind:
            raise self.refuse(orelse)
        self.lines.append("end")
        return kind

    def element(self, table: str, index: ast.expr) -> str:
        self.value(index)
        symbol, values = f"$maths.{table}", self.names[table]
        self.dependencies.append((symbol, values))
        self.lines.append(f"call {symbol}")
        return _type_of(values[0])

    def call(self, node: ast.expr, function: Any, arguments: list[ast.expr]) -> list[str]:
        for argument in arguments:
            self.values(argument)
        if function in _INTRINSICS:
            instruction, kind = _INTRINSICS[function]
            self.lines.append(instruction)
            return [kind]
        if not isinstance(function, FunctionType):
            raise self.refuse(node)
        self.dependencies.append(function)
        self.lines.append(f"call {_symbol(function)}")
        return self.annotated(_parsed(sys.modules[function.__module__])[function.__name__].returns)
