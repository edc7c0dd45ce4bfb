"""Copying garbage collector (Cheney's algorithm), so that a hop transfers live data only.

The collector is precise: records give the positions of references. Its time depends on live data, not on
garbage. The spare words of growable arrays are dropped.
"""

from __future__ import annotations

from lfield.vm.memory.block import INITIAL_WORDS, RESERVE_WORDS, Block
from lfield.vm.memory.block_allocator import Buffer
from lfield.vm.memory.layout import (
    GROWABLE,
    GROWABLE_LENGTH,
    HEADER_WORDS,
    MAGIC,
    ROOTS,
    VERSION,
    W_MAGIC,
    Layouts,
)

_NEW_WORDS = memoryview(bytes(8 * HEADER_WORDS)).cast("q")

#: Up to this many words a block grows because it fills often: 128 KiB.
MAX_GROWTH_WORDS = 1 << 14
#: Up to this many words (1 KiB) a block is one packet on most networks; a smaller block has no advantage.
SMALL_BLOCK_WORDS = 1 << 7
#: Unused bytes that a migrating block may keep: moving the block would take more time.
MAX_SPARE_BYTES = 1 << 12


def collect(block: Block, layouts: Layouts, free_words: int = 0) -> None:
    """Compact the block and leave at least `free_words` words free if its limit (and reserve) allows.

    A small block that fills repeatedly grows, up to MAX_GROWTH_WORDS, so that collections take little time.
    References held outside the block (such as a thread's place) become invalid.
    """
    size = len(block.w)
    # The size of the block rarely changes afterwards.
    data, top = _compact(block, layouts, 8 * size)
    target_words = max(INITIAL_WORDS, min(2 * size, MAX_GROWTH_WORDS), 2 * (top + free_words))
    maximum = block.limit if top + free_words <= block.limit else block.limit + RESERVE_WORDS
    words = max(top, min(target_words, maximum))
    block.replace(block.space.resize(data, 8 * words), top)


def compact(block: Block, layouts: Layouts) -> None:
    """Compact the block with little spare space, before a migration.

    The block is not compacted if it is one packet and no larger than without garbage: most visits leave no
    garbage.
    """
    if block.packed == block.top <= SMALL_BLOCK_WORDS:
        return
    data, top = _compact(block, layouts)
    block.replace(data if len(data) <= 8 * top + MAX_SPARE_BYTES else block.space.resize(data, 8 * top), top)


def _compact(block: Block, layouts: Layouts, minimum: int = 0) -> tuple[Buffer, int]:
    """A copy of the block with live data only, and its top. Destroys the block's own bytes.

    The copy has space for `minimum` bytes, and the header of this version, in which new words are 0.
    """
    old = block.w
    data = block.space.allocate(max(minimum, 8 * (block.top + HEADER_WORDS - block.heap)))
    new = memoryview(data).cast("q")
    new[: block.heap] = old[: block.heap]
    new[block.heap : HEADER_WORDS] = _NEW_WORDS[block.heap :]
    new[W_MAGIC] = MAGIC | VERSION << 32
    top = block.space.collect(block.data, data, layouts)
    if not top:
        top = _copy(old, new, layouts)
    new.release()
    return data, top


def _copy(old: memoryview[int], new: memoryview[int], layouts: Layouts) -> int:
    """Copy live data after the header in the new words; returns their top."""
    top = HEADER_WORDS
    scan = 0
    references: tuple[int, ...] | range = ROOTS
    # The header is scanned like the first object on the heap, with the roots as its references.
    words = HEADER_WORDS
    is_growable = False
    while True:
        for offset in references:
            place = new[scan + offset]
            if not place:
                continue
            head = old[place]
            if head < 0:
                new[scan + offset] = -head
                if is_growable:
                    # Two growable arrays share their elements only in a block that no engine has made.
                    new[scan + GROWABLE_LENGTH] = min(new[scan + GROWABLE_LENGTH], (new[-head] >> 32) - 1)
                continue
            size = head >> 32
            if is_growable:
                size = new[scan + GROWABLE_LENGTH] + 1
                old[place] = head & 0xFFFFFFFF | size << 32
            new[top : top + size] = old[place : place + size]
            old[place] = -top
            new[scan + offset] = top
            top += size
        scan += words
        if scan >= top:
            break
        head = new[scan]
        words = head >> 32
        references = layouts.references(head)
        is_growable = head & 0xFF == GROWABLE
    return top
