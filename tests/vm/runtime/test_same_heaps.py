"""Heap operations in WebAssembly and in Python give the same bytes."""

from __future__ import annotations

import random
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("wasmtime", reason="the engine in WebAssembly needs wasmtime: pip install lfield[wasm]")

import wasmtime
from random_heaps import LIMIT, RandomHeap, heaps, twin

from lfield.vm.memory import layout
from lfield.vm.memory.block import Block, HeapFull
from lfield.vm.memory.collector import collect, compact
from lfield.vm.memory.copier import deep_copy
from lfield.vm.wasm.arena import PAGE
from lfield.vm.wasm.heap_arena import HeapArena

seeds = st.integers(0, 1 << 32)
versions = st.sampled_from(sorted(layout.HEADERS))


def same(here: Block, there: Block) -> None:
    assert bytes(here.image()) == bytes(there.image())
    assert (here.top, here.end, here.limit, len(here.w)) == (there.top, there.end, there.limit, len(there.w))


@given(seeds, versions, st.sampled_from([0, 1, 5000, 1 << 18]))
def test_a_collection_leaves_the_same_block(seed: int, version: int, room: int) -> None:
    heap = RandomHeap(seed, version=version)
    there = twin(heap.block, heaps())
    for _ in range(2):
        collect(heap.block, heap.layouts, room)
        collect(there, heap.layouts, room)
        same(heap.block, there)
    compact(heap.block, heap.layouts)
    compact(there, heap.layouts)
    same(heap.block, there)


@given(seeds)
def test_the_arena_handles_valid_heaps_without_python(seed: int) -> None:
    heap = RandomHeap(seed, tickets=False)
    there, space = twin(heap.block, heaps()), heaps()
    assert space.copy(there.data, there.top, heap.roots(), there.data, there.top, there.end, heap.layouts)
    target = space.allocate(8 * there.top)
    memoryview(target).cast("q")[: layout.HEADER_WORDS] = there.w[: layout.HEADER_WORDS]
    assert space.verify_heap(there.data, there.heap, there.top, heap.shapes) is not None
    assert space.collect(there.data, target, heap.layouts)


@given(seeds, st.booleans())
def test_a_deep_copy_to_another_block_is_the_same(seed: int, crowded: bool) -> None:
    heap = RandomHeap(seed)
    there = twin(heap.block, heaps())
    targets = [Block.empty(heap.program.digest, LIMIT), Block.empty(heap.program.digest, LIMIT, heaps())]
    roots = heap.roots()
    if not crowded:
        for target in targets:
            collect(target, heap.layouts, 16384)
    copied(heap, roots, (heap.block, targets[0]), (there, targets[1]))


@given(seeds, st.integers(-1, 300))
def test_a_deep_copy_within_a_block_is_the_same_or_needs_as_much_space(seed: int, room: int) -> None:
    heap = RandomHeap(seed)
    there = twin(heap.block, heaps())
    for block in (heap.block, there):
        block.end = block.top + room
    copied(heap, heap.roots(), (heap.block, heap.block), (there, there))


def copied(heap: RandomHeap, roots: list[int], *pairs: tuple[Block, Block]) -> None:
    """Both give the same copies, or need as much space and have written nothing."""
    outcomes = []
    for source, target in pairs:
        before = bytes(source.image()), bytes(target.image()), target.top
        try:
            outcomes.append(deep_copy(source, roots, target, heap.layouts))
        except HeapFull as full:
            outcomes.append(full.words)
            assert (bytes(source.image()), bytes(target.image()), target.top) == before
        assert bytes(source.data[8 * layout.W_TOP + 8 : len(before[0])]) == before[0][8 * layout.W_TOP + 8 :]
    assert outcomes[0] == outcomes[1]
    same(pairs[0][1], pairs[1][1])


@given(seeds)
def test_a_damaged_heap_affects_no_other_block(seed: int) -> None:
    """Arrivals are checked, so this does not happen; but no bug may reach the block of another agent."""
    heap, space = RandomHeap(seed), heaps()
    others = [space.allocate(len(heap.block.data)) for _ in range(4)]
    there, target = twin(heap.block, space), Block.empty(heap.program.digest, LIMIT, space)
    others += [space.allocate(len(heap.block.data)) for _ in range(4)]
    for other in others:
        other[:] = b"\x5a" * len(other)
    rng = random.Random(seed)
    for _ in range(rng.choice([1, 3, 20])):
        at = rng.randrange(layout.W_SELF, there.top)
        there.w[at] = rng.choice(
            [
                rng.randrange(2 * there.top),
                rng.getrandbits(64) - (1 << 63),
                there.w[at] ^ 1 << rng.randrange(62),
            ]
        )
    with suppress(wasmtime.Trap, HeapFull):
        deep_copy(there, heap.roots(), target, heap.layouts)
    with suppress(wasmtime.Trap):
        collect(there, heap.layouts)
    assert all(bytes(other) == b"\x5a" * len(other) for other in others)
    # Shared structures of the arena are not affected either.
    sound = twin(heap.block, space)
    collect(sound, heap.layouts)
    collect(heap.block, heap.layouts)
    same(heap.block, sound)


def test_a_copy_of_many_roots_is_done_in_python() -> None:
    heap = RandomHeap(7)
    there = twin(heap.block, heaps())
    roots = heap.places[:1] * 100
    target = Block.empty(heap.program.digest, LIMIT, heaps())
    collect(target, heap.layouts, 16384)
    assert len(set(deep_copy(there, roots, target, heap.layouts))) == 1


def test_a_large_array_is_copied_and_moved() -> None:
    heap = RandomHeap(3)
    array = max(
        half
        for half in heap.shapes.sizes
        if half & 0xFF == layout.ARRAY and not heap.shapes.expects.get(half, 1)
    )
    big = heap.block.allocate(layout.ARRAY, array >> 8, 10_000)
    heap.block.w[big + 1 : big + 10_000] = memoryview(bytes(range(1, 9)) * 9_999).cast("q")
    heap.block.w[layout.W_SELF] = big
    there = twin(heap.block, heaps())
    copied(heap, [big], (heap.block, heap.block), (there, there))
    collect(heap.block, heap.layouts)
    collect(there, heap.layouts)
    same(heap.block, there)


def test_with_a_full_arena_python_gives_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some blocks lie in the arena, some do not, and there may be no space for the copier."""
    monkeypatch.setattr("lfield.vm.wasm.arena.RESERVATIONS", (1 << 24,))
    done_here = set()
    for left in (0, 1 << 14, 1 << 17, 1 << 18, 1 << 20):
        space = HeapArena()
        assert space.allocate_region((1 << 24) - 2 * PAGE - (1 << 12) - left) > 0
        for seed in range(20):
            heap = RandomHeap(seed)
            there, target = twin(heap.block, space), Block.empty(heap.program.digest, LIMIT, space)
            here = Block.empty(heap.program.digest, LIMIT)
            for block in (heap.block, there, here, target):
                collect(block, heap.layouts, 4096)
            roots = [heap.block.w[word] for word in layout.ROOTS]
            done_here.add(space.base(there.data) >= 0)
            copied(heap, roots, (heap.block, here), (there, target))
            same(heap.block, there)
    assert done_here == {True, False}
