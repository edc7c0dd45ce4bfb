"""Growable arrays on both heaps: collector, copier, and a verifier that refuses impossible ones."""

from __future__ import annotations

from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_heaps import heaps

from lfield.bytecode.program import ARRAY, GROWABLE, Program, TypeRecord
from lfield.bytecode.side_effects import effectful_methods
from lfield.errors import BlockError
from lfield.testing.golden import compile_text
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block, HeapFull
from lfield.vm.memory.block_allocator import HEAP_ALLOCATOR, BlockAllocator
from lfield.vm.memory.block_verifier import BlockVerifier
from lfield.vm.memory.collector import collect
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import Layouts

TEXT = """
class Node { public int[] numbers; public Node[] more; }
resource R {
    Node kept = new Node();
    init(string[] arg) {
        Node n = new Node(); n.numbers = {}; n.numbers.append(1); n.more = {}; n.more.append(n);
    }
    portal own(int n) emit int { int[] a = {}; a.append(n); a.insert(0, n); return a.pop() + a.remove(0); }
    portal shared(int n) { kept.numbers.append(n); }
    portal shorter() emit int { return kept.numbers.pop(); }
    portal passed(int[] a) emit int[] { a.append(1); return a; }
}
"""
MOST = 1 << 20


@cache
def program() -> Program:
    return compile_text(TEXT)


def kind(field: int) -> int:
    core = program().core
    return core.classes[program().class_index["Node"]].fields[field].type


def empty(space: BlockAllocator) -> Block:
    block = Block.empty(program().digest, 1 << 16, space)
    collect(block, Layouts(program()), 4096)
    return block


def node_of(block: Block, numbers: list[int], links: int) -> int:
    """An object with both arrays, filled by appending; each link is the object itself."""
    core = program().core
    node = block.allocate(layout.OBJECT, program().class_index["Node"], 3)
    for field, words in ((1, numbers), (2, [node] * links)):
        array = block.new_array(kind(field - 1), core.plain_array(kind(field - 1)), 0)
        for i, word in enumerate(words):
            block.insert_element(array, i, word, MOST)
        block.w[node + field] = array
    return node


def words_of(block: Block, array: int) -> list[int]:
    return list(block.w[slice(*layout.elements(block.w, array))])


def capacity(block: Block, array: int) -> int:
    return (block.w[block.w[array + layout.GROWABLE_ARRAY]] >> 32) - 1


@pytest.fixture(params=["python", "wasm"])
def space(request: pytest.FixtureRequest) -> BlockAllocator:
    return HEAP_ALLOCATOR if request.param == "python" else heaps()


operations = st.lists(st.tuples(st.sampled_from("ir"), st.integers(0, 40), st.integers(-9, 9)), max_size=60)


@given(operations)
def test_an_array_has_the_elements_of_a_list(changes: list[tuple[str, int, int]]) -> None:
    block, expected = empty(HEAP_ALLOCATOR), []
    array = block.new_array(kind(0), program().core.plain_array(kind(0)), 0)
    for what, at, word in changes:
        if what == "i":
            block.insert_element(array, at % (len(expected) + 1), word, MOST)
            expected.insert(at % (len(expected) + 1), word)
        elif expected:
            assert block.remove_element(array, at % len(expected)) == expected.pop(at % len(expected))
        assert words_of(block, array) == expected
    spare = block.w[layout.elements(block.w, array)[1] : block.top]
    assert not any(spare[: capacity(block, array) - len(expected)])


def test_appending_moves_few_words() -> None:
    block = Block.empty(program().digest, 1 << 22, HEAP_ALLOCATOR)
    collect(block, Layouts(program()), 1 << 20)
    array = block.new_array(kind(0), program().core.plain_array(kind(0)), 0)
    for i in range(100_000):
        block.insert_element(array, i, i, MOST)
    assert block.top < 5 * 100_000
    assert capacity(block, array) < 1.6 * 100_000


def test_an_array_gets_no_capacity_beyond_the_limit() -> None:
    block = empty(HEAP_ALLOCATOR)
    array = block.new_array(kind(0), program().core.plain_array(kind(0)), 0)
    for i in range(10):
        block.insert_element(array, i, i, 10)
    assert capacity(block, array) == 10


def test_a_full_heap_leaves_the_array_unchanged() -> None:
    block = Block.empty(program().digest, layout.HEADER_WORDS + 15, HEAP_ALLOCATOR)
    array = block.new_array(kind(0), program().core.plain_array(kind(0)), 4)
    before = bytes(block.image())
    with pytest.raises(HeapFull):
        block.insert_element(array, 4, 1, MOST)
    assert bytes(block.image()) == before


def test_the_collector_drops_spare_words(space: BlockAllocator) -> None:
    block = empty(space)
    block.w[layout.W_SELF] = node_of(block, [1, 2, 3, 4, 5, 6], 3)
    collect(block, Layouts(program()))
    node = block.w[layout.W_SELF]
    numbers, more = block.w[node + 1], block.w[node + 2]
    assert words_of(block, numbers) == [1, 2, 3, 4, 5, 6]
    assert words_of(block, more) == [node] * 3
    assert (capacity(block, numbers), capacity(block, more)) == (6, 3)
    assert block.top == layout.HEADER_WORDS + 3 + 3 + 3 + 7 + 4
    # It can grow again.
    block.insert_element(numbers, 6, 7, MOST)
    assert words_of(block, numbers) == [1, 2, 3, 4, 5, 6, 7]


def test_both_collectors_write_the_same_bytes() -> None:
    images = []
    for space in (HEAP_ALLOCATOR, heaps()):
        block = empty(space)
        block.w[layout.W_SELF] = node_of(block, list(range(40)), 9)
        block.remove_element(block.w[block.w[layout.W_SELF] + 1], 3)
        collect(block, Layouts(program()))
        images.append(bytes(block.image()))
    assert images[0] == images[1]


def test_a_collection_limits_the_length_of_a_shared_element_array(space: BlockAllocator) -> None:
    """No engine makes such a block, but a peer may send one."""
    block = empty(space)
    node = block.w[layout.W_SELF] = node_of(block, [1, 2, 3, 4, 5], 0)
    numbers = block.w[node + 1]
    other = block.new_array(kind(0), program().core.plain_array(kind(0)), 0)
    block.w[other + layout.GROWABLE_ARRAY] = block.w[numbers + layout.GROWABLE_ARRAY]
    block.w[numbers + layout.GROWABLE_LENGTH], block.w[other + layout.GROWABLE_LENGTH] = 2, 5
    second = block.allocate(layout.OBJECT, program().class_index["Node"], 3)
    block.w[second + 1] = other
    more = block.w[node + 2]
    block.insert_element(more, 0, second, MOST)
    collect(block, Layouts(program()))
    node = block.w[layout.W_SELF]
    second = words_of(block, block.w[node + 2])[0]
    for place in (block.w[node + 1], block.w[second + 1]):
        assert 0 <= block.w[place + layout.GROWABLE_LENGTH] <= capacity(block, place)


def test_a_copy_is_a_separate_array(space: BlockAllocator) -> None:
    source, target = empty(space), empty(space)
    node = node_of(source, [7, 8], 2)
    copy = deep_copy(source, [node], target, Layouts(program()))[0]
    numbers = target.w[copy + 1]
    target.insert_element(numbers, 2, 9, MOST)
    assert words_of(target, numbers) == [7, 8, 9]
    assert words_of(source, source.w[node + 1]) == [7, 8]
    assert words_of(target, target.w[copy + 2]) == [copy] * 2


@pytest.mark.parametrize(
    ("word", "value"),
    [
        (layout.GROWABLE_LENGTH, 5),
        (layout.GROWABLE_LENGTH, -1),
        (layout.GROWABLE_LENGTH, 1 << 62),
        (layout.GROWABLE_ARRAY, 0),
        (layout.GROWABLE_ARRAY, 1 << 40),
        (layout.GROWABLE_ARRAY, layout.HEADER_WORDS + 1),
        (layout.GROWABLE_ARRAY, layout.HEADER_WORDS),
    ],
)
def test_a_block_with_an_impossible_array_is_refused(space: BlockAllocator, word: int, value: int) -> None:
    verifier = BlockVerifier(program(), Layouts(program()), [], space)
    block = empty(space)
    block.w[layout.W_CLASS] = program().class_index["Node"]
    block.w[layout.W_SELF] = node_of(block, [1, 2, 3, 4], 1)
    collect(block, Layouts(program()))
    assert verifier.check_heap(bytes(block.image()), 1 << 16).top == block.top
    assert verifier.is_result(bytes(block.image()), thrown=False)
    block.w[block.w[block.w[layout.W_SELF] + 1] + word] = value
    with pytest.raises(BlockError):
        verifier.check_heap(bytes(block.image()), 1 << 16)
    assert not verifier.is_result(bytes(block.image()), thrown=False)


def test_only_growable_types_have_another_representation() -> None:
    plain = compile_text(TEXT.replace("n.more.append(n);", ""))
    core = plain.core
    node = core.classes[plain.class_index["Node"]]
    assert [core.types[field.type].kind for field in node.fields[:2]] == [GROWABLE, ARRAY]
    unchanged = compile_text("resource R { init(string[] arg) { print(arg.slice(0, 1).contains(arg[0])); } }")
    assert GROWABLE not in {record.kind for record in unchanged.core.types}
    assert TypeRecord(GROWABLE, program().core.plain_array(kind(0))) in program().core.types


def test_a_portal_that_changes_its_own_arrays_has_no_side_effects() -> None:
    names = {program().core.methods[i].name for i in effectful_methods(program())}
    assert {"shared", "shorter"} <= names
    assert not {"own", "passed"} & names
