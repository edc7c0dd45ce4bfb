"""The memory of all blocks of a host: regions stay while they are referenced, and blocks lie in them."""

from __future__ import annotations

import gc
from collections.abc import Iterable
from itertools import pairwise

import pytest

from lfield.testing.golden import compile_text
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.collector import collect, compact
from lfield.vm.memory.layout import Layouts

pytest.importorskip("wasmtime", reason="the engine in WebAssembly needs wasmtime: pip install lfield[wasm]")

from lfield.vm.wasm.arena import ADDRESS_SPACE, PAGE, Arena, size_class
from lfield.vm.wasm.heap_arena import HeapArena

PROGRAM = compile_text("resource R { init(string[] arg) { } }")


def test_a_region_is_reused_only_without_references() -> None:
    arena = Arena()
    first = arena.allocate(4000)
    base = arena.base(first)
    view = memoryview(first)[8:16]
    del first
    gc.collect()
    assert arena.base(arena.allocate(4000)) != base
    view[0] = 1
    del view
    assert arena.base(arena.allocate(4000)) == base


def test_regions_do_not_overlap_and_keep_their_bytes() -> None:
    arena = Arena()
    blocks = [arena.allocate(size) for size in (8, 512, 520, 4096, 5000, 1 << 20, 70_000)]
    for number, capacity in enumerate(blocks, 1):
        capacity[:] = bytes([number]) * len(capacity)
    assert [bytes(capacity) == bytes([n]) * len(capacity) for n, capacity in enumerate(blocks, 1)] == [
        True
    ] * len(blocks)
    places = sorted((arena.base(capacity), size_class(len(capacity))) for capacity in blocks)
    assert all(base + size <= after for (base, size), (after, _) in pairwise(places))


@pytest.mark.parametrize("size", [1, 8, 512, 513, 1000, 4096, 4097, 1 << 20, (1 << 20) + 8])
def test_a_region_wastes_at_most_a_quarter(size: int) -> None:
    assert size <= size_class(size) <= max(512, size * 5 // 4 + 8)
    assert size_class(size) % 8 == 0


def test_a_block_grows_shrinks_and_is_collected_in_the_arena() -> None:
    arena = HeapArena()
    blocks = [Block.empty(PROGRAM.digest, 1 << 17, space) for space in (arena, HeapArena())]
    blocks.append(Block.empty(PROGRAM.digest, 1 << 17))
    for block in blocks:
        block.w[layout.W_ID] = block.new_string("who")
        for _ in range(5):
            block.new_string("x" * 100)
            collect(block, Layouts(PROGRAM), 5000)
        assert block.string(block.w[layout.W_ID]) == "who"
    assert len({bytes(block.image()) for block in blocks}) == 1
    assert len({block.end for block in blocks}) == 1
    # A block of one packet without new objects is left unchanged.
    compact(blocks[0], Layouts(PROGRAM))
    assert blocks[0].end > blocks[0].top == blocks[0].packed
    blocks[0].new_string("y" * 5000)
    compact(blocks[0], Layouts(PROGRAM))
    assert blocks[0].end == blocks[0].top == blocks[0].packed
    assert arena.base(blocks[0].data) >= 0


def test_with_a_full_arena_blocks_lie_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfield.vm.wasm.arena.RESERVATIONS", (1 << 24,))
    arena = HeapArena()
    blocks = [arena.allocate(1 << 20) for _ in range(20)]
    assert arena.reservation == 1 << 24 < ADDRESS_SPACE
    inside = [arena.base(capacity) >= 0 for capacity in blocks]
    assert inside == sorted(inside, reverse=True)
    assert 10 < sum(inside) < 20


def test_no_region_reaches_the_end_of_the_address_space() -> None:
    """The address behind a region, and that of an object without space, are 32-bit numbers too."""
    arena = Arena()
    last = 0
    for size in (64 << 20, 1 << 16, 512):
        while (base := arena.allocate_region(size)) >= 0:
            last = base + size
    assert ADDRESS_SPACE - PAGE - 512 < last <= ADDRESS_SPACE - PAGE


@pytest.mark.few(0)
def test_with_a_full_arena_a_larger_free_region_is_divided(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfield.vm.wasm.arena.RESERVATIONS", (1 << 24,))
    arena = HeapArena()
    blocks = [arena.allocate(1 << 20) for _ in range(20)]
    while arena.allocate_region(512) >= 0:
        pass
    base = arena.base(blocks[0])
    del blocks[0]
    gc.collect()
    small = [arena.allocate(100) for _ in range(3)]
    assert [arena.base(capacity) - base for capacity in small] == [0, 512, 1024]
    assert arena.base(arena.allocate(1 << 20)) == -1
    del small
    gc.collect()
    assert arena.base(arena.allocate(1 << 20)) == base


def test_adjacent_free_regions_are_joined(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfield.vm.wasm.arena.RESERVATIONS", (1 << 24,))
    arena = Arena()
    blocks = [arena.allocate(1 << 20) for _ in range(15)]
    assert all(arena.base(capacity) >= 0 for capacity in blocks)
    places = [arena.base(capacity) for capacity in blocks]
    del blocks[3:6], blocks[-1]
    gc.collect()
    assert arena.base(arena.allocate(4 << 20)) == -1
    three = arena.allocate(3 << 20)
    assert arena.base(three) == places[3]
    assert arena.base(arena.allocate(1 << 20)) == places[14]


def test_regions_freed_by_the_collector_meanwhile_are_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python may collect at any allocation, also while free regions are joined."""
    monkeypatch.setattr("lfield.vm.wasm.arena.RESERVATIONS", (1 << 24,))
    arena = Arena()
    blocks = [arena.allocate(1 << size) for size in range(9, 16) for _ in range(20)]
    while arena.base(capacity := arena.allocate(1 << 20)) >= 0:
        blocks.append(capacity)
    waiting = [arena.allocate(700 + 97 * i) for i in range(30)]

    def sorted_meanwhile(regions: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
        found = []
        for region in regions:
            waiting.clear()
            found.append(region)
        return sorted(found)

    monkeypatch.setattr("lfield.vm.wasm.arena.sorted", sorted_meanwhile, raising=False)
    blocks.clear()
    assert arena.base(arena.allocate(3_000_000)) >= 0
    assert waiting == []
    monkeypatch.undo()
    assert arena.allocate_region((1 << 24) - 2 * PAGE) == PAGE


@pytest.mark.few(0)
def test_a_block_grows_to_a_gibibyte_in_the_arena() -> None:
    """The block is doubled repeatedly, each time with its copy beside it."""
    arena = Arena()
    block = arena.allocate(1 << 20)
    for size in [1 << n for n in range(21, 31)]:
        copied = arena.allocate(len(block))
        block = arena.allocate(size)
        del copied
        gc.collect()
        assert arena.base(block) >= 0
    for _ in range(3):
        block = arena.allocate(1 << 30)
        gc.collect()
        assert arena.base(block) >= 0
