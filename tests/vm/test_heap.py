"""Collector and deep copy on random object graphs: reachable objects keep their shape, others are removed."""

from __future__ import annotations

from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.bytecode.program import Program
from lfield.testing.golden import compile_text
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block, HeapFull
from lfield.vm.memory.collector import collect
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import Layouts

NODES = """
class Node { public int value; public Node left; public Node right; public string name; public int[] numbers;
             public Node[] more; }
resource R { init(string[] arg) { Node n = new Node(); n.numbers = new int[1]; n.more = new Node[1]; } }
"""


@cache
def program() -> Program:
    return compile_text(NODES)


def _type_of(field: int) -> int:
    record = program().core.classes[program().class_index["Node"]]
    return record.fields[field].type


# A graph: for each node its value, and the targets of its references (None: null).
_edges = st.one_of(st.none(), st.integers(0, 11))
_node = st.tuples(
    st.integers(-(2**63), 2**63 - 1), _edges, _edges, st.text(max_size=9), st.lists(_edges, max_size=4)
)
graphs = st.lists(_node, min_size=1, max_size=12)


def build(block: Block, nodes: list[tuple]) -> list[int]:
    """The graph on a block's heap; returns the nodes' places."""
    index = program().class_index["Node"]
    places = [block.allocate(layout.OBJECT, index, 7) for _ in nodes]
    w = block.w
    for place, (value, left, right, name, more) in zip(places, nodes, strict=True):
        w[place + 1] = value
        w[place + 2] = places[left % len(places)] if left is not None else 0
        w[place + 3] = places[right % len(places)] if right is not None else 0
        w[place + 4] = block.new_string(name)
        numbers = block.allocate(layout.ARRAY, _type_of(4), 3)
        w[numbers + 1], w[numbers + 2] = value, 7
        w[place + 5] = numbers
        array = block.allocate(layout.ARRAY, _type_of(5), 1 + len(more))
        for i, edge in enumerate(more):
            w[array + 1 + i] = places[edge % len(places)] if edge is not None else 0
        w[place + 6] = array
    return places


def shape(block: Block, root: int, layouts: Layouts) -> list[tuple]:
    """All reachable objects, places replaced by the order of the visit: equal for equal graphs."""
    order: dict[int, int] = {0: 0}
    pending, found = [root], []
    while pending:
        place = pending.pop()
        if order.setdefault(place, len(order)) != len(order) - 1 or place == 0:
            continue
        head = block.w[place]
        references = set(layouts.references(head))
        pending.extend(block.w[place + i] for i in sorted(references))
        found.append((place, head, references))
    numbers = {place: i for i, (place, _, _) in enumerate(found, 1)} | {0: 0}
    return [
        (
            head,
            [
                numbers[w] if i in refs else w
                for i, w in enumerate(block.w[place + 1 : place + (head >> 32)], 1)
            ],
        )
        for place, head, refs in found
    ]


def new_block(limit: int = 1 << 17) -> Block:
    block = Block.empty(program().digest, limit)
    while block.end < 8192:
        collect(block, Layouts(program()), 8192)
    return block


@given(graphs, st.integers(0, 11))
def test_a_collection_keeps_exactly_the_reachable_objects(nodes: list[tuple], root: int) -> None:
    layouts = Layouts(program())
    block = new_block()
    places = build(block, nodes)
    block.w[layout.W_SELF] = places[root % len(places)]
    before = shape(block, block.w[layout.W_SELF], layouts)
    collect(block, layouts)
    assert shape(block, block.w[layout.W_SELF], layouts) == before
    live = sum(head >> 32 for head, _ in before)
    assert block.top == layout.HEADER_WORDS + live
    collect(block, layouts)
    assert block.top == layout.HEADER_WORDS + live


@given(graphs, st.lists(st.integers(0, 11), min_size=1, max_size=3))
def test_a_deep_copy_keeps_aliases_and_cycles_and_does_not_change_the_source(
    nodes: list[tuple], roots: list[int]
) -> None:
    layouts = Layouts(program())
    source, target = new_block(), new_block()
    places = build(source, nodes)
    chosen = [places[i % len(places)] for i in roots]
    image = bytes(source.image())
    copies = deep_copy(source, chosen, target, layouts)
    assert bytes(source.image()) == image
    for original, copy in zip(chosen, copies, strict=True):
        assert shape(target, copy, layouts) == shape(source, original, layouts)
    # The same root twice is the same copy twice.
    assert len(set(copies)) == len(set(chosen))


def test_a_deep_copy_without_space_writes_nothing() -> None:
    source, target = new_block(), Block.empty(program().digest, 1 << 17)
    places = build(source, [(1, 0, 0, "x" * 5000, [])])
    before = bytes(target.image())
    with pytest.raises(HeapFull) as full:
        deep_copy(source, places, target, Layouts(program()))
    assert full.value.words > 600
    assert bytes(target.image()) == before


def test_a_block_grows_only_to_its_limit() -> None:
    block = Block.empty(program().digest, 2048)
    collect(block, Layouts(program()), 100_000)
    assert len(block.w) <= 2048 + 256
    assert block.end == 2048


@given(st.text(max_size=50))
def test_strings_are_restored(text: str) -> None:
    block = new_block()
    assert block.string(block.new_string(text)) == text.encode("utf-8", "replace").decode()
