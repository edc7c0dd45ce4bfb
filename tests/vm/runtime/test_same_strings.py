"""String operations in WebAssembly and in Python give the same results, or WebAssembly leaves them to
Python."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

pytest.importorskip("wasmtime", reason="the engine in WebAssembly needs wasmtime: pip install lfield[wasm]")

from random_heaps import LETTERS, heaps, layouts_of, random_program

from lfield.vm.engine_interface import AgentLimits, Trap
from lfield.vm.memory.block import Block, HeapFull
from lfield.vm.memory.block_allocator import HEAP_ALLOCATOR
from lfield.vm.memory.collector import collect
from lfield.vm.memory.layout import HEADER_WORDS
from lfield.vm.reference.arithmetic import STRING_COMPARE
from lfield.vm.reference.call_steps import Registers
from lfield.vm.reference.library_functions import FUNCTIONS
from lfield.vm.wasm.native_calls import bind_function, unsigned

texts = st.text(st.sampled_from(LETTERS) | st.characters(exclude_categories=("Cs",)), max_size=40)
maybe = st.none() | texts


@cache
def called(name: str, count: int) -> Callable[..., int]:
    return bind_function(heaps().store, heaps().functions.instance, name, count)


class Two:
    """The same strings in two blocks: one for Python, one in the arena."""

    def __init__(self, *strings: str | None, room: int = 400, most: int = 100) -> None:
        program = random_program(1)
        self.python, self.arena = (Block.empty(program.digest, 4096, s) for s in (HEAP_ALLOCATOR, heaps()))
        for block in (self.python, self.arena):
            collect(block, layouts_of(program), 2048)
        self.places = [0 if text is None else self.python.new_string(text) for text in strings]
        for text in strings:
            if text is not None:
                self.arena.new_string(text)
        for block in (self.python, self.arena):
            # The old contents there must not matter.
            block.w[block.top :] = memoryview(b"\xaa" * 8 * (len(block.w) - block.top)).cast("q")
            block.end = min(block.top + room, len(block.w))
        m = self.registers = Registers(program, [], float)
        m.block, m.w, m.limits = self.python, self.python.w, AgentLimits(string_length=most)
        self.most = most

    @property
    def base(self) -> int:
        return heaps().base(self.arena.data)

    def made(self, name: str, *numbers: int) -> bool:
        """Whether WebAssembly makes the same string as Python; it leaves the operation where Python
        raises."""
        block = self.arena
        size = called(name, 4 + len(numbers))(self.base, block.top, block.end, self.most, *numbers)
        before = bytes(block.image())
        try:
            place = FUNCTIONS[name](self.registers, *numbers)
        except (Trap, HeapFull):
            assert size == 0
            return False
        if not size:
            return False
        assert place == block.top
        block.top += size
        assert bytes(block.data[8 * HEADER_WORDS : len(before)]) == before[8 * HEADER_WORDS :]
        assert bytes(block.image()) == bytes(self.python.image())
        return True

    def given(self, name: str, *numbers: int) -> int | None:
        """The number that both give; None where WebAssembly leaves the operation."""
        number: int | None = called(name, 1 + len(numbers))(self.base, *numbers)
        number = None if number == {"str_len": -1, "index_of": -2}[name] else number
        return self.same(number, name, *numbers)

    def parsed(self, place: int) -> int | None:
        """The number that both find in a text; None where WebAssembly leaves the operation."""
        store = heaps().store
        number, known = heaps().functions.instance.exports(store)["s2i"](store, self.base, place)
        return self.same(number if known else None, "s2i", place)

    def same(self, number: int | None, name: str, *numbers: int) -> int | None:
        """The number, which Python gives too; WebAssembly leaves where Python raises."""
        try:
            expected = FUNCTIONS[name](self.registers, *numbers)
        except Trap:
            assert number is None
        else:
            assert number in (expected, None)
        return number


@given(maybe, maybe, st.integers(0, 30), st.integers(0, 100))
def test_concatenations_are_the_same(left: str | None, right: str | None, room: int, most: int) -> None:
    two = Two(left, right, room=room, most=most)
    made = two.made("str_concat", *two.places)
    if left is not None and right is not None and len((left + right).encode()) <= min(most, 8 * room - 24):
        assert made


@given(maybe, st.integers(-1, 45), st.integers(-1, 45), st.integers(0, 30), st.integers(0, 100))
def test_substrings_are_the_same(text: str | None, start: int, end: int, room: int, most: int) -> None:
    two = Two(text, room=room, most=most)
    made = two.made("substring", two.places[0], start, end)
    if text is not None and 0 <= start <= end <= len(text) and end - start <= most:
        assert made == (2 + (len(text[start:end].encode()) + 7) // 8 <= room)


@given(maybe)
def test_lengths_are_the_same(text: str | None) -> None:
    two = Two(text)
    assert two.given("str_len", two.places[0]) == (None if text is None else len(text))


@given(st.text("aé", max_size=60), st.text("aé", max_size=5))
@example("", "")
@example("é" * 1000, "a")
def test_positions_of_substrings_are_the_same(text: str, wanted: str) -> None:
    two = Two(text, wanted, most=10_000)
    assert two.given("index_of", *two.places) == text.find(wanted)


def test_a_long_search_and_one_in_null_are_left_to_python() -> None:
    two = Two("a" * 5000, "a" * 20 + "b", None)
    text, expected, null = two.places
    assert two.given("index_of", text, expected) is None
    assert two.given("index_of", null, expected) is None
    assert two.given("index_of", text, null) is None


@pytest.mark.parametrize(("size", "stays"), [(1024, True), (1025, False)])
def test_operations_on_long_strings_are_left_to_python(size: int, *, stays: bool) -> None:
    """WebAssembly does not check the clock."""
    two = Two("a" * size, "a" * size, "b", most=10_000)
    text, same, short = two.places
    assert (two.given("str_len", text) is not None) == stays
    assert two.made("substring", text, 3, 7) == stays
    for name in ("str_equal", "str_order"):
        assert (called(name, 3)(two.base, text, same) != 2) == stays
        assert called(name, 3)(two.base, text, short) != 2


@pytest.mark.parametrize(("size", "made"), [(1023, True), (1024, False)])
def test_long_concatenations_are_left_to_python(size: int, *, made: bool) -> None:
    two = Two("a" * size, "b", most=10_000)
    assert two.made("str_concat", *two.places) == made


@given(maybe, maybe, st.booleans())
def test_comparisons_are_the_same(left: str | None, right: str | None, same: bool) -> None:
    right = left if same else right
    two = Two(left, right)
    equal = unsigned(called("str_equal", 3)(two.base, *two.places))
    assert equal == (left == right)
    order = unsigned(called("str_order", 3)(two.base, *two.places))
    if left is None or right is None:
        assert order == 2
        return
    signed = order - (1 << 32) if order >> 31 else order
    for name in ("sles", "sges", "slts", "sgts"):
        compare = STRING_COMPARE[name]
        assert compare(left, right) == compare(signed, 0)


@given(
    st.integers(-(1 << 63), (1 << 63) - 1) | st.integers(-1000, 1000), st.integers(0, 5), st.integers(0, 25)
)
@example(-(1 << 63), 9, 99)
@example(0, 9, 99)
def test_integers_as_text_are_the_same(number: int, room: int, most: int) -> None:
    two = Two(room=room, most=most).made("i2s", number)
    assert two == (len(str(number)) <= most and 2 + (len(str(number)) + 7) // 8 <= room)


@pytest.mark.parametrize("truth", [0, 1])
@pytest.mark.parametrize("most", [3, 4, 5])
def test_booleans_as_text_are_the_same(truth: int, most: int) -> None:
    assert Two(most=most).made("b2s", truth) == (most >= 5 - truth)


@given(maybe | st.from_regex(r"\s?[+-]?[0-9]{0,20}\s?", fullmatch=True))
@example("+")
@example("-12")
@example("+0012")
def test_texts_as_integers_are_the_same(text: str | None) -> None:
    two = Two(text)
    number = two.parsed(two.places[0])
    if text is not None and text.isascii() and text.isdigit() and len(text) < 19:
        assert number == int(text)
