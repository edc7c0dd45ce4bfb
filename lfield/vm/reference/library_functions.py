"""Pure library instructions: strings, conversions, maths (table J.9).

A function takes the registers and the arguments (numbers as numbers, references as places) and returns the
result in the same form.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from lfield.bytecode.program import EXCEPTIONS, MESSAGE, SOURCE
from lfield.vm.engine_interface import Trap
from lfield.vm.maths.intrinsics import MATHS, has_result
from lfield.vm.memory import layout
from lfield.vm.memory.word_codec import canonical, real_text
from lfield.vm.reference.call_steps import Registers, null_use
from lfield.vm.reference.memory_steps import check_length

Function = Callable[..., Any]

_INT = re.compile(r"[+-]?[0-9]{1,19}", re.ASCII)
_REAL = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]{1,4})?", re.ASCII)
#: Characters of a string shown in an exception message.
_MAX_SHOWN = 40
_FNV_BASIS, _FNV_PRIME, _WORD = 0xCBF29CE484222325, 0x100000001B3, (1 << 64) - 1


def _text(m: Registers, place: int, use: str) -> str:
    if not place:
        raise null_use(use)
    return m.block.string(place)


def _new_string(m: Registers, text: str) -> int:
    if len(text) > m.limits.string_length:
        raise Trap("LimitException", f"a string of {len(text)} is over the limit of {m.limits.string_length}")
    return m.block.new_string(text)


def _array_len(m: Registers, place: int) -> int:
    if not place:
        raise null_use("length")
    return layout.length(m.w, place)


def _append(m: Registers, place: int, word: int) -> None:
    if not place:
        raise null_use("append")
    length = layout.length(m.w, place)
    check_length(m, length + 1)
    m.block.insert_element(place, length, word, m.limits.array_length)


def _insert(m: Registers, place: int, at: int, word: int) -> None:
    if not place:
        raise null_use("insert")
    length = layout.length(m.w, place)
    if not 0 <= at <= length:
        raise Trap("IndexException", f"insert at {at} of an array of length {length}")
    check_length(m, length + 1)
    m.block.insert_element(place, at, word, m.limits.array_length)


def _remove(m: Registers, place: int, at: int) -> int:
    if not place:
        raise null_use("remove")
    length = layout.length(m.w, place)
    if not 0 <= at < length:
        raise Trap("IndexException", f"remove of {at} of an array of length {length}")
    return m.block.remove_element(place, at)


def _remove_last(m: Registers, place: int) -> int:
    if not place:
        raise null_use("pop")
    length = layout.length(m.w, place)
    if not length:
        raise Trap("IndexException", "pop of an array of length 0")
    return m.block.remove_element(place, length - 1)


def _hash(m: Registers, place: int) -> int:
    """FNV-1a of 64 bits over UTF-8, without its lowest two bits."""
    found = _FNV_BASIS
    for byte in _text(m, place, "key").encode():
        found = (found ^ byte) * _FNV_PRIME & _WORD
    return found >> 2


def _concat(m: Registers, left: int, right: int) -> int:
    return _new_string(m, _text(m, left, "'+'") + _text(m, right, "'+'"))


def _substring(m: Registers, place: int, start: int, end: int) -> int:
    text = _text(m, place, "substring")
    if not 0 <= start <= end <= len(text):
        raise Trap("IndexException", f"substring({start}, {end}) of a string of length {len(text)}")
    return _new_string(m, text[start:end])


def _index_of(m: Registers, place: int, needle: int) -> int:
    return _text(m, place, "indexOf").find(_text(m, needle, "indexOf"))


def _f2i(m: Registers, value: float) -> int:
    # 2^63 is exact as a real; a real that is not below it, or NaN, does not fit an int.
    if not -9223372036854775808.0 <= value < 9223372036854775808.0:
        raise Trap("ConversionException", f"{value!r} does not fit an int")
    return int(value)


def _s2i(m: Registers, place: int) -> int:
    text = _text(m, place, "s2i").strip()
    if _INT.fullmatch(text) and -(1 << 63) <= (value := int(text)) < 1 << 63:
        return value
    raise Trap("ConversionException", f'"{text[:_MAX_SHOWN]}" is not an int')


def _s2f(m: Registers, place: int) -> float:
    text = _text(m, place, "s2f").strip()
    if len(text) > 400 or not _REAL.fullmatch(text):
        raise Trap("ConversionException", f'"{text[:_MAX_SHOWN]}" is not a real')
    return float(text)


def _digits(m: Registers, value: float, digits: int) -> int:
    if not 0 <= digits <= 17:
        raise Trap("ArithmeticException", f"{digits} decimals; f2s supports 0 to 17")
    return _new_string(m, f"{value:.{digits}f}")


def _maths(name: str, function: Callable[..., float]) -> Function:
    def apply(m: Registers, *values: float) -> float:
        result = function(*values)
        if not has_result(values, result):
            arguments = ", ".join(real_text(v) for v in values)
            raise Trap("ArithmeticException", f"{name}({arguments}) has no result")
        return canonical(result)

    return apply


def _class_name(m: Registers, place: int) -> str:
    return m.class_names[m.w[place] >> 8 & 0xFFFFFF]


def _exception_text(field: int) -> Function:
    def get(m: Registers, place: int) -> int:
        if not place:
            raise null_use("exception")
        if m.w[place] >> 8 & 0xFFFFFF < m.builtins:
            return m.w[place + 1 + field] or m.block.new_string("")
        # For an object of the program's own class only the name of the class is shown.
        return m.block.new_string(_class_name(m, place) if field == MESSAGE else "")

    return get


def _exception_type(m: Registers, place: int) -> int:
    if not place:
        raise null_use("exception")
    return m.block.new_string(_class_name(m, place))


def _exception_others(m: Registers, place: int) -> int:
    if not place:
        raise null_use("exception")
    field = m.others.get(m.w[place] >> 8 & 0xFFFFFF)
    known = 0 if field is None else m.w[place + 1 + field]
    return known or m.block.allocate(layout.ARRAY, EXCEPTIONS, 1)


def growable_others(kind: int) -> Function:
    """`exc_others` in a program whose arrays of exceptions grow: a copy of this type."""

    def get(m: Registers, place: int) -> int:
        if not place:
            raise null_use("exception")
        field, w = m.others.get(m.w[place] >> 8 & 0xFFFFFF), m.w
        known = 0 if field is None else w[place + 1 + field]
        first, end = layout.elements(w, known) if known else (0, 0)
        copy = m.block.new_array(kind, m.plain_arrays[kind], end - first)
        w[layout.elements(w, copy)[0] : m.block.top] = w[first:end]
        return copy

    return get


def _heartbeat_interval(m: Registers, seconds: float) -> None:
    if seconds == -1:
        m.w[layout.W_INTERVAL] = 0
    elif 0 < seconds <= layout.MAX_INTERVAL / 1000:
        m.w[layout.W_INTERVAL] = max(1, round(1000 * seconds))
    else:
        raise Trap(
            "ArithmeticException",
            f"heartbeatInterval({real_text(seconds)}) is not valid: an interval is above 0 and at most 86400 "
            "seconds, or -1 for none",
        )


FUNCTIONS: dict[str, Function] = {
    "array_len": _array_len,
    "str_concat": _concat,
    "str_len": lambda m, place: len(_text(m, place, "length")),
    "substring": _substring,
    "index_of": _index_of,
    "str_hash": _hash,
    "append": _append,
    "insert": _insert,
    "remove": _remove,
    "remove_last": _remove_last,
    "i2f": lambda m, value: float(value),
    "f2i": _f2i,
    "s2i": _s2i,
    "s2f": _s2f,
    "i2s": lambda m, value: _new_string(m, str(value)),
    "f2s": lambda m, value: _new_string(m, real_text(value)),
    "f2s_digits": _digits,
    "b2s": lambda m, value: _new_string(m, "true" if value else "false"),
    "hops": lambda m: m.w[layout.W_HOPS],
    "heartbeat_interval": _heartbeat_interval,
    "abs_int": lambda m, value: abs(value),
    "min_int": lambda m, a, b: min(a, b),
    "max_int": lambda m, a, b: max(a, b),
    "exc_message": _exception_text(MESSAGE),
    "exc_type": _exception_type,
    "exc_source": _exception_text(SOURCE),
    "exc_others": _exception_others,
    **{name: _maths(name, function) for name, function in MATHS.items()},
}
